"""Compiled models: motors, Newton-Euler, Euler-Lagrange and the simplified body.

Imported only where something is simulated. Everything is in one file because the compiler's
cache looks at the entry point's own file only.

Newton-Euler works on the state of ``state.py``. The other two models live in Euler angles:
position 0-2, velocity 3-5, angles 6-8 (roll, pitch, yaw), their rates 9-11, rotors 12-15.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from groundstation.dynamics.effects.law_call import call_law

inner = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""A piece of a kernel: cached as part of the kernel that calls it, cheap to compile."""
inlined = njit(nogil=True, error_model="numpy", inline="always")
"""The same for the innermost loops: faster, and dearer to compile with every use."""


class Constants(NamedTuple):
    """A ``CRAFT`` record by value: what is stored to arrays cannot change it, so the compiler
    keeps it in registers."""

    mass: float
    gravity: float
    inertia: Any
    thrust: float
    drag: float
    rotor_x: Any
    rotor_y: Any
    coupling: float
    gyroscopic: float
    spin_up: float
    a0: float
    a1: float
    a2: float
    strength: Any
    dead_mv: float
    braking: float
    sag_ohm: float
    winding_ohm: float
    back_emf_mv: float
    rate_damping: float
    quadratic_damping: float
    yaw_damping: float
    gravity_x: float
    gravity_y: float
    air: float
    rotor_drag: float
    velocity_moment: float
    climb_inflow: float
    ground_gain: float
    ground_height: float
    law: int
    law_values: Any


@inner
def constants(c: Any) -> Any:
    """A ``CRAFT`` record as ``Constants``."""
    return Constants(
        c.mass,
        c.gravity,
        (c.inertia[0], c.inertia[1], c.inertia[2]),
        c.thrust,
        c.drag,
        (c.rotor_x[0], c.rotor_x[1], c.rotor_x[2], c.rotor_x[3]),
        (c.rotor_y[0], c.rotor_y[1], c.rotor_y[2], c.rotor_y[3]),
        c.coupling,
        c.gyroscopic,
        c.spin_up,
        c.a0,
        c.a1,
        c.a2,
        (c.strength[0], c.strength[1], c.strength[2], c.strength[3]),
        c.dead_mv,
        c.braking,
        c.sag_ohm,
        c.winding_ohm,
        c.back_emf_mv,
        c.rate_damping,
        c.quadratic_damping,
        c.yaw_damping,
        c.gravity_x,
        c.gravity_y,
        c.air,
        c.rotor_drag,
        c.velocity_moment,
        c.climb_inflow,
        c.ground_gain,
        c.ground_height,
        c.law,
        c.law_values,
    )


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


@inlined
def motor_slope(c: Any, armature: float, n: float) -> float:
    """dn/dt of eq. 3.82 in rev/s^2, with motor_dead_voltage and motor_braking_asymmetry."""
    slope = c.a0 * max(armature - c.dead_mv, 0.0) - (c.a1 + c.a2 * n) * n
    if slope < 0.0:
        slope *= c.braking
    return slope


@inner
def sagged_supply(c: Any, duty: Any, supply: float, n: Any) -> float:
    """supply_sag: what is left at the motors of a reported voltage, mV.

    V = V_s - R sum d (d V - k_e n) / R_w, solved for V. duty, n: four each.
    """
    squares, emf = 0.0, 0.0
    for i in range(4):
        squares += duty[i] * duty[i]
        emf += duty[i] * n[i]
    share = c.sag_ohm / c.winding_ohm
    return (supply + share * c.back_emf_mv * emf) / (1.0 + share * squares)


@inlined
def drive(c: Any, n: Any) -> Any:
    """Thrust (3.13), torques (3.21 with lever; yaw by drag only) and angular momentum.

    Each rotor counts with its strength (rotor_mismatch). The momentum is that of the rotors
    about -z: I_r w with w of eq. 3.50 in rad/s, 0 where gyroscopics are off.
    """
    s0, s1 = c.strength[0] * n[0] * n[0], c.strength[1] * n[1] * n[1]
    s2, s3 = c.strength[2] * n[2] * n[2], c.strength[3] * n[3] * n[3]
    x, y = c.rotor_x, c.rotor_y
    return (
        c.thrust * (s0 + s1 + s2 + s3),
        c.thrust * (y[0] * s0 + y[1] * s1 + y[2] * s2 + y[3] * s3),
        -c.thrust * (x[0] * s0 + x[1] * s1 + x[2] * s2 + x[3] * s3),
        c.drag * (-s0 + s1 - s2 + s3),
        c.gyroscopic * REVOLUTION * (-n[0] + n[1] - n[2] + n[3]),
    )


