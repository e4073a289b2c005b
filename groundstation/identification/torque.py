"""From motor voltages to the mixer's u' (thesis 7.3.4): what turns the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.dynamics.simulation import armature_mv, simulate_motor, steady_rev_s
from groundstation.dynamics.vehicle import MIXERS, Configuration, MotorConstants, Motors
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run, require_known
from groundstation.telemetry.arrays import Array

SMOOTH_S = 0.018
SATURATED = 0.995
"""Duty above which a motor gives all it has."""


@dataclass(frozen=True, slots=True)
class RotorSquares:
    """Squared rotor speeds behind a run.

    square: (n, 4) (rev/s)^2, mean over the period that ends with the row. end: (n, 4) at the row.
    """

    square: Array
    end: Array

    def mixed(self, configuration: Configuration) -> Array:
        """u' (n, 3) of eq. 7.19, mean over the period that ends with the row."""
        return self.square @ MIXERS[configuration].T


def mostly_saturated(run: Run) -> bool:
    """Whether a motor gives all it has in more than half of the rows."""
    return bool((run.duty.max(axis=1) >= SATURATED).mean() > 0.5)


def by_saturation(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """(runs that PWM steers, those in most rows of which a motor is saturated)."""
    found: tuple[list[Run], list[Run]] = [], []
    for run in runs:
        found[mostly_saturated(run)].append(run)
    return found


def rotor_squares(run: Run, motor: MotorConstants | Motors) -> RotorSquares:
    """Squared rotor speeds by simulating the motors.

    The motors start settled at the first row's voltage; what is wrong with that is gone after
    half a second.

    Raises BadInputError where duty or battery voltage are missing, and where the motors are
    saturated throughout.
    """
    settings = run.settings
    each = len(settings) // len(run)
    voltage = armature_mv(settings, np.repeat(run.supply_v, each))
    require_known(run, ("duty", "supply_v"), "the motors need it")
    if mostly_saturated(run):
        raise BadInputError(
            f"{run.name}: a motor is saturated in more than half of the rows; the torque does not"
            " follow the control there: fly with less thrust or a full battery"
        )
    driving = np.maximum(voltage, 0.0)
    start = steady_rev_s(motor, driving[0])
    speed, square = simulate_motor(motor, driving[each:], run.period_s / each, start)
    mean = square.reshape(-1, each, square.shape[1]).mean(axis=1)
    return RotorSquares(np.vstack([start**2, mean]), speed[::each] ** 2)


def measured_squares(run: Run) -> RotorSquares:
    """Squared rotor speeds as recorded.

    Raises BadInputError where some rows have none.
    """
    require_known(run, ("rotor_rev_s",), "fit without --measured-rotors")
    return squares_between(_smoothed(run))


def squares_between(speed: Array) -> RotorSquares:
    """Squares of speeds (n, 4), rev/s, which are straight between rows."""
    before = np.vstack([speed[:1], speed[:-1]])
    return RotorSquares((speed**2 + before**2 + before * speed) / 3, speed**2)


def _smoothed(run: Run) -> Array:
    """Measured speeds with less noise: parabolas over ``SMOOTH_S`` around each row.

    Speeds count by their steps from row to row (the rotors' acceleration turns the craft as
    well), which are mostly noise as they come: on real flights the torque of accelerating rotors
    drowns in it.
    """
    from scipy.signal import savgol_filter

    width = 2 * round(0.5 * SMOOTH_S / run.period_s) + 1
    if width <= 3:
        return run.rotor_rev_s
    return np.asarray(savgol_filter(run.rotor_rev_s, width, 2, axis=0), np.float64)
