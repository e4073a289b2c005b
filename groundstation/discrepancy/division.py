"""Which runs are fitted, and which are held out and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.comparison.comparison import Judged
from groundstation.errors import BadInputError
from groundstation.identification.division import LEAST_S, Span, best_way, cut, excitation
from groundstation.identification.flight import LEAST_AIR_S, SETTLE_S, turning
from groundstation.identification.runs import Run, without_gaps
from groundstation.telemetry.arrays import Array

PIECE_S = LEAST_AIR_S + SETTLE_S
LONG_S = 3.0 * PIECE_S
"""Of a piece that begins in the air, whose flight begins half a second later, and of a recording
whose thirds are such pieces."""
END_SHARE = 0.45
"""Of a shorter one, for rows that may be low are left out of its end."""


@dataclass(frozen=True, slots=True)
class Division:
    """fit_on and held_out: runs. judged: the held-out rows as parts of whole runs, whose rows
    before only tell a state. what: which rows are held out, in words."""

    fit_on: list[Run]
    held_out: list[Run]
    judged: list[Judged]
    what: str


@dataclass(frozen=True, slots=True)
class _Air:
    """A run between its first and its last row with turning motors.

    first: that row. moved: what moves the craft (n, 4) from there on, its mean where they stand in
    between. seconds: in which they turn.
    """

    run: Run
    first: int
    moved: Array
    seconds: float

    def with_ground(self, spans: Sequence[Span]) -> list[Span]:
        """Spans of these rows as spans of the run, the outer ones with what is on the ground."""
        end, last = len(self.moved), len(self.run)
        return [(a + self.first if a else 0, b + self.first if b < end else last) for a, b in spans]


def divide(
    flights: Sequence[Sequence[Run]], held: Sequence[Sequence[Run]], configuration: str
) -> Division:
    """Hold out ``held``, or else a third of each recording (``identification.division``) that is
    long enough for it; where none is, a whole recording.

    flights, held: the runs of each recording. Raises BadInputError where nothing can be held out.
    """
    every = [run for part in flights for run in part]
    if held:
        return _given(every, [run for part in held for run in part], "")
    flown = [[_flown(run, configuration) for run in part] for part in flights]
    seconds = [sum(one.seconds for one in part) for part in flown]
    if not any(seconds):  # that nothing flies is told by what is asked next
        return _given(every, every, "")
    long = [part for part, one in zip(flown, seconds, strict=True) if one >= LONG_S]
    if not long:
        return _whole(flown, seconds)
    period_s = min(one.run.period_s for part in long for one in part)
    moved = [np.vstack([one.moved for one in part]) for part in long]
    way = best_way(moved, LEAST_S / period_s)
    fit_on = [
        run for part, one in zip(flights, seconds, strict=True) if one < LONG_S for run in part
    ]
    rest, judged = [], []
    for part in long:
        cuts = cut(way, [len(one.moved) for one in part])
        for one, (fitted, spans) in zip(part, cuts, strict=True):
            fit_on += [one.run[a:b] for a, b in one.with_ground(fitted)]
            for a, b in one.with_ground(spans):
                rest.append(one.run[a:b])
                judged.append(Judged(one.run, a, b))
    which = "" if len(long) == len(flights) else f" of those of {LONG_S:.0f} s and more"
    return Division(fit_on, rest, judged, way + which)


def _given(fit_on: list[Run], held: list[Run], what: str) -> Division:
    """Whole runs on either side."""
    return Division(fit_on, held, [Judged(run, 0, len(run)) for run in held], what)


def _whole(flown: Sequence[Sequence[_Air]], seconds: Sequence[float]) -> Division:
    """Short flights: the recording is held out whose excitation divides best, of one alone its
    last seconds."""
    if len(flown) < 2:
        return _end(flown[0], seconds[0])
    energy = np.array([sum(_energy(one) for one in part) for part in flown])
    share = energy / np.maximum(energy.sum(axis=0), 1e-300)
    most = int(np.argmax(np.minimum(share, 0.5 * (1.0 - share)).min(axis=1)))
    fit_on = [one.run for number, part in enumerate(flown) if number != most for one in part]
    rest = [one.run for one in flown[most]]
    return _given(fit_on, rest, f"all of {rest[0].name}")


def _end(part: Sequence[_Air], seconds: float) -> Division:
    """A short recording whose longest run leaves the fit as much as is judged."""
    longest = max(part, key=lambda one: one.seconds)
    run, name = longest.run, longest.run.name
    if longest.seconds < 2.0 * PIECE_S:
        raise BadInputError(
            f"{name}: of {seconds:.1f} s in the air none can be held out to be judged on; give"
            f" another flight with --validate, or one of {LONG_S:.0f} s"
        )
    held_s = max(PIECE_S, END_SHARE * longest.seconds)
    edge = longest.first + len(longest.moved) - round(held_s / run.period_s)
    fit_on = [one.run for one in part if one is not longest]
    what = f"last {held_s:.1f} s"
    return Division([*fit_on, run[:edge]], [run[edge:]], [Judged(run, edge, len(run))], what)


def _energy(one: _Air) -> Array:
    """Of what moves the craft (4,), over time."""
    if not len(one.moved):
        return np.zeros(4)
    away = one.moved - one.moved.mean(axis=0)
    return (away**2).sum(axis=0) * one.run.period_s


def _flown(run: Run, configuration: str) -> _Air:
    whole = without_gaps(run)
    moved, flying = excitation(whole, configuration), turning(whole)
    if not flying.any():
        return _Air(run, 0, moved[:0], 0.0)
    moved[~flying] = moved[flying].mean(axis=0)
    first, last = np.flatnonzero(flying)[[0, -1]].tolist()
    seconds = float(flying.sum()) * run.period_s
    return _Air(run, first, moved[first : last + 1], seconds)
