"""Compiled loops of the search: rotors with what may be missing, and causal estimates of motion.

Imported only where something is computed. Everything here looks at the past only: in closed loop
a regressor that knows the present row's noise, or the future's, is taken for physics.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

FASTEST_REV_S = 2000.0


@njit(nogil=True, cache=True, error_model="numpy")
def rotor_run(
    constants: Any,
    duty: Any,
    supply_mv: Any,
    period: float,
    substeps: int,
    start: Any,
    end: Any,
    square: Any,
) -> None:
    """Four motors (thesis eq. 3.82) with dead voltage, braking asymmetry and sag.

    constants: a0, a1, a2, dead voltage (mV), braking factor, wire resistance over winding
    resistance. duty: (n, 4), row k acts from row k - 1 to k, as does supply_mv (n,). start: (4,)
    speeds at row 0. Fills end (n, 4), rev/s at the rows, and square (n, 4), the mean square over
    the period that ends with the row.
    """
    a0, a1, a2 = constants[0], constants[1], constants[2]
    dead, braking, sag = constants[3], constants[4], constants[5]
    back_emf = a1 / a0
    h = period / substeps
    for i in range(4):
        end[0, i] = start[i]
        square[0, i] = start[i] * start[i]
    for k in range(1, duty.shape[0]):
        volts = supply_mv[k]
        if sag != 0.0:
            squares, emf = 0.0, 0.0
            for i in range(4):
                squares += duty[k, i] * duty[k, i]
                emf += duty[k, i] * end[k - 1, i]
            volts = (volts + sag * back_emf * emf) / (1.0 + sag * squares)
        for i in range(4):
            push = duty[k, i] * volts
            if dead != 0.0:
                # A negative value is what a search tries, not physics: it adds voltage.
                push = max(push - dead, 0.0) if push > 0.0 else 0.0
            push *= a0
            n = end[k - 1, i]
            total = 0.0
            for _ in range(substeps):
                s1 = push - (a1 + a2 * n) * n
                if s1 < 0.0:
                    s1 *= braking
                n2 = n + 0.5 * h * s1
                s2 = push - (a1 + a2 * n2) * n2
                if s2 < 0.0:
                    s2 *= braking
                n3 = n + 0.5 * h * s2
                s3 = push - (a1 + a2 * n3) * n3
                if s3 < 0.0:
                    s3 *= braking
                n4 = n + h * s3
                s4 = push - (a1 + a2 * n4) * n4
                if s4 < 0.0:
                    s4 *= braking
                total += n * n + 2.0 * (n2 * n2 + n3 * n3) + n4 * n4
                n += h / 6.0 * (s1 + 2.0 * (s2 + s3) + s4)
            # What a search tries need not be a motor: it must stay a number.
            n = min(max(n, 0.0), FASTEST_REV_S)
            end[k, i] = n
            square[k, i] = total / (6.0 * substeps)


@njit(nogil=True, cache=True, error_model="numpy")
def predict_rates(
    gyro: Any,
    known: Any,
    acceleration: Any,
    period: float,
    gain: Any,
    first: int,
    out: Any,
    news: Any,
) -> Any:
    """Mean rate over the period that ends with each row, from rows before it alone.

    A steady-state Kalman filter per axis: acceleration (n, 3) is the model's mean over the
    period, gain (3,) how far a measured rate is believed. Rows that are not known are not
    believed at all. Fills out (n, 3) and news (n, 3), measured less predicted rate at each row;
    returns the mean square of that (3,).
    """
    rows = gyro.shape[0]
    error = [0.0, 0.0, 0.0]
    for axis in range(3):
        rate = gyro[first, axis]
        total = 0.0
        for k in range(first + 1):
            out[k, axis] = gyro[k, axis]
        for k in range(first + 1, rows):
            step = acceleration[k, axis] * period
            out[k, axis] = rate + 0.5 * step
            rate += step
            if known[k]:
                wrong = gyro[k, axis] - rate
                news[k, axis] = wrong
                total += wrong * wrong
                rate += gain[axis] * wrong
        error[axis] = total / max(rows - first - 1, 1)
    return error[0], error[1], error[2]


@njit(nogil=True, cache=True, error_model="numpy")
def body_velocity(
    attitude: Any, force: Any, gravity: float, period: float, leak_s: float, first: int, out: Any
) -> None:
    """Body velocity (n, 3) at each row from attitude (n, 3) and specific force (n, 3) before it.

    The inertial acceleration is integrated with two leaks of time constant ``leak_s``: what an
    offset of the accelerometer or a tilt of the frame would add dies out, and so does true
    velocity that lasts longer.
    """
    vx, vy, vz = 0.0, 0.0, 0.0
    mx, my, mz = 0.0, 0.0, 0.0
    keep = math.exp(-period / leak_s)
    ax, ay, az = 0.0, 0.0, 0.0
    for k in range(attitude.shape[0]):
        cr, sr = math.cos(attitude[k, 0]), math.sin(attitude[k, 0])
        cp, sp = math.cos(attitude[k, 1]), math.sin(attitude[k, 1])
        cy, sy = math.cos(attitude[k, 2]), math.sin(attitude[k, 2])
        r11, r12, r13 = cp * cy, cy * sp * sr - cr * sy, cr * cy * sp + sr * sy
        r21, r22, r23 = cp * sy, cr * cy + sp * sr * sy, cr * sp * sy - cy * sr
        r31, r32, r33 = -sp, cp * sr, cp * cr
        if k > first:
            # The acceleration of the row before acted up to this row.
            vx = keep * (vx + period * ax)
            vy = keep * (vy + period * ay)
            vz = keep * (vz + period * az)
            mx += (1.0 - keep) * (vx - mx)
            my += (1.0 - keep) * (vy - my)
            mz += (1.0 - keep) * (vz - mz)
        ux, uy, uz = vx - mx, vy - my, vz - mz
        out[k, 0] = r11 * ux + r21 * uy + r31 * uz
        out[k, 1] = r12 * ux + r22 * uy + r32 * uz
        out[k, 2] = r13 * ux + r23 * uy + r33 * uz
        ax = r11 * force[k, 0] + r12 * force[k, 1] + r13 * force[k, 2]
        ay = r21 * force[k, 0] + r22 * force[k, 1] + r23 * force[k, 2]
        az = r31 * force[k, 0] + r32 * force[k, 1] + r33 * force[k, 2] - gravity


@njit(nogil=True, cache=True, error_model="numpy")
def carried_attitude(attitude: Any, gyro: Any, period: float, follow_s: float, out: Any) -> None:
    """Attitude (n, 3) that the gyro (n, 3) carries on from the first row.

    ``attitude`` (n, 3) is followed with a time constant ``follow_s``, so that no drift lasts.
    """
    m = np.empty((3, 3))
    turned = np.empty((3, 3))
    for k in range(attitude.shape[0]):
        cr, sr = math.cos(attitude[k, 0]), math.sin(attitude[k, 0])
        cp, sp = math.cos(attitude[k, 1]), math.sin(attitude[k, 1])
        cy, sy = math.cos(attitude[k, 2]), math.sin(attitude[k, 2])
        r11, r12, r13 = cp * cy, cy * sp * sr - cr * sy, cr * cy * sp + sr * sy
        r21, r22, r23 = cp * sy, cr * cy + sp * sr * sy, cr * sp * sy - cy * sr
        r31, r32, r33 = -sp, cp * sr, cp * cr
        if k == 0:
            m[0, 0], m[0, 1], m[0, 2] = r11, r12, r13
            m[1, 0], m[1, 1], m[1, 2] = r21, r22, r23
            m[2, 0], m[2, 1], m[2, 2] = r31, r32, r33
        else:
            half = 0.5 * period
            x = half * (gyro[k, 0] + gyro[k - 1, 0])
            y = half * (gyro[k, 1] + gyro[k - 1, 1])
            z = half * (gyro[k, 2] + gyro[k - 1, 2])
            # To the second order in the turn of one period, then back to the estimate.
            for i in range(3):
                a, b, c = m[i, 0], m[i, 1], m[i, 2]
                da, db, dc = b * z - c * y, c * x - a * z, a * y - b * x
                turned[i, 0] = a + da + 0.5 * (db * z - dc * y)
                turned[i, 1] = b + db + 0.5 * (dc * x - da * z)
                turned[i, 2] = c + dc + 0.5 * (da * y - db * x)
            n = turned
            share = 0.5 * period / follow_s
            ex = share * (
                n[2, 0] * r21
                + n[2, 1] * r22
                + n[2, 2] * r23
                - n[1, 0] * r31
                - n[1, 1] * r32
                - n[1, 2] * r33
            )
            ey = share * (
                n[0, 0] * r31
                + n[0, 1] * r32
                + n[0, 2] * r33
                - n[2, 0] * r11
                - n[2, 1] * r12
                - n[2, 2] * r13
            )
            ez = share * (
                n[1, 0] * r11
                + n[1, 1] * r12
                + n[1, 2] * r13
                - n[0, 0] * r21
                - n[0, 1] * r22
                - n[0, 2] * r23
            )
            for j in range(3):
                a, b, c = n[0, j], n[1, j], n[2, j]
                m[0, j] = a + ez * b - ey * c
                m[1, j] = b + ex * c - ez * a
                m[2, j] = c + ey * a - ex * b
            for i in range(3):
                size = math.sqrt(m[i, 0] ** 2 + m[i, 1] ** 2 + m[i, 2] ** 2)
                for j in range(3):
                    m[i, j] /= size
        out[k, 0] = math.atan2(m[2, 1], m[2, 2])
        out[k, 1] = -math.asin(min(max(m[2, 0], -1.0), 1.0))
        out[k, 2] = math.atan2(m[1, 0], m[0, 0])


@njit(nogil=True, cache=True, error_model="numpy")
def low_pass_mean(values: Any, time_constant: float, period: float, first: int, out: Any) -> None:
    """First-order lag of signals (n, m) given as means over periods; means again.

    The input is held over each period; the lag is settled at row ``first``.
    """
    keep = math.exp(-period / time_constant)
    share = time_constant / period * (1.0 - keep)
    for j in range(values.shape[1]):
        state = values[first, j]
        for k in range(first):
            out[k, j] = values[k, j]
        for k in range(first, values.shape[0]):
            out[k, j] = values[k, j] + (state - values[k, j]) * share
            state = values[k, j] + (state - values[k, j]) * keep


@njit(nogil=True, cache=True, error_model="numpy")
def mix_squares(end: Any, square: Any, strength: Any, mixer: Any, mean: Any, last: Any) -> None:
    """u' and the sum of squares, (n, 4) each: as means over periods and at the rows.

    end, square: (n, 4) as ``rotor_run`` fills them; strength: (4,) of each rotor; mixer: (3, 4).
    """
    for k in range(end.shape[0]):
        for j in range(4):
            mean[k, j] = 0.0
            last[k, j] = 0.0
        for i in range(4):
            over = strength[i] * square[k, i]
            at = strength[i] * end[k, i] * end[k, i]
            for j in range(3):
                mean[k, j] += mixer[j, i] * over
                last[k, j] += mixer[j, i] * at
            mean[k, 3] += over
            last[k, 3] += at


@njit(nogil=True, cache=True, error_model="numpy")
def first_order(values: Any, keep: float, out: Any) -> None:
    """y_k = keep y_(k-1) + (1 - keep) x_k along the rows of (n, m), settled at the first."""
    for j in range(values.shape[1]):
        state = values[0, j]
        for k in range(values.shape[0]):
            state += (1.0 - keep) * (values[k, j] - state)
            out[k, j] = state
