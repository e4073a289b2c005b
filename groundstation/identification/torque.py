"""From motor voltages to the mixer's u' (thesis 7.3.4): what turns the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.mixer import MIXERS, Configuration
from groundstation.dynamics.motor import armature_mv, simulate_motor
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run

Array = NDArray[np.float64]

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
        return np.asarray(self.square @ MIXERS[configuration].T)


def rotor_squares(run: Run, motor: MotorConstants, measured: bool = False) -> RotorSquares:
    """Squared rotor speeds by simulating the motors, or from measured speeds.

    The motors start settled at the first row's voltage; what is wrong with that is gone after
    half a second.

    Raises BadInputError where duty or battery voltage (or the measured speed) are missing, and
    where the motors are saturated throughout.
    """
    if measured:
        if not np.isfinite(run.rotor_rev_s).all():
            raise BadInputError(f"{run.name}: measured rotor speed is not in every row")
        end = run.rotor_rev_s**2
        # Mean of a square that moves linearly in speed over the period.
        before = np.vstack([run.rotor_rev_s[:1], run.rotor_rev_s[:-1]])
        return RotorSquares((end + before**2 + before * run.rotor_rev_s) / 3, end)
    voltage = armature_mv(run.duty, run.supply_v)
    if not np.isfinite(voltage).all():
        raise BadInputError(
            f"{run.name}: PWM or battery voltage is missing in some rows; the motors need both"
        )
    if (run.duty.max(axis=1) >= SATURATED).mean() > 0.5:
        raise BadInputError(
            f"{run.name}: a motor is saturated in more than half of the rows; the torque does not"
            " follow the control there: fly with less thrust or a full battery"
        )
    start = np.array([motor.steady_rev_s(value) for value in voltage[0]])
    speed, square = simulate_motor(motor, voltage[1:], run.period_s, start)
    return RotorSquares(np.vstack([start**2, square]), speed**2)
