"""Between controller, PWM, rotors and torques, as the thesis's equations have it row by row."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.mixer import MIXERS, PWM_FULL, Configuration
from groundstation.dynamics.vehicle import Vehicle, rotor_positions_m

Array = NDArray[np.float64]


def mix(rotor_rev_s: ArrayLike, configuration: Configuration = "plus") -> Array:
    """The mixer u' (thesis eq. 7.19): (..., 4) rev/s to (..., 3) (rev/s)^2, roll pitch yaw."""
    return np.asarray(rotor_rev_s, np.float64) ** 2 @ MIXERS[configuration].T


def thrust_and_torque(rotor_rev_s: ArrayLike, vehicle: Vehicle) -> tuple[Array, Array]:
    """Total thrust in N (eq. 3.13) and torque in N m about x, y, z (eq. 3.20-3.21).

    Eq. 3.15-3.16 and 3.21 leave the rotor's lever arm out; it is here.
    rotor_rev_s: (..., 4). Returns shapes (...) and (..., 3).
    """
    square = np.asarray(rotor_rev_s, np.float64) ** 2
    places = np.array(rotor_positions_m(vehicle))
    force = vehicle.thrust_n * square
    torque = np.stack(
        [
            force @ places[:, 1],
            -force @ places[:, 0],
            vehicle.drag_n_m * square @ MIXERS["plus"][2],
        ],
        axis=-1,
    )
    return force.sum(-1), torque


def distribute(
    thrust: ArrayLike, control: ArrayLike, configuration: Configuration = "plus"
) -> Array:
    """Power distribution (thesis eq. 8.3): PWM counts of the four motors, limited to 0..4096.

    thrust: (...) and control: (..., 3) rolling, pitching, yawing, in PWM counts. In the X
    configuration rolling and pitching are halved, as two rotors on a side share them.
    """
    share = np.array([1.0, 1.0, 1.0] if configuration == "plus" else [0.5, 0.5, 1.0])
    shared = np.asarray(control, np.float64) * share
    wanted = np.asarray(thrust, np.float64)[..., None] + shared @ MIXERS[configuration]
    return np.clip(wanted, 0.0, PWM_FULL)


def output_stage(pwm: ArrayLike, supply_mv: ArrayLike) -> Array:
    """Armature voltages (mV) of PWM counts (..., 4) at a supply (...) in mV (eq. 3.84, 8.2.6)."""
    return np.asarray(pwm, np.float64) / PWM_FULL * np.asarray(supply_mv, np.float64)[..., None]
