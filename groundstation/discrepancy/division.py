"""Which runs are fitted, and which are held out and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.comparison import Judged
from groundstation.identification.airborne import turning
from groundstation.identification.division import best_way, cut, excitation
from groundstation.identification.recordings import without_gaps
from groundstation.identification.runs import Run
from groundstation.identification.stretches import LEAST_S

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Division:
    """fit_on and held_out: runs. judged: the held-out rows as parts of whole runs, whose rows
    before only tell a state. what: which rows are held out, in words."""

    fit_on: list[Run]
    held_out: list[Run]
    judged: list[Judged]
    what: str


def divide(
    flights: Sequence[Sequence[Run]], held: Sequence[Sequence[Run]], configuration: str
) -> Division:
    """Hold out ``held``, or else a third of each recording (``identification.division``).

    flights, held: the runs of each recording.
    """
    if held:
        rest = [run for part in held for run in part]
        fit_on = [run for part in flights for run in part]
        return Division(fit_on, rest, [Judged(run, 0, len(run)) for run in rest], "")
    moved = [np.vstack([_flown(run, configuration) for run in part]) for part in flights]
    way = best_way(moved, LEAST_S / flights[0][0].period_s)
    fit_on, rest, judged = [], [], []
    for part in flights:
        for run, (fitted, spans) in zip(part, cut(way, [len(run) for run in part]), strict=True):
            fit_on += [run[a:b] for a, b in fitted]
            rest += [run[a:b] for a, b in spans]
            judged += [Judged(run, a, b) for a, b in spans]
    return Division(fit_on, rest, judged, way)


def _flown(run: Run, configuration: str) -> Array:
    """What moves the craft (n, 4), in the air; its mean elsewhere."""
    whole = without_gaps(run)
    moved, flying = excitation(whole, configuration), turning(whole)
    if flying.any():
        moved[~flying] = moved[flying].mean(axis=0)
    return moved