@inlined
def _rotors(c: Any, volts: Any, y: Any, first: int, dy: Any) -> Any:
    """Motors (3.82); returns what ``drive`` does, yaw with the rotors' acceleration in it."""
    gain, sign = 0.0, 1.0
    for i in range(4):
        slope = motor_slope(c, volts[i], y[first + i])
        dy[first + i] = slope
        gain -= sign * slope
        sign = -sign
    thrust, roll, pitch, yaw, momentum = drive(c, y[first:])
    return thrust, roll, pitch, yaw + c.spin_up * REVOLUTION * gain, momentum


@inner
def _own_acceleration(law: int, values: Any, state: Any, slope: Any) -> Any:
    """A user's law; state (17) and rotor slopes (4) come by value, because arrays whose address
    leaves a kernel cannot stay in registers."""
    y, dn, own = np.empty(17), np.empty(4), np.zeros(6)
    for i in range(17):
        y[i] = state[i]
    for i in range(4):
        dn[i] = slope[i]
    call_law(law, values, y, dn, own)
    return own[0], own[1], own[2], own[3], own[4], own[5]


@inlined
def body_slope(
    c: Any,
    thrust: float,
    roll: float,
    pitch: float,
    yaw: float,
    momentum: float,
    push: Any,
    y: Any,
    dy: Any,
    lawful: bool,
) -> Any:
    """Thesis eq. 3.33-3.35 and 3.49-3.53, the gyroscopic sign as in docs/thesis_errata.md.

    Fills dy[0:13]; returns the specific force in body axes (m/s^2), without ``push``. The named
    effects of the body act where their constants are not zero (laws: docs/stand_in.md). lawful:
    a constant; False leaves out a user's own law, which costs a fifth of the speed by being there.
    """
    w, a, b, d = y[6], y[7], y[8], y[9]
    p, q, r = y[10], y[11], y[12]
    r13, r23, r33 = 2.0 * (a * d + w * b), 2.0 * (b * d - w * a), 1.0 - 2.0 * (a * a + b * b)
    if c.ground_gain != 0.0:
        near = 1.0 + c.ground_gain * math.exp(-max(y[2], 0.0) / c.ground_height)
        thrust *= near
        roll *= near
        pitch *= near
    roll += (
        momentum * q - (c.rate_damping + c.quadratic_damping * abs(p)) * p - c.gravity_y * thrust
    )
    pitch -= momentum * p + (c.rate_damping + c.quadratic_damping * abs(q)) * q
    pitch += c.gravity_x * thrust
    ixx, iyy, izz = c.inertia[0], c.inertia[1], c.inertia[2]
    dy[10] = (roll + c.coupling * (iyy - izz) * q * r) / ixx + push[0]
    dy[11] = (pitch + c.coupling * (izz - ixx) * p * r) / iyy + push[1]
    dy[12] = (yaw - c.yaw_damping * r + c.coupling * (ixx - iyy) * p * q) / izz + push[2]
    for i in range(3):
        dy[i] = y[3 + i]
    lift = thrust / c.mass
    dy[3] = r13 * lift + push[3]
    dy[4] = r23 * lift + push[4]
    dy[5] = r33 * lift - c.gravity + push[5]
    dy[6] = 0.5 * (-a * p - b * q - d * r)
    dy[7] = 0.5 * (w * p + b * r - d * q)
    dy[8] = 0.5 * (w * q + d * p - a * r)
    dy[9] = 0.5 * (w * r + a * q - b * p)
    if c.air == 0.0 and not (lawful and c.law != 0):
        return 0.0, 0.0, lift
    # What depends on the velocity over ground, and forces that are not along z.
    r11, r21, r31 = 1.0 - 2.0 * (b * b + d * d), 2.0 * (a * b + w * d), 2.0 * (a * d - w * b)
    r12, r22, r32 = 2.0 * (a * b - w * d), 1.0 - 2.0 * (a * a + d * d), 2.0 * (b * d + w * a)
    forward = r11 * y[3] + r21 * y[4] + r31 * y[5]
    left = r12 * y[3] + r22 * y[4] + r32 * y[5]
    climb = r13 * y[3] + r23 * y[4] + r33 * y[5]
    force_x, force_y = -c.rotor_drag / c.mass * forward, -c.rotor_drag / c.mass * left
    more = -c.climb_inflow * climb
    dy[10] += c.velocity_moment * left
    dy[11] -= c.velocity_moment * forward
    if lawful and c.law != 0:
        place = (y[0], y[1], y[2], y[3], y[4], y[5], y[6], y[7], y[8], y[9])
        state = (*place, p, q, r, y[13], y[14], y[15], y[16])
        own = _own_acceleration(c.law, c.law_values, state, (dy[13], dy[14], dy[15], dy[16]))
        dy[10] += own[0]
        dy[11] += own[1]
        dy[12] += own[2]
        force_x += own[3]
        force_y += own[4]
        more += own[5]
    dy[3] += r11 * force_x + r12 * force_y + r13 * more
    dy[4] += r21 * force_x + r22 * force_y + r23 * more
    dy[5] += r31 * force_x + r32 * force_y + r33 * more
    return force_x, force_y, lift + more


