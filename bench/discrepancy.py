"""How long the search for missing effects takes, and how much memory: the installed command.

The matrix of hidden effects is ``python -m bench.sealed``.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.sealed.cases import named
from bench.sealed.flights import COMMAND, Generator
from bench.sealed.run import search_arguments
from bench.table import Row

CASES = (
    ("nothing hidden", "quiet:nothing:0:clean", 10.0),
    ("one effect", "single:velocity_moment:0:clean", 10.0),
    ("three effects", "triple:rotor_drag+rate_damping+supply_sag:0:clean", 40.0),
)
SCREENING = """
import sys, time
from pathlib import Path
from groundstation.discrepancy.engine import find_effects
from groundstation.identification.recordings import flights_of
from groundstation.dynamics.model import load_model
from groundstation.recording.open_recording import open_recording
folder = Path(sys.argv[1])
flights = [run for path in sorted(folder.glob("fit*.mcap"))
           for run in flights_of(open_recording(path).samples, path.name)]
marks = {}
find_effects(flights, load_model(folder / "model.json"),
             progress=lambda what, share: marks.setdefault(what.split()[0], time.perf_counter()))
print(marks["fitting"] - marks["screening"])
"""


def rows() -> Iterator[Row]:
    """Seconds, warm and with the start of the program, beside the aim; then its memory."""
    with tempfile.TemporaryDirectory() as folder:
        generator = Generator(Path(folder) / "families")
        for what, name, aim_s in CASES:
            case = Path(folder) / name.replace(":", "-")
            generator.make(named(name), case)
            if what == "one effect":
                child = [sys.executable, "-c", SCREENING, str(case)]
                done = subprocess.run(child, capture_output=True, text=True, check=True)
                yield Row(
                    "screening of all effects at once", float(done.stdout), None, "s", most=2.0
                )
            flown = f"{what}: two flights of 60 s, one to validate"
            yield Row(flown, _seconds(case), None, "s", most=aim_s)
        peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        yield Row("peak memory of a search", peak_mb, None, "MB", most=1500.0)


def _seconds(case: Path) -> float:
    """The second of two runs of the installed command: the first one compiles."""
    for _ in range(2):
        for name in ("report.json", "improved.json"):
            (case / name).unlink(missing_ok=True)
        start = time.perf_counter()
        subprocess.run([COMMAND, *search_arguments(case)], capture_output=True, check=True)
    return time.perf_counter() - start
