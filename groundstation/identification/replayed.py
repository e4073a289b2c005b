"""An identified model on recorded inputs: what it would have measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import Model
from groundstation.dynamics.motor import armature_mv
from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.dynamics.simulation import simulate, specific_force
from groundstation.dynamics.state import QUATERNION, RATE, ROTOR, STATES, attitude_of
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Replayed:
    """Modelled channels of a run, row by row.

    gyro: (n, 3) rad/s. attitude: (n, 3) rad, yaw unwrapped. accelerometer_z: (n,) m/s^2.
    rotor_rev_s: (n, 4).
    """

    gyro: Array
    attitude: Array
    accelerometer_z: Array
    rotor_rev_s: Array


def simulate_run(model: Model, run: Run, window_s: float = 0.5) -> Replayed:
    """Fly a body model on a run's PWM and battery voltage.

    The motors run through; rates and attitude start afresh from measured ones every
    ``window_s``, because no model of an unstable craft can follow a flight for long. The named
    effects of a model are not simulated here.

    Raises BadInputError where the run lacks PWM, battery voltage, gyro or attitude.
    """
    for name in ("duty", "supply_v", "gyro", "attitude"):
        if not np.isfinite(getattr(run, name)).all():
            raise BadInputError(
                f"{run.name}: {name} is missing in some rows; cannot simulate on it"
            )
    if window_s < run.period_s:
        raise BadInputError(f"window of {window_s} s is shorter than a row ({run.period_s:.4f} s)")
    craft = craft_of_model(model)
    voltage = armature_mv(run.duty, run.supply_v)
    states = np.empty((len(run), STATES))
    rotors = np.array([model.motor.steady_rev_s(value) for value in voltage[0]])
    rows = max(1, round(window_s / run.period_s))
    for first in range(0, len(run), rows):
        last = min(first + rows, len(run) - 1)
        start = np.zeros(STATES)
        start[QUATERNION] = quaternion_of_attitude(run.attitude[first])
        start[RATE], start[ROTOR] = run.gyro[first], rotors
        # Row k's voltage acted from row k - 1 on.
        flown = simulate(craft, start, voltage[first + 1 : last + 1], period_s=run.period_s)
        states[first : first + len(flown)] = flown
        rotors = flown[-1, ROTOR]
    return Replayed(
        states[:, RATE].copy(),
        np.unwrap(attitude_of(states), axis=0),
        specific_force(craft, states)[:, 2],
        states[:, ROTOR].copy(),
    )
