"""The daemon on the USB link, in the virtual machine of the USB tests and in its virtual time."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.table import Row

TESTS = Path(__file__).parents[1] / "tests"
BATCH_MS = 8.0


def rows() -> Iterator[Row]:
    """Recording 2000 packets/s on a core of 10^9 instructions/s; nothing without qemu."""
    sys.path.insert(0, str(TESTS))
    from support import usb_guest, virtual_machine

    if reason := virtual_machine.why_not():
        print(f"usb_link: left out, {reason}", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory() as folder:
        result = usb_guest.run_guest(Path(folder), "test_daemon.py")
        if result.status:
            raise RuntimeError(result.output)
        for row in usb_guest.table(Path(folder)):
            reader = row["reader"]
            yield Row(f"{reader}: lost (frames)", row["lost"], row["frames"], "frames")
            yield Row(f"{reader}: processor (a core)", row["cpu_pct"] / 100, 1.0, "core")
            if row["latency_ms"] is not None:
                for name, value in zip(("median", "p99"), row["latency_ms"], strict=True):
                    what = f"{reader}: frame to recorder, {name} (span of a batch)"
                    yield Row(what, value, BATCH_MS, "ms")
