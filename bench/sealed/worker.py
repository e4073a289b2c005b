"""The process that searches: ``python -m bench.sealed.worker``, one JSON line in and out a case.

It runs the installed command line in-process, so that compiled code stays warm from case to
case. It is told a folder's file names and nothing else.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from typing import Any


def main(search: Callable[[list[str]], Any]) -> None:
    from groundstation.allocator import keep_freed
    from groundstation.errors import GroundStationError

    keep_freed()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command itself has it
    answers, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        arguments = json.loads(line)
        start, busy, error = time.perf_counter(), time.process_time(), ""
        try:
            with (
                contextlib.redirect_stdout(io.StringIO()),
                contextlib.redirect_stderr(io.StringIO()),
            ):
                search(arguments)
        except GroundStationError as refused:
            error = f"refused: {refused}"
        except BaseException as fault:
            error = f"{type(fault).__name__}: {fault}"
            if isinstance(fault, KeyboardInterrupt):
                raise
        answer = {
            "seconds": round(time.perf_counter() - start, 3),
            "processor_s": round(time.process_time() - busy, 3),
            "error": error,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        }
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def command(arguments: list[str]) -> None:
    """``groundstation`` with these arguments."""
    from groundstation.cli.app import app

    app(arguments, standalone_mode=False)


if __name__ == "__main__":
    main(command)
