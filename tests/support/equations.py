"""What the code is judged by: the thesis's equations row by row, and the rigid body derived another
way (thesis 3.10): Lagrange's equations in Euler angles, with nothing in common with the kernels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from groundstation.dynamics.rotations import body_rates, euler_rates, rotation_matrix
from groundstation.dynamics.simulation import RATE, ROTOR, attitude_of
from groundstation.dynamics.vehicle import (
    MIXERS,
    PWM_FULL,
    Configuration,
    Vehicle,
    rotor_positions_m,
)

SPIN = np.array([-1.0, 1.0, -1.0, 1.0])


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


def lagrange_flown(craft, start, voltage, seconds, rotor_inertia=0.0, spin_inertia=0.0):
    """(position, attitude, body rates) after ``seconds`` at constant voltages (4,)."""
    c = craft[0]
    attitude = attitude_of(start)
    first = np.concatenate([start[:6], attitude, euler_rates(attitude, start[RATE]), start[ROTOR]])

    def slope(_, y):
        n = y[12:]
        dn = c["a0"] * voltage - (c["a1"] + c["a2"] * n) * n
        square = n**2
        torque = np.array(
            [
                c["thrust"] * c["rotor_y"] @ square,
                -c["thrust"] * c["rotor_x"] @ square,
                c["drag"] * SPIN @ square + 2 * np.pi * spin_inertia * SPIN @ dn,
            ]
        )
        momentum = 2 * np.pi * rotor_inertia * SPIN @ n
        p, q, _ = body_rates(y[6:9], y[9:12])
        torque += [momentum * q, -momentum * p, 0.0]
        force = rotation_matrix(y[6:9])[:, 2] * c["thrust"] * square.sum() / c["mass"]
        force[2] -= c["gravity"]
        turn = accelerations(c["inertia"], y[6:9], y[9:12], torque)
        return np.concatenate([y[3:6], force, y[9:12], turn, dn])

    end = solve_ivp(slope, (0.0, seconds), first, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    return end[:3], end[6:9], body_rates(end[6:9], end[9:12])


def accelerations(inertia, angles, rates, torque):
    """Euler accelerations of J eta'' = ... (thesis 3.46); the generalised torque is W^T tau."""
    ixx, iyy, izz = inertia
    (sf, st), (cf, ct) = np.sin(angles[:2]), np.cos(angles[:2])
    df, dt, ds = rates
    roll, pitch, yaw = torque
    s2, c2 = 2.0 * sf * cf, cf * cf - sf * sf
    f1 = (
        roll
        + (izz - iyy) * cf * sf * dt * dt
        + ct * (ixx + (iyy - izz) * c2) * dt * ds
        + (iyy - izz) * ct * ct * cf * sf * ds * ds
    )
    more = -(ixx + (iyy - izz) * c2) * df + st * (ixx - izz * cf * cf - iyy * sf * sf) * ds
    f2 = cf * pitch - sf * yaw + (iyy - izz) * s2 * dt * df + ct * ds * more
    more = (ixx + (izz - iyy) * c2) * df + (-2.0 * ixx + iyy + izz + (izz - iyy) * c2) * st * ds
    f3 = -st * roll + ct * sf * pitch + ct * cf * yaw
    f3 += 0.5 * (iyy - izz) * st * s2 * dt * dt
    f3 += (izz - iyy) * ct * ct * s2 * df * ds + ct * dt * more
    mass = np.array(  # J (3.38)
        [
            [ixx, 0.0, -ixx * st],
            [0.0, iyy * cf * cf + izz * sf * sf, (iyy - izz) * ct * cf * sf],
            [-ixx * st, (iyy - izz) * ct * cf * sf, 0.0],
        ]
    )
    mass[2, 2] = ixx * st * st + ct * ct * (izz * cf * cf + iyy * sf * sf)
    return np.linalg.solve(mass, [f1, f2, f3])
