"""The one state vector of a craft, 17 numbers, and what can be read from it.

| slice | quantity | unit |
|---|---|---|
| POSITION | x east, y north, z up | m |
| VELOCITY | the same, inertial frame | m/s |
| QUATERNION | w, x, y, z, body to inertial | |
| RATE | p, q, r in the body frame | rad/s |
| ROTOR | M1..M4 | rev/s |
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from groundstation.dynamics.rotations import attitude_of_quaternion, quaternion_of_attitude
from groundstation.telemetry.arrays import Array

POSITION, VELOCITY, QUATERNION = slice(0, 3), slice(3, 6), slice(6, 10)
RATE, ROTOR = slice(10, 13), slice(13, 17)
STATES = 17


def craft_state(
    position_m: ArrayLike = 0.0,
    velocity_m_s: ArrayLike = 0.0,
    attitude: ArrayLike = (0.0, 0.0, 0.0),
    rates: ArrayLike = 0.0,
    rotor_rev_s: ArrayLike = 0.0,
) -> Array:
    """One state, shape (17,), from its parts; ``attitude`` is roll, pitch, yaw in rad."""
    state = np.zeros(STATES)
    state[POSITION], state[VELOCITY] = position_m, velocity_m_s
    state[QUATERNION] = quaternion_of_attitude(attitude)
    state[RATE], state[ROTOR] = rates, rotor_rev_s
    return state


def attitude_of(states: ArrayLike) -> Array:
    """Roll, pitch, yaw in rad, (..., 17) to (..., 3)."""
    return attitude_of_quaternion(np.asarray(states, np.float64)[..., QUATERNION])
