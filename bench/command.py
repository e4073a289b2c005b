"""The installed command as a user runs it, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from typing import NamedTuple

PATIENCE_S = 1800.0


class Ended(NamedTuple):
    """said: what it complained of, "" where it ended well. seconds: of a processor."""

    said: str
    seconds: float
    peak_mb: int


def run_command(*arguments: object) -> Ended:
    """``groundstation`` with these arguments; one that hangs is killed, which it then says."""
    code = "from groundstation.cli.main import main; main()"
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)],
            stdout=subprocess.DEVNULL, stderr=said,
        )  # fmt: skip
        clock = threading.Timer(PATIENCE_S, process.kill)
        clock.start()
        _, status, used = os.wait4(process.pid, 0)
        clock.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = said.read().strip().splitlines() or [f"exit status {process.returncode}"]
    last = lines[-1].removeprefix("groundstation: ") if process.returncode else ""
    return Ended(last, used.ru_utime + used.ru_stime, used.ru_maxrss // 1024)
