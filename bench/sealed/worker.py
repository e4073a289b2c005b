"""The process that searches: ``python -m bench.sealed.worker``, one JSON line in and out a case.

It runs the installed command line in-process, so that compiled code stays warm from case to
case. It is told a folder's file names and nothing else. With ``--names`` it calls the search
behind the command alone, for the power curves: what is named, no gap, no proof.
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
from pathlib import Path
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


def names_alone(arguments: list[str]) -> None:
    """What ``discrepancy`` names; of its report only that is written."""
    from groundstation.discrepancy.engine import find_effects
    from groundstation.dynamics.model import load_model
    from groundstation.identification.recordings import flights_of
    from groundstation.recording.open_recording import open_recording

    at = {key: arguments.index(key) for key in ("--model", "--json")}
    given = {key: Path(arguments[place + 1]) for key, place in at.items()}
    fit_on = [
        run
        for path in map(Path, arguments[1 : at["--model"]])
        for run in flights_of(open_recording(path).samples, path.name)
    ]
    found = find_effects(fit_on, load_model(given["--model"]))
    effects = [
        {
            "name": effect.name,
            "parameters": {
                key: {"value": e.value, "stderr": e.stderr} for key, e in effect.parameters.items()
            },
            "alternatives": [{"name": other.name} for other in effect.alternatives],
        }
        for effect in found.effects
    ]
    report = {
        "verdict": found.verdict,
        "effects": effects,
        "residual": found.residual.verdict,
        "where": [],
        "gap": {"channels": {}},
    }
    given["--json"].write_text(json.dumps(report))


if __name__ == "__main__":
    main(names_alone if "--names" in sys.argv else command)
