"""The USB link through a real kernel: ``guest`` runs inside a virtual machine.

In virtual time (10^9 instructions a second), which the load of this machine cannot touch: what
is lost there is lost by the program.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import virtual_machine

PROJECT = Path(__file__).parents[2]
GUEST = Path(__file__).with_name("guest")
PATIENCE_S = 1500
FLIGHTS = {"flight": (200, ""), "filtered": (60, "bridge_dedup = true\n")}
LEAST_TESTS = 33


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """What the tests in the machine said, and the folder of what they wrote."""
    if reason := virtual_machine.why_not():
        pytest.skip(f"no virtual machine for USB: {reason}")
    out = tmp_path_factory.mktemp("usb_vm")
    for name, (seconds, settings) in FLIGHTS.items():
        sound = out / f"{name}.toml"
        sound.write_text(f"{settings}[loss]\ngood_loss = 0.0\n")
        subprocess.run(
            [sys.executable, "-m", "firmware_sim", "--settings", sound, "--for", str(seconds),
             "--fast", "-o", out / f"{name}.npz"],
            check=True, cwd=PROJECT,
        )  # fmt: skip
    helpers = PROJECT / "tests" / "helpers"
    pytest_ = ["-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", "-q", "-rA"]
    command = [
        "env", "GROUNDSTATION_USB_VM=1", f"PYTHONPATH={GUEST}:{helpers}",
        sys.executable, *pytest_, "--timeout=0", str(GUEST),
    ]  # fmt: skip
    result = virtual_machine.run(
        command, out, icount="sleep=off", timeout_s=PATIENCE_S, cwd=PROJECT
    )
    return result, out


@pytest.mark.timeout(PATIENCE_S + 100)
def test_every_test_of_the_guest_passes_and_none_is_skipped(machine):
    result, _ = machine
    assert result.status == 0, result.output
    passed = re.search(r"^(\d+) passed in", result.output, re.MULTILINE)
    assert passed, result.output
    assert int(passed[1]) >= LEAST_TESTS
    told = r"^(?:unplug seen|descriptors,|CPU while).*"
    print("\n".join(re.findall(told, result.output, re.MULTILINE)))


def test_the_ring_loses_nothing_where_device_read_loses_frames(machine):
    _, out = machine
    rows = [json.loads(line) for line in (out / "table.jsonl").read_text().splitlines()]
    print(f"{'reader':<66}{'frames':>8}{'lost':>7}{'CPU %':>8}{'stamps ms':>11}")
    for row in rows:
        spread = "-" if row["stamp_spread_ms"] is None else f"{row['stamp_spread_ms']:.3f}"
        print(
            f"{row['reader']:<66}{row['frames']:>8}{row['lost']:>7}{row['cpu_pct']:>8.1f}"
            f"{spread:>11}"
        )
    ring = [row for row in rows if row["reader"].startswith("ring")]
    plain = [row for row in rows if not row["reader"].startswith("ring")]
    assert [row["lost"] for row in ring] == [0, 0]
    assert min(row["frames"] for row in ring) >= 20_000
    assert min(row["lost"] for row in plain) > 0
