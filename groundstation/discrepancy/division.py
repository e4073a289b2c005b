"""Which rows are fitted and which are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.comparison import Judged
from groundstation.dynamics.mixer import MIXERS
from groundstation.identification.airborne import turning
from groundstation.identification.recordings import without_gaps
from groundstation.identification.runs import Run

Array = NDArray[np.float64]

THIRDS = ("last third", "first third", "middle third")
"""Of every recording; the first of them that serves."""
SERVES = 0.3
"""Least share of its fair part of the excitation that either side of a division must have."""


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
    """Hold out ``held``, or else a third of each recording.

    flights, held: the runs of each recording. The last third is held out, but where it has, or
    leaves the fit, hardly any of the excitation of an axis, the third that divides it best.
    """
    if held:
        rest = [run for part in held for run in part]
        fit_on = [run for part in flights for run in part]
        return Division(fit_on, rest, [Judged(run, 0, len(run)) for run in rest], "")
    ways = {what: _without_third(flights, what) for what in THIRDS}
    shares = {what: _fairness(way, configuration) for what, way in ways.items()}
    if shares[THIRDS[0]] >= SERVES:
        return ways[THIRDS[0]]
    return ways[max(THIRDS, key=lambda what: shares[what])]


def _without_third(flights: Sequence[Sequence[Run]], what: str) -> Division:
    fit_on, held, judged = [], [], []
    for part in flights:
        rows = sum(len(run) for run in part)
        first, last = {
            THIRDS[0]: (round(rows * 2 / 3), rows),
            THIRDS[1]: (0, round(rows / 3)),
            THIRDS[2]: (round(rows / 3), round(rows * 2 / 3)),
        }[what]
        begin = 0
        for run in part:
            a, b = (min(max(edge - begin, 0), len(run)) for edge in (first, last))
            fit_on += [run[i:j] for i, j in ((0, a), (b, len(run))) if j > i]
            if b > a:
                held.append(run[a:b])
                judged.append(Judged(run, a, b))
            begin += len(run)
    return Division(fit_on, held, judged, what)


def _fairness(division: Division, configuration: str) -> float:
    """The least share of its fair part that fitted or held-out rows have of the excitation of
    roll, pitch, yaw or thrust."""
    fitted, held = (
        np.sum([_excitation(run, configuration) for run in part], axis=0)
        for part in (division.fit_on, division.held_out)
    )
    every = np.maximum(fitted + held, 1e-300)
    return float(np.minimum(1.5 * fitted / every, 3.0 * held / every).min())


def _excitation(run: Run, configuration: str) -> Array:
    """Energy (4,) of the commanded torques and thrust in the air, in duty squared."""
    whole = without_gaps(run)
    duty, flying = whole.duty, turning(whole)
    if not flying.any():
        return np.zeros(4)
    mixed = np.column_stack([duty**2 @ MIXERS[configuration].T, (duty**2).sum(axis=1)])[flying]
    return np.asarray(((mixed - mixed.mean(axis=0)) ** 2).sum(axis=0))