@inlined
def _newton_euler(c: Any, volts: Any, push: Any, y: Any, dy: Any, lawful: bool) -> None:
    thrust, roll, pitch, yaw, momentum = _rotors(c, volts, y, 13, dy)
    body_slope(c, thrust, roll, pitch, yaw, momentum, push, y, dy, lawful)


@inner
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


@inner
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


@inlined
def _slope(model: int, c: Any, volts: Any, push: Any, y: Any, dy: Any, lawful: bool) -> None:
    if model == NEWTON_EULER:
        _newton_euler(c, volts, push, y, dy, lawful)
    elif model == EULER_LAGRANGE:
        _euler_lagrange(c, volts, push, y, dy)
    else:
        _simplified(c, volts, push, y, dy)


@inlined
def _run(
    model: int,
    size: int,
    lawful: bool,
    c: Any,
    voltage: Any,
    supply: Any,
    push: Any,
    period: float,
    substeps: int,
    states: Any,
) -> None:
    """``fly`` for one model: with ``size`` a constant, the compiler unrolls the loops over it."""
    y, before, volts = np.empty(size), np.empty(size), np.empty(4)
    slope, total = np.empty(size), np.empty(size)
    for i in range(size):
        y[i] = states[0, i]
    h = period / substeps
    for k in range(voltage.shape[0]):
        for i in range(4):
            volts[i] = voltage[k, i]
        if c.sag_ohm != 0.0 and supply[k] > 0.0:
            for i in range(4):
                volts[i] /= supply[k]  # duty
            left = sagged_supply(c, volts, supply[k], y[size - 4 :])
            for i in range(4):
                volts[i] *= left
        extra = push[k if push.shape[0] > 1 else 0]
        for _ in range(substeps):
            for i in range(size):
                before[i] = y[i]
                total[i] = 0.0
            for stage in range(4):
                _slope(model, c, volts, extra, y, slope, lawful)
                weight = 2.0 if stage == 1 or stage == 2 else 1.0
                step = h if stage == 2 else 0.5 * h
                for i in range(size):
                    total[i] += weight * slope[i]
                    y[i] = before[i] + step * slope[i]
            for i in range(size):
                y[i] = before[i] + h / 6.0 * total[i]
        if model == NEWTON_EULER:
            scale = 1.0 / math.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
            for i in range(6, 10):
                y[i] *= scale
        for i in range(size):
            states[k + 1, i] = y[i]


@njit(nogil=True, cache=True, error_model="numpy")
def fly(
    model: int,
    c: Any,
    start: Any,
    voltage: Any,
    supply: Any,
    push: Any,
    period: float,
    substeps: int,
    states: Any,
) -> None:
    """Runge-Kutta (order 4) with inputs held over each period.

    voltage: (k, 4) mV. supply: (k,) mV that the voltages were made from, needed where the craft
    has supply_sag, which is reckoned at the start of each period; else (0,). push: (k, 6) or
    (1, 6), accelerations added: rad/s^2 about the body axes, m/s^2 in the inertial frame.
    Fills states (k + 1, size).
    """
    states[0] = start
    k = constants(c)
    if model == NEWTON_EULER and k.law == 0:
        _run(NEWTON_EULER, 17, False, k, voltage, supply, push, period, substeps, states)
    elif model == NEWTON_EULER:
        _run(NEWTON_EULER, 17, True, k, voltage, supply, push, period, substeps, states)
    else:
        _run(model, 16, False, k, voltage, supply, push, period, substeps, states)


@njit(nogil=True, cache=True, error_model="numpy")
def specific_forces(c: Any, states: Any, force: Any) -> None:
    """Specific force (k, 3) in body axes of Newton-Euler states (k, 17)."""
    slope, still, values = np.zeros(17), np.zeros(6), constants(c)
    for k in range(len(states)):
        thrust, roll, pitch, yaw, momentum = drive(values, states[k, 13:])
        force[k, 0], force[k, 1], force[k, 2] = body_slope(
            values, thrust, roll, pitch, yaw, momentum, still, states[k], slope, True
        )
