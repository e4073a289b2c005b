"""The process that searches: ``python -m bench.sealed.worker``, one JSON line in and out a case.

It runs the installed command line in-process, so that compiled code stays warm from case to
case. It is told a folder's file names and nothing else.
"""

from __future__ import annotations

import contextlib
import io
import json
import resource
import sys
import time


def main() -> None:
    from groundstation.cli.app import app
    from groundstation.errors import GroundStationError

    answers, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        arguments = json.loads(line)
        start, error = time.perf_counter(), ""
        try:
            with (
                contextlib.redirect_stdout(io.StringIO()),
                contextlib.redirect_stderr(io.StringIO()),
            ):
                app(arguments, standalone_mode=False)
        except GroundStationError as refused:
            error = f"refused: {refused}"
        except BaseException as fault:
            error = f"{type(fault).__name__}: {fault}"
            if isinstance(fault, KeyboardInterrupt):
                raise
        answer = {
            "seconds": round(time.perf_counter() - start, 3),
            "error": error,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        }
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
