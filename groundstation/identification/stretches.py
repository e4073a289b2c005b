"""Airborne stretches of runs, with the rotors behind them: what a body is identified on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.simulation import each_motor
from groundstation.dynamics.vehicle import MotorConstants, Motors
from groundstation.errors import BadInputError
from groundstation.identification.airborne import airborne
from groundstation.identification.runs import Run, require_known
from groundstation.identification.segments import EVERYTHING, Selection, selected
from groundstation.identification.torque import RotorSquares, measured_squares, rotor_squares
from groundstation.telemetry.samples import spans

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
