"""Which flights are fitted and which are held out; no two splits of a set share a fitted flight,
unless they are drawn."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from pathlib import Path

HERE = Path(__file__).parent


@dataclass(frozen=True, slots=True)
class Split:
    name: str
    fitted: tuple[str, ...]
    held: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FlightSet:
    """Flights of one craft. measured: rotor speeds are in the recordings."""

    name: str
    folder: str
    vehicle: str
    measured: bool
    splits: tuple[Split, ...]


def drawn(flights: FlightSet, data: Path, seed: int, count: int) -> FlightSet:
    """The set with ``count`` splits drawn from all flights in its folder: one to three to fit, one
    or two to hold out."""
    names = sorted(
        path.name
        for path in (data / flights.folder).iterdir()
        if path.suffix in ("", ".csv") and path.name != "LICENSE"
    )
    generator, splits = random.Random(f"{flights.name} {seed}"), []
    for _ in range(count):
        generator.shuffle(names)
        fit, held = generator.choice((1, 2, 2, 3)), generator.choice((1, 1, 2))
        fitted, rest = sorted(names[:fit]), sorted(names[fit : fit + held])
        label = " to ".join("+".join(Path(one).stem for one in part) for part in (fitted, rest))
        splits.append(Split(label, tuple(fitted), tuple(rest)))
    return replace(flights, splits=tuple(splits))


SETS = (
    FlightSet(
        "brushless",
        "imrc",
        str(HERE / "brushless.toml"),
        True,
        (
            Split("a", ("eckart00", "eckart22", "eckart34"), ("eckart12", "eckart27")),
            Split("b", ("eckart12", "eckart27"), ("eckart00", "eckart34")),
        ),
    ),
    FlightSet(
        "brushed",
        "imrc_brushed",
        str(HERE / "brushed.toml"),
        True,
        (
            Split("a", ("jana01",), ("jana03", "jana06")),
            Split("b", ("jana02", "jana03", "jana04"), ("jana06",)),
            Split("c", ("jana05", "jana06"), ("jana03",)),
        ),
    ),
    FlightSet(
        "nanobench",
        "nanobench",
        "crazyflie21",
        False,
        (
            Split(
                "a",
                ("B2_circle_fast_rep1.csv", "B3_figure8_fast_rep1.csv"),
                ("B9_trefoil_fast_rep1.csv",),
            ),
            Split(
                "b",
                ("B5_helix_fast_rep1.csv", "B7_oval_fast_rep1.csv"),
                ("B3_figure8_fast_rep2.csv",),
            ),
            Split(
                "c",
                ("B9_trefoil_fast_rep1.csv", "B2_circle_fast_rep2.csv"),
                ("B7_oval_fast_rep2.csv",),
            ),
        ),
    ),
)
PAYLOAD = ("eckart06", "eckart12", "eckart20", "eckart26")
"""Of ``imrc_payload``: the brushless craft with 4.7 g on a cable."""
