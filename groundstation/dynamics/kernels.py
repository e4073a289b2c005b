"""Compiled models: motors, Newton-Euler, Euler-Lagrange and the simplified body.

Imported only where something is simulated. Everything is in one file because the compiler's
cache looks at the entry point's own file only.

Newton-Euler works on the state of ``state.py``. The other two models live in Euler angles:
position 0-2, velocity 3-5, angles 6-8 (roll, pitch, yaw), their rates 9-11, rotors 12-15.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

NEWTON_EULER, EULER_LAGRANGE, SIMPLIFIED = 0, 1, 2
REVOLUTION = 2.0 * math.pi


@njit(nogil=True, cache=True, error_model="numpy")
def motor_run(
    a0: float,
    a1: float,
    a2: float,
    voltage: Any,
    period: float,
    substeps: int,
    start: Any,
    speed: Any,
    square: Any,
) -> None:
    """Integrate thesis eq. 3.82 (Runge-Kutta, order 4) with inputs held over each period.

    Fills ``speed`` (k + 1, motors) and ``square`` (k, motors), the mean square over a period.
    """
    h = period / substeps
    for motor in range(voltage.shape[1]):
        n = start[motor]
        speed[0, motor] = n
        for k in range(voltage.shape[0]):
            push = a0 * voltage[k, motor]
            total = 0.0
            for _ in range(substeps):
                s1 = push - (a1 + a2 * n) * n
                n2 = n + 0.5 * h * s1
                s2 = push - (a1 + a2 * n2) * n2
                n3 = n + 0.5 * h * s2
                s3 = push - (a1 + a2 * n3) * n3
                n4 = n + h * s3
                s4 = push - (a1 + a2 * n4) * n4
                total += n * n + 2.0 * (n2 * n2 + n3 * n3) + n4 * n4
                n += h / 6.0 * (s1 + 2.0 * (s2 + s3) + s4)
            speed[k + 1, motor] = n
            square[k, motor] = total / (6.0 * substeps)


@njit(nogil=True, error_model="numpy", inline="always")
def _rotors(c: Any, volts: Any, y: Any, first: int, dy: Any) -> Any:
    """Motors (3.82); returns thrust (3.13), torques (3.21 with lever) and rotor sums."""
    thrust, roll, pitch, yaw, spin, gain = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    sign = 1.0  # M1 and M3 counter-clockwise
    for i in range(4):
        n = y[first + i]
        slope = c.a0 * volts[i] - (c.a1 + c.a2 * n) * n
        dy[first + i] = slope
        square = n * n
        thrust += square
        roll += c.rotor_y[i] * square
        pitch -= c.rotor_x[i] * square
        yaw -= sign * square
        spin -= sign * n
        gain -= sign * slope
        sign = -sign
    # spin is omega of eq. 3.50 in rad/s; the rotors' angular momentum along z is -I_r omega.
    inertia = REVOLUTION * c.rotor_inertia
    return (
        c.thrust * thrust,
        c.thrust * roll,
        c.thrust * pitch,
        c.drag * yaw + c.spin_up * inertia * gain,
        c.gyroscopic * inertia * spin,
    )


@njit(nogil=True, error_model="numpy", inline="always")
def _newton_euler(c: Any, volts: Any, push: Any, y: Any, dy: Any) -> None:
    """Thesis eq. 3.33-3.35 and 3.49-3.53, the gyroscopic sign as in docs/thesis_errata.md."""
    thrust, roll, pitch, yaw, momentum = _rotors(c, volts, y, 13, dy)
    w, a, b, d = y[6], y[7], y[8], y[9]
    p, q, r = y[10], y[11], y[12]
    lift = thrust / c.mass
    for i in range(3):
        dy[i] = y[3 + i]
    dy[3] = 2.0 * (a * d + w * b) * lift + push[3]
    dy[4] = 2.0 * (b * d - w * a) * lift + push[4]
    dy[5] = (1.0 - 2.0 * (a * a + b * b)) * lift - c.gravity + push[5]
    dy[6] = 0.5 * (-a * p - b * q - d * r)
    dy[7] = 0.5 * (w * p + b * r - d * q)
    dy[8] = 0.5 * (w * q + d * p - a * r)
    dy[9] = 0.5 * (w * r + a * q - b * p)
    ixx, iyy, izz = c.inertia[0], c.inertia[1], c.inertia[2]
    dy[10] = (roll + c.coupling * (iyy - izz) * q * r + momentum * q) / ixx + push[0]
    dy[11] = (pitch + c.coupling * (izz - ixx) * p * r - momentum * p) / iyy + push[1]
    dy[12] = (yaw + c.coupling * (ixx - iyy) * p * q) / izz + push[2]


@njit(nogil=True, error_model="numpy")
def _euler_lagrange(c: Any, volts: Any, push: Any, y: Any, dy: Any) -> None:
    """Thesis eq. 3.33-3.35 and J eta'' = ... (3.46); the generalised torque is W^T tau_B.

    Torques from rates (gyroscopic) enter tau_B; ``coupling`` is part of the Lagrangian and
    cannot be left out.
    """
    thrust, roll, pitch, yaw, momentum = _rotors(c, volts, y, 12, dy)
    sf, cf, st, ct = math.sin(y[6]), math.cos(y[6]), math.sin(y[7]), math.cos(y[7])
    sy, cy = math.sin(y[8]), math.cos(y[8])
    df, dt, ds = y[9], y[10], y[11]
    ixx, iyy, izz = c.inertia[0], c.inertia[1], c.inertia[2]
    # Body rates (3.9) for the torques that depend on them.
    roll_rate, pitch_rate = df - st * ds, cf * dt + ct * sf * ds
    roll += momentum * pitch_rate + ixx * push[0]
    pitch -= momentum * roll_rate - iyy * push[1]
    yaw += izz * push[2]
    u1 = roll
    u2 = cf * pitch - sf * yaw
    u3 = -st * roll + ct * sf * pitch + ct * cf * yaw

    s2, c2 = 2.0 * sf * cf, cf * cf - sf * sf
    f1 = (
        u1
        + (izz - iyy) * cf * sf * dt * dt
        + ct * (ixx + (iyy - izz) * c2) * dt * ds
        + (iyy - izz) * ct * ct * cf * sf * ds * ds
    )
    f2 = (
        u2
        + (iyy - izz) * s2 * dt * df
        + ct
        * ds
        * (-(ixx + (iyy - izz) * c2) * df + st * (ixx - izz * cf * cf - iyy * sf * sf) * ds)
    )
    f3 = u3 + 0.5 * (
        (iyy - izz) * st * s2 * dt * dt
        + 2.0 * (izz - iyy) * ct * ct * s2 * df * ds
        + 2.0
        * ct
        * dt
        * ((ixx + (izz - iyy) * c2) * df + (-2.0 * ixx + iyy + izz + (izz - iyy) * c2) * st * ds)
    )
    # J (3.38) is symmetric with J12 = 0.
    j11, j13 = ixx, -ixx * st
    j22, j23 = iyy * cf * cf + izz * sf * sf, (iyy - izz) * ct * cf * sf
    j33 = ixx * st * st + ct * ct * (izz * cf * cf + iyy * sf * sf)
    psi = (f3 - j13 / j11 * f1 - j23 / j22 * f2) / (j33 - j13 * j13 / j11 - j23 * j23 / j22)
    lift = thrust / c.mass
    for i in range(3):
        dy[i] = y[3 + i]
        dy[6 + i] = y[9 + i]
    dy[3] = lift * (cf * cy * st + sf * sy) + push[3]
    dy[4] = lift * (-cy * sf + cf * st * sy) + push[4]
    dy[5] = lift * ct * cf - c.gravity + push[5]
    dy[9] = (f1 - j13 * psi) / j11
    dy[10] = (f2 - j23 * psi) / j22
    dy[11] = psi


@njit(nogil=True, error_model="numpy")
def _simplified(c: Any, volts: Any, push: Any, y: Any, dy: Any) -> None:
    """Thesis eq. 3.33-3.35 and 3.58-3.60: Euler accelerations straight from torques."""
    thrust, roll, pitch, yaw, _ = _rotors(c, volts, y, 12, dy)
    sf, cf, st, ct = math.sin(y[6]), math.cos(y[6]), math.sin(y[7]), math.cos(y[7])
    sy, cy = math.sin(y[8]), math.cos(y[8])
    lift = thrust / c.mass
    for i in range(3):
        dy[i] = y[3 + i]
        dy[6 + i] = y[9 + i]
    dy[3] = lift * (cf * cy * st + sf * sy) + push[3]
    dy[4] = lift * (-cy * sf + cf * st * sy) + push[4]
    dy[5] = lift * ct * cf - c.gravity + push[5]
    dy[9] = roll / c.inertia[0] + push[0]
    dy[10] = pitch / c.inertia[1] + push[1]
    dy[11] = yaw / c.inertia[2] + push[2]


@njit(nogil=True, error_model="numpy", inline="always")
def _slope(model: int, c: Any, volts: Any, push: Any, y: Any, dy: Any) -> None:
    if model == NEWTON_EULER:
        _newton_euler(c, volts, push, y, dy)
    elif model == EULER_LAGRANGE:
        _euler_lagrange(c, volts, push, y, dy)
    else:
        _simplified(c, volts, push, y, dy)


@njit(nogil=True, cache=True, error_model="numpy")
def fly(
    model: int,
    c: Any,
    start: Any,
    voltage: Any,
    push: Any,
    period: float,
    substeps: int,
    work: Any,
    states: Any,
) -> None:
    """Runge-Kutta (order 4) with inputs held over each period.

    voltage: (k, 4) mV. push: (k, 6) or (1, 6), accelerations added: rad/s^2 about the body axes,
    m/s^2 in the inertial frame. work: (3, size) scratch. Fills states (k + 1, size).
    """
    size = len(start)
    y, slope, total = work[0], work[1], work[2]
    for i in range(size):
        y[i] = start[i]
        states[0, i] = start[i]
    h = period / substeps
    moving = push.shape[0] > 1
    for k in range(voltage.shape[0]):
        volts = voltage[k]
        extra = push[k if moving else 0]
        before = states[k + 1]
        for _ in range(substeps):
            for i in range(size):
                before[i] = y[i]
            _slope(model, c, volts, extra, y, total)
            for i in range(size):
                y[i] = before[i] + 0.5 * h * total[i]
            _slope(model, c, volts, extra, y, slope)
            for i in range(size):
                total[i] += 2.0 * slope[i]
                y[i] = before[i] + 0.5 * h * slope[i]
            _slope(model, c, volts, extra, y, slope)
            for i in range(size):
                total[i] += 2.0 * slope[i]
                y[i] = before[i] + h * slope[i]
            _slope(model, c, volts, extra, y, slope)
            for i in range(size):
                y[i] = before[i] + h / 6.0 * (total[i] + slope[i])
        if model == NEWTON_EULER:
            scale = 1.0 / math.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
            for i in range(6, 10):
                y[i] *= scale
        for i in range(size):
            states[k + 1, i] = y[i]
