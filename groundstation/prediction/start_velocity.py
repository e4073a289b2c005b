"""How fast a craft is where a recording begins in the air.

No sensor measures velocity, and its integral needs a beginning. On the ground that is rest. A
craft that is recorded from somewhere in its flight on has any velocity, but it stays about where
it is: over some seconds its velocity is zero on average, to its travel in that time.
"""

from __future__ import annotations

import numpy as np

from groundstation.dynamics.rotations import rotation_matrix
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import filled

LEVEL_S, LEAST_S = 8.0, 2.0
"""Over so much of a flight the mean is taken: a craft that travels 2 m in it is judged 0.25 m/s
off, as it is by an accelerometer's offset of 6 mg. Of a shorter flight nothing is said."""


def start_velocity(attitude: Array, accelerometer: Array, period_s: float) -> Array:
    """Inertial velocity (3,) in m/s at the first row of a flight, forward, left, up.

    attitude: (n, 3) rad, accelerometer: (n, 3) m/s^2, both FLU and of the flight alone; rows that
    lack either are bridged. 0 where either is unknown throughout, or the flight is short.
    """
    if len(attitude) * period_s < LEAST_S:
        return np.zeros(3)
    rows = round(LEVEL_S / period_s)
    angles, force = filled(attitude[:rows]), filled(accelerometer[:rows])
    if not (np.isfinite(angles).all() and np.isfinite(force).all()):
        return np.zeros(3)
    acceleration = np.einsum("nij,nj->ni", rotation_matrix(angles), force)
    acceleration[:, 2] -= STANDARD_GRAVITY
    gained = np.cumsum(acceleration, axis=0) * period_s
    return -gained.mean(axis=0)
