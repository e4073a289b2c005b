"""Which runs are fitted, and which are held out and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.comparison import Judged
from groundstation.errors import BadInputError
from groundstation.identification.airborne import SETTLE_S, turning
from groundstation.identification.division import Span, best_way, cut, excitation
from groundstation.identification.flight import LEAST_AIR_S
from groundstation.identification.recordings import without_gaps
from groundstation.identification.runs import Run
from groundstation.identification.stretches import LEAST_S

Array = NDArray[np.float64]

LONG_S = 3.0 * (LEAST_AIR_S + SETTLE_S)
"""In the air, so that each third is a flight, which begins half a second after its first row."""


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
    """Hold out ``held``, or else a third of each recording (``identification.division``) that is
    long enough for it; where none is, whole recordings.

    flights, held: the runs of each recording. Raises BadInputError where nothing can be held out.
    """
    if held:
        rest = [run for part in held for run in part]
        fit_on = [run for part in flights for run in part]
        return Division(fit_on, rest, [Judged(run, 0, len(run)) for run in rest], "")
    flown = [[_flown(run, configuration) for run in part] for part in flights]
    moved = [np.vstack([rows for _, rows in part]) for part in flown]
    period_s = flights[0][0].period_s
    long = [period_s * len(rows) >= LONG_S for rows in moved]
    if not any(long):
        return _whole(flights, moved)
    way = best_way(list(compress(moved, long)), LEAST_S / period_s)
    fit_on, rest, judged = [], [], []
    for part, air, is_long in zip(flights, flown, long, strict=True):
        if not is_long:
            fit_on += part
            continue
        cuts = cut(way, [len(rows) for _, rows in air])
        for run, (first, rows), (fitted, spans) in zip(part, air, cuts, strict=True):
            fit_on += [run[a:b] for a, b in _with_ground(fitted, first, len(rows), len(run))]
            for a, b in _with_ground(spans, first, len(rows), len(run)):
                rest.append(run[a:b])
                judged.append(Judged(run, a, b))
    return Division(fit_on, rest, judged, way)


def _whole(flights: Sequence[Sequence[Run]], moved: Sequence[Array]) -> Division:
    """Short flights: the recording is held out whose excitation divides best."""
    if len(flights) < 2:
        name = flights[0][0].name
        seconds = flights[0][0].period_s * len(moved[0])
        raise BadInputError(
            f"{name}: of {seconds:.1f} s in the air none can be held out to be judged on; give"
            f" another flight with --validate, or one of {LONG_S:.0f} s"
        )
    energy = np.array([((rows - rows.mean(axis=0)) ** 2).sum(axis=0) for rows in moved])
    share = energy / np.maximum(energy.sum(axis=0), 1e-300)
    most = int(np.argmax(np.minimum(share, 0.5 * (1.0 - share)).min(axis=1)))
    fit_on = [run for number, part in enumerate(flights) if number != most for run in part]
    rest = list(flights[most])
    judged = [Judged(run, 0, len(run)) for run in rest]
    return Division(fit_on, rest, judged, f"all of {rest[0].name}")


def _flown(run: Run, configuration: str) -> tuple[int, Array]:
    """The first row with turning motors, and what moves the craft from there to the last such row,
    (n, 4); its mean where they stand in between. Of a run that never turns them, all rows."""
    whole = without_gaps(run)
    moved, flying = excitation(whole, configuration), turning(whole)
    if not flying.any():
        return 0, moved
    moved[~flying] = moved[flying].mean(axis=0)
    first, last = np.flatnonzero(flying)[[0, -1]].tolist()
    return first, moved[first : last + 1]


def _with_ground(spans: Sequence[Span], first: int, flown: int, rows: int) -> list[Span]:
    """Spans of the flown rows as spans of the run, the outer ones with what is on the ground."""
    return [(a + first if a else 0, b + first if b < flown else rows) for a, b in spans]
