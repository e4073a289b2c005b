"""Which airborne stretches are fitted and which are held out, where nobody names recordings
for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.simulation import each_motor
from groundstation.dynamics.vehicle import MIXERS, MotorConstants, Motors
from groundstation.errors import BadInputError
from groundstation.identification.flight import airborne
from groundstation.identification.runs import (
    EVERYTHING,
    RotorSquares,
    Run,
    Selection,
    measured_squares,
    require_known,
    rotor_squares,
    selected,
    without_gaps,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import spans

# Airborne stretches of runs, with the rotors behind them: what a body is identified on.


LEAST_S, PIECE_S = 4.0, 1.0
"""Shortest sum of stretches, and shortest stretch, worth identifying on."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Consecutive airborne rows of a run, with the rotors behind them.

    first: its first row in ``run``. squares, run: of the whole run, so that interpolation and
    motor speeds know what came before. motor: the constants the rotors were simulated with, None
    where their speeds were measured.
    """

    run: Run
    squares: RotorSquares
    first: int
    last: int
    motor: MotorConstants | Motors | None = None

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)

    def __len__(self) -> int:
        return self.last - self.first


def stretches_of(
    runs: Sequence[Run],
    motor: MotorConstants | Motors,
    measured: bool = False,
    selection: Selection = EVERYTHING,
) -> list[Stretch]:
    """The airborne parts of runs, or what a selection chooses of them: pieces of 1 s and more.

    Motors are simulated over whole runs. measured: recorded rotor speeds instead.

    Raises BadInputError where less than 4 s are left, or where the gyro is missing.
    """
    found: list[Stretch] = []
    for run in _with_speeds(runs) if measured else runs:
        require_known(run, ("gyro",), "without body rates nothing can be fitted")
        squares = measured_squares(run) if measured else rotor_squares(run, motor)
        chosen = airborne(run) & selected(run, selection)
        for first, last in spans(chosen):
            if (last - first) * run.period_s >= PIECE_S:
                found.append(Stretch(run, squares, first, last, None if measured else motor))
    seconds = sum(len(one) * one.run.period_s for one in found)
    if seconds < LEAST_S:
        names = ", ".join(sorted({run.name for run in runs}))
        wanted = "" if selection == EVERYTHING else f" that is {selection}"
        raise BadInputError(
            f"{names}: {seconds:.1f} s of uninterrupted flight after take-off{wanted}, at least"
            f" {LEAST_S:.0f} s are needed; record longer"
            + (" or choose more of it" if wanted else "")
        )
    return found


def _with_speeds(runs: Sequence[Run]) -> list[Run]:
    """The parts of runs in which every rotor's speed was measured; runs as they are where none
    was."""
    parts = [
        run[first:last]
        for run in runs
        for first, last in spans(np.isfinite(run.rotor_rev_s).all(axis=1))
        if (last - first) * run.period_s >= PIECE_S
    ]
    return parts or list(runs)


def quicker(motor: MotorConstants, factor: float) -> MotorConstants:
    """A motor that reaches the same speeds so much faster."""
    return MotorConstants(motor.a0 * factor, motor.a1 * factor, motor.a2 * factor)


def paced(stretch: Stretch, factor: float) -> Stretch:
    """The stretch with motors that reach the same speeds so much faster."""
    if stretch.motor is None or factor == 1.0:
        return stretch
    m1, m2, m3, m4 = (quicker(one, factor) for one in each_motor(stretch.motor))
    motors = (m1, m2, m3, m4)
    return replace(stretch, motor=motors, squares=rotor_squares(stretch.run, motors))


# Which rows are fitted and which are held out, where nobody names recordings for it.
#
# The last third. Where that third has, or leaves the fit, hardly any of the excitation of an
# axis, the first or the middle one; and where axes are flown one after the other, so that every
# third is needed by the fit, the last third of each third.


Span = tuple[int, int]

LAST, IN_PIECES = "last third", "last third of each third"
HELD: dict[str, tuple[tuple[float, float], ...]] = {
    LAST: ((2 / 3, 1.0),),
    "first third": ((0.0, 1 / 3),),
    "middle third": ((1 / 3, 2 / 3),),
    IN_PIECES: ((2 / 9, 3 / 9), (5 / 9, 6 / 9), (8 / 9, 1.0)),
}
"""Shares of the rows that are held out, of each recording or of all of them in a row."""
SERVES = 0.3
"""Least share of its fair part of the excitation that either side of a division must have."""


def best_way(recordings: Sequence[Array], least_rows: float) -> str:
    """Which of ``HELD``, by the ``excitation`` (n, 4) of each recording's rows.

    The last third where it serves, otherwise the third that divides best; pieces only where no
    third serves and each has ``least_rows``, for each begins without knowing what came before.
    """
    fair = {way: _fairness(recordings, way) for way in HELD}
    if fair[LAST] >= SERVES:
        return LAST
    best = max((way for way in HELD if way != IN_PIECES), key=lambda way: fair[way])
    long = min(len(rows) for rows in recordings) / 9 >= least_rows
    return IN_PIECES if long and fair[best] < min(SERVES, fair[IN_PIECES]) else best


def cut(way: str, lengths: Sequence[int]) -> list[tuple[list[Span], list[Span]]]:
    """(fitted, held out) rows of each part of so many rows, cut as if they were one."""
    rows, begin, found = sum(lengths), 0, []
    edges = [(round(rows * first), round(rows * last)) for first, last in HELD[way]]
    for length in lengths:
        fitted, held, at = [], [], 0
        for edge in edges:
            a, b = (min(max(one - begin, 0), length) for one in edge)
            if a > at:
                fitted.append((at, a))
            if b > a:
                held.append((a, b))
            at = max(at, b)
        if at < length:
            fitted.append((at, length))
        begin += length
        found.append((fitted, held))
    return found


def hold_out(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """(to fit on, to validate on): the last third of all rows, cutting a run where needed."""
    fit_on: list[Run] = []
    held_out: list[Run] = []
    for run, (fitted, held) in zip(runs, cut(LAST, [len(run) for run in runs]), strict=True):
        fit_on += [run[a:b] for a, b in fitted]
        held_out += [run[a:b] for a, b in held]
    return fit_on, held_out


def divided(
    stretches: Sequence[Stretch], configuration: str, least_s: float = LEAST_S
) -> tuple[list[Stretch], list[Stretch], str]:
    """(to fit on, to validate on, which rows of all of them these are in words).

    Of several recordings the last ones are held out, so that the fit has whole flights. least_s:
    shortest piece that says anything.
    """
    moved = np.vstack([excitation(one.run, configuration)[one.rows] for one in stretches])
    way = best_way([moved], least_s / stretches[0].run.period_s)
    fit_on: list[Stretch] = []
    held_out: list[Stretch] = []
    lengths = [len(one) for one in stretches]
    for one, (fitted, held) in zip(stretches, cut(way, lengths), strict=True):
        for found, cuts in ((fit_on, fitted), (held_out, held)):
            found += [replace(one, first=one.first + a, last=one.first + b) for a, b in cuts]
    return fit_on, held_out, way


def excitation(run: Run, configuration: str) -> Array:
    """What moves the craft about roll, pitch and yaw, and lifts it (n, 4), row by row: squares of
    duties, of rotor speeds where no duty is recorded."""
    driven = run.duty if np.isfinite(run.duty).any() else run.rotor_rev_s
    squares = without_gaps(replace(run, duty=driven)).duty ** 2
    return np.column_stack([squares @ MIXERS[configuration].T, squares.sum(axis=1)])


def _fairness(recordings: Sequence[Array], way: str) -> float:
    """The least share of its fair part that fitted or held-out rows have of the energy of roll,
    pitch, yaw or thrust."""
    fitted, held = np.zeros(4), np.zeros(4)
    for moved in recordings:
        energy = (moved - moved.mean(axis=0)) ** 2
        ((_, spans),) = cut(way, [len(moved)])
        here = sum((energy[a:b].sum(axis=0) for a, b in spans), np.zeros(4))
        fitted, held = fitted + energy.sum(axis=0) - here, held + here
    every = np.maximum(fitted + held, 1e-300)
    return float(np.minimum(1.5 * fitted / every, 3.0 * held / every).min())
