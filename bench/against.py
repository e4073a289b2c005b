"""``python -m bench.against CHECKOUT``: this state of the program beside an older one, interleaved.

Both run in turn (A B A B ...), each in a process of its own with this environment's libraries, on
the same recordings: what else the machine does falls on both. A figure is the median over the
pairs of the processor time here over the processor time there. A first pair, which compiles, does
not count. To get the older one: ``git worktree add ../older COMMIT``.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from bench.table import Row, header

HERE = Path(__file__).resolve().parent.parent
CASES = ("quiet:nothing:0:clean", "single:rotor_drag:3:clean")
COMMAND = "from groundstation.cli.main import main; main()"
STEPS = """
import time
import numpy as np
from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.simulation import simulate
from groundstation.dynamics.state import craft_state
from groundstation.dynamics.vehicle import BUILT_IN
import msgspec
base = vehicle_model(BUILT_IN["crazyflie1"])
values = {"dead_time": ("delay_s", 0.004), "inertia_coupling": ("fraction", 1.0),
          "rotor_drag": ("drag_n_s_m", 0.008), "supply_sag": ("resistance_ohm", 0.1)}
terms = [EffectTerm(name, {key: Estimate(value)}) for name, (key, value) in values.items()
         if sys.argv[1] == "four"]
model = msgspec.structs.replace(base, effects=tuple(terms))
craft = craft_of_model(model)
voltage, supply = np.full((200_000, 4), 2400.0), np.full(200_000, 3700.0)
start = craft_state(rates=(0.1, 0.2, 0.3), rotor_rev_s=250)
simulate(craft, start, voltage, supply_mv=supply)
taken = []
for _ in range(5):
    begun = time.process_time()
    simulate(craft, start, voltage, supply_mv=supply)
    taken.append(time.process_time() - begun)
print(min(taken))
"""
SCREENING = """
import time
from pathlib import Path
from groundstation.discrepancy.engine import find_effects
try:
    from groundstation.identification.recordings import flights_of
except ImportError:  # where it stood before
    from groundstation.discrepancy.recordings import flights_of
from groundstation.dynamics.model import load_model
from groundstation.recording.open_recording import open_recording
folder = Path(sys.argv[1])
flights = [run for path in sorted(folder.glob("fit*.mcap"))
           for run in flights_of(open_recording(path).samples, path.name)]
marks = {}


def progress(what, share):
    marks.setdefault(what.split()[0], time.process_time())
    if "fitting" in marks:
        print(marks["fitting"] - marks["screening"])
        raise SystemExit


find_effects(flights, load_model(folder / "model.json"), progress=progress)
print(time.process_time() - marks["screening"])  # nothing was worth a fit
"""


class Spent(NamedTuple):
    """What a process took: processor time of its own code (s) and its largest memory (MB)."""

    seconds: float
    peak_mb: float


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.against", description=__doc__)
    parser.add_argument("checkout", type=Path, help="another state of the program")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument(
        "--cases", nargs="+", default=CASES, help="as 'bench.sealed make' knows, or folders of its"
    )
    options = parser.parse_args()
    print(header())
    with tempfile.TemporaryDirectory() as folder:
        for row in _rows(options.checkout.resolve(), Path(folder), options.pairs, options.cases):
            print(row.line(), flush=True)
    return 0


def _rows(other: Path, folder: Path, pairs: int, cases: list[str]) -> Iterator[Row]:
    def measured(what: str, run: Callable[[Path], Spent]) -> Iterator[Row]:
        spent = [(run(HERE), run(other)) for _ in range(pairs + 1)][1:]
        here, there = ([one[side] for one in spent] for side in (0, 1))
        ratio = statistics.median(a.seconds / b.seconds for a, b in spent)
        there_s = statistics.median(one.seconds for one in there)
        yield Row(f"{what}: processor time (there)", ratio * there_s, there_s, "s")
        peaks = (statistics.median(one.peak_mb for one in side) for side in (here, there))
        yield Row(f"{what}: peak memory (there)", *peaks, "MB", most=800.0)

    for label, chosen in (("no effect", "none"), ("four effects", "four")):
        steps = measured(
            f"200,000 steps of 6-DOF, {label}", lambda where, c=chosen: _printed(where, STEPS, c)
        )
        yield next(steps)
    for name in cases:
        case = Path(name).resolve()
        if not case.is_dir():
            case = folder / name.replace(":", "-")
            _made(name, other, case, folder)
        flights = [str(path) for path in sorted(case.glob("fit*.mcap"))]
        held = ("--validate", str(case / "validate.mcap"), "--vehicle", "crazyflie1")
        made = folder / "made.json"
        body = ("fit", "body", *flights, *held, "-o", str(made))
        yield from measured(f"fit body, {name}", lambda where, a=body, m=made: _run(where, a, m))
        yield next(
            measured(f"screening, {name}", lambda where, c=case: _printed(where, SCREENING, c))
        )
        model = ("--model", str(case / "model.json"))
        search = ("discrepancy", *flights, *model, *held, "-o", str(made))
        yield from measured(
            f"discrepancy, {name}", lambda where, a=search, m=made: _run(where, a, m)
        )


def _made(name: str, other: Path, case: Path, folder: Path) -> None:
    """The case's recordings and model, made by the older program, which both can read."""
    subprocess.run(
        [sys.executable, "-m", "bench.sealed", "make", name, "-o", str(case),
         "--results", str(folder / "results")],
        env=_environment(other), cwd=other, capture_output=True, check=True,
    )  # fmt: skip


def _printed(where: Path, program: str, argument: str | Path) -> Spent:
    """Of a program that prints the seconds it took."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{program}", str(argument)],
        env=_environment(where), cwd=where, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return Spent(float(done.stdout), 0.0)


def _run(where: Path, arguments: tuple[str, ...], made: Path) -> Spent:
    """Of a command, from its start to its end."""
    made.unlink(missing_ok=True)
    child = subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments],
        env=_environment(where), cwd=where, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{where}: groundstation {' '.join(arguments)} failed; run it by hand")
    return Spent(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def _environment(where: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(where), "OPENBLAS_NUM_THREADS": "1"}


if __name__ == "__main__":
    sys.exit(main())
