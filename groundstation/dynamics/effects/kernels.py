"""Compiled flight with effects on recorded inputs: motors, observer, prediction.

Row i of a recording shows the craft at t_i less the dead time. All of this works on that shifted
grid: ``spin`` runs the motors on inputs that change at t_i and gives their speeds on the shifted
grid, at its points and half-way; body and sensors then know no delay.

A body state is (17,) as in ``dynamics/state.py``; a filter state (10,) is the firmware's Mahony
filter: quaternion, smoothed accelerometer, integral.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from groundstation.dynamics.kernels import (
    REVOLUTION,
    body_slope,
    constants,
    drive,
    inlined,
    inner,
    motor_slope,
    sagged_supply,
)

MAHONY_KP, MAHONY_KI = 0.4, 0.001
"""Half of the firmware's twoKp and twoKi."""
SMOOTHING, SMOOTHING_S = 0.125, 0.002
"""The firmware's accelerometer filter: share of each new sample, at this period."""


@njit(nogil=True, cache=True, error_model="numpy")
def spin(
    craft: Any, duty: Any, supply: Any, period: float, delay: float, start: Any, speed: Any
) -> None:
    """Rotor speeds (2 n - 1, 4) at every row less ``delay``, and half-way to the next.

    duty: (n, 4), supply: (n,) mV; row i acts from t_(i-1) to t_i. start: (4,) at the first point.
    """
    c = constants(craft)
    rows = len(duty)
    volts, n = np.empty(4), np.empty(4)
    for i in range(4):
        n[i] = start[i]
        speed[0, i] = start[i]
    offset = delay / period
    row = math.floor(-offset) + 1
    _armature(c, duty, supply, min(max(row, 0), rows - 1), n, volts)
    for point in range(1, 2 * rows - 1):
        at = 0.5 * (point - 1) - offset
        left = 0.5
        while left > 1e-9:
            step = min(row - at, left)
            if step < 1e-9:
                row += 1
                _armature(c, duty, supply, min(max(row, 0), rows - 1), n, volts)
                continue
            h = step * period
            for i in range(4):
                k1 = motor_slope(c, volts[i], n[i])
                k2 = motor_slope(c, volts[i], n[i] + 0.5 * h * k1)
                k3 = motor_slope(c, volts[i], n[i] + 0.5 * h * k2)
                k4 = motor_slope(c, volts[i], n[i] + h * k3)
                n[i] += h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
            at += step
            left -= step
        for i in range(4):
            speed[point, i] = n[i]


@inner
def _armature(c: Any, duty: Any, supply: Any, row: int, n: Any, volts: Any) -> None:
    left = supply[row]
    if c.sag_ohm != 0.0:
        left = sagged_supply(c, duty[row], left, n)
    for i in range(4):
        volts[i] = duty[row, i] * left


@njit(nogil=True, cache=True, error_model="numpy")
def drives(craft: Any, speed: Any, period: float, out: Any, kick: Any) -> None:
    """What rotors do to the body: ``drive`` at every point (2 n - 1, 5), and the torque of their
    acceleration, mean over each row (n - 1,)."""
    c = constants(craft)
    for k in range(len(speed)):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = drive(c, speed[k])
    for j in range(len(kick)):
        one, other = speed[2 * j], speed[2 * j + 2]
        gained = 0.0
        sign = 1.0
        for i in range(4):
            gained -= sign * (other[i] - one[i])
            sign = -sign
        kick[j] = c.spin_up * REVOLUTION * gained / period


@inlined
def _slope_at(
    c: Any,
    drv: Any,
    kick: Any,
    speed: Any,
    row: int,
    half: int,
    h: float,
    y: Any,
    still: Any,
    dy: Any,
) -> Any:
    """The body's slope at the start (half 0), middle (1) or end (2) of a row's period."""
    point = 2 * row + half
    if c.law != 0:
        for i in range(4):
            y[13 + i] = speed[point, i]
            dy[13 + i] = (speed[2 * row + 2, i] - speed[2 * row, i]) / h
    d = drv[point]
    return body_slope(c, d[0], d[1], d[2], d[3] + kick[row], d[4], still, y, dy, True)


@inlined
def _advance(
    c: Any, drv: Any, kick: Any, speed: Any, row: int, h: float, y: Any, w: Any, still: Any
) -> None:
    """One period of the body, from point ``row`` to the next; w[0] keeps the slope at the start."""
    first, slope, total, base = w[0], w[1], w[2], w[3]
    for i in range(13):
        base[i] = y[i]
        total[i] = 0.0
    for stage in range(4):
        _slope_at(c, drv, kick, speed, row, (stage + 1) // 2, h, y, still, slope)
        weight = 2.0 if stage == 1 or stage == 2 else 1.0
        step = h if stage == 2 else 0.5 * h
        for i in range(13):
            if stage == 0:
                first[i] = slope[i]
            total[i] += weight * slope[i]
            y[i] = base[i] + step * slope[i]
    for i in range(13):
        y[i] = base[i] + h / 6.0 * total[i]
    norm = 1.0 / math.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
    for i in range(6, 10):
        y[i] *= norm
    for i in range(4):
        y[13 + i] = speed[2 * row + 2, i]


@inner
def _lag(sensor: Any, h: float, before: Any, first: Any, y: Any, last: Any, lagged: Any) -> None:
    """The gyro's low-pass over one row, rates in between by Hermite's cubic.

    before, y: states at both ends, first, last: their slopes.
    """
    x = h / sensor.gyro_lag
    keep = math.exp(-x)
    # Integrals of exp(-(1 - s) x) x s^k over 0..1, k = 0, 1, 2.
    m0 = 1.0 - keep
    m1 = 1.0 - m0 / x
    m2 = 1.0 - 2.0 * m1 / x
    for i in range(3):
        g0, g1 = before[10 + i], y[10 + i]
        middle = 0.5 * (g0 + g1) + h / 8.0 * (first[10 + i] - last[10 + i])
        b = -3.0 * g0 + 4.0 * middle - g1
        a = 2.0 * (g0 - 2.0 * middle + g1)
        lagged[i] = keep * lagged[i] + g0 * m0 + b * m1 + a * m2


@inner
def _lever(sensor: Any, y: Any, dy: Any) -> Any:
    """imu_lever_arm: alpha x r + Omega x (Omega x r)."""
    x, v, z = sensor.lever[0], sensor.lever[1], sensor.lever[2]
    p, q, r = y[10], y[11], y[12]
    along = p * x + q * v + r * z
    square = p * p + q * q + r * r
    return (
        dy[11] * z - dy[12] * v + p * along - square * x,
        dy[12] * x - dy[10] * z + q * along - square * v,
        dy[10] * v - dy[11] * x + r * along - square * z,
    )


@inner
def _sense(
    sensor: Any, force: Any, y: Any, dy: Any, lagged: Any, gyro: Any, accelerometer: Any
) -> None:
    """What gyro and accelerometer show of a state with slope dy and specific force."""
    lx, ly, lz = _lever(sensor, y, dy)
    fx, fy, fz = force[0] + lx, force[1] + ly, force[2] + lz
    gx, gy, gz = y[10], y[11], y[12]
    if sensor.gyro_lag > 0.0:
        gx, gy, gz = lagged[0], lagged[1], lagged[2]
    m = sensor.mounting
    for i in range(3):
        gyro[i] = m[0, i] * gx + m[1, i] * gy + m[2, i] * gz + sensor.gyro_bias[i]
        accelerometer[i] = m[0, i] * fx + m[1, i] * fy + m[2, i] * fz
        accelerometer[i] += sensor.accelerometer_bias[i]


@inner
def _smooth(acceleration: Any, h: float, filt: Any) -> None:
    share = SMOOTHING if h == SMOOTHING_S else 1.0 - (1.0 - SMOOTHING) ** (h / SMOOTHING_S)
    for i in range(3):
        filt[4 + i] += share * (acceleration[i] - filt[4 + i])


@inner
def _fuse(sensor: Any, gyro: Any, dt: float, filt: Any) -> None:
    """attitude_filter_lean: one pass of Mahony's filter; the bias found at rest is taken off."""
    w, x, y, z = filt[0], filt[1], filt[2], filt[3]
    gx, gy, gz = (
        gyro[0] - sensor.gyro_bias[0],
        gyro[1] - sensor.gyro_bias[1],
        gyro[2] - sensor.gyro_bias[2],
    )
    ax, ay, az = filt[4], filt[5], filt[6]
    size = math.sqrt(ax * ax + ay * ay + az * az)
    if size > 0.0:
        ax, ay, az = ax / size, ay / size, az / size
        # Up in sensor axes as the filter has it, and how far the accelerometer is from it.
        ux, uy, uz = 2.0 * (x * z - w * y), 2.0 * (w * x + y * z), w * w - x * x - y * y + z * z
        ex, ey, ez = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
        k = sensor.lean
        filt[7] += k * MAHONY_KI * ex * dt
        filt[8] += k * MAHONY_KI * ey * dt
        filt[9] += k * MAHONY_KI * ez * dt
        gx += filt[7] + k * MAHONY_KP * ex
        gy += filt[8] + k * MAHONY_KP * ey
        gz += filt[9] + k * MAHONY_KP * ez
    half = 0.5 * dt
    nw = w + half * (-x * gx - y * gy - z * gz)
    nx = x + half * (w * gx + y * gz - z * gy)
    ny = y + half * (w * gy - x * gz + z * gx)
    nz = z + half * (w * gz + x * gy - y * gx)
    norm = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    filt[0], filt[1], filt[2], filt[3] = nw * norm, nx * norm, ny * norm, nz * norm


@inner
def _quaternion(attitude: Any, q: Any) -> None:
    cr, sr = math.cos(0.5 * attitude[0]), math.sin(0.5 * attitude[0])
    cp, sp = math.cos(0.5 * attitude[1]), math.sin(0.5 * attitude[1])
    cy, sy = math.cos(0.5 * attitude[2]), math.sin(0.5 * attitude[2])
    q[0] = cr * cp * cy + sr * sp * sy
    q[1] = sr * cp * cy - cr * sp * sy
    q[2] = cr * sp * cy + sr * cp * sy
    q[3] = cr * cp * sy - sr * sp * cy


@inner
def _product(a: Any, b: Any, out: Any) -> None:
    """Quaternion product; ``out`` may be an argument."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@inner
def _angles(q: Any, out: Any) -> None:
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0] = math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    out[1] = math.asin(min(max(2.0 * (w * y - x * z), -1.0), 1.0))
    out[2] = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


@inner
def _turn(q: Any, v: Any, out: Any) -> None:
    """A body vector in the inertial frame."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c = v[0], v[1], v[2]
    out[0] = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
    out[1] = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
    out[2] = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c


@njit(nogil=True, cache=True, error_model="numpy")
def coast(
    craft: Any,
    sensor: Any,
    mount: Any,
    drv: Any,
    kick: Any,
    speed: Any,
    h: float,
    fresh: Any,
    rows: Any,
    horizons: Any,
    states: Any,
    lags: Any,
    filters: Any,
    shown: Any,
    measured: Any,
    ends: Any,
) -> None:
    """From the state at each of ``rows`` (m,) fly on the inputs alone; no measurement is read.

    horizons: (g,) rows ahead, ascending. states (m, 17), lags (m, 3), filters (m, 10), shown
    (m, 4): body, low-passed rates, Mahony filter and the quaternion last reported, at ``rows``.
    mount: (4,) quaternion body <- sensor. fresh: (n,) rows whose attitude is new.
    Fills measured (m, g, 9): gyro, accelerometer, roll pitch yaw; ends (m, 34): body, lag,
    filter and report at the last horizon.
    """
    c = constants(craft)
    y, lagged, filt = np.empty(17), np.empty(3), np.empty(10)
    dy, before, w, still = np.zeros(17), np.empty(17), np.zeros((4, 17)), np.zeros(6)
    gyro, acceleration, report, held = np.empty(3), np.empty(3), np.empty(4), np.empty(4)
    every = sensor.gyro_lag > 0.0 or sensor.lean > 0.0
    for k in range(len(rows)):
        for i in range(17):
            y[i] = states[k, i]
        for i in range(3):
            lagged[i] = lags[k, i]
        for i in range(10):
            filt[i] = filters[k, i]
        for i in range(4):
            held[i] = shown[k, i]
        row, since, g = rows[k], 0.0, 0
        while not fresh[row - round(since / h)] and since < row * h:
            since += h
        for ahead in range(1, horizons[-1] + 1):
            for i in range(13):
                before[i] = y[i]
            _advance(c, drv, kick, speed, row, h, y, w, still)
            wanted = ahead == horizons[g]
            since += h
            if every or wanted:
                force = _slope_at(c, drv, kick, speed, row, 2, h, y, still, dy)
                if sensor.gyro_lag > 0.0:
                    _lag(sensor, h, before, w[0], y, dy, lagged)
                _sense(sensor, force, y, dy, lagged, gyro, acceleration)
            row += 1
            if sensor.lean > 0.0:
                _smooth(acceleration, h, filt)
                if fresh[row]:
                    _fuse(sensor, gyro, since, filt)
                    for i in range(4):
                        held[i] = filt[i]
            elif fresh[row]:
                for i in range(4):
                    held[i] = y[6 + i]
                if sensor.rotated != 0:
                    _product(y[6:10], mount, held)
            if fresh[row]:
                since = 0.0
            if wanted:
                for i in range(3):
                    measured[k, g, i] = gyro[i]
                    measured[k, g, 3 + i] = acceleration[i]
                _angles(held, report)
                for i in range(3):
                    measured[k, g, 6 + i] = report[i]
                g += 1
        for i in range(17):
            ends[k, i] = y[i]
        for i in range(3):
            ends[k, 17 + i] = lagged[i]
        for i in range(10):
            ends[k, 20 + i] = filt[i]
        for i in range(4):
            ends[k, 30 + i] = held[i]


@njit(nogil=True, cache=True, error_model="numpy")
def observe(
    craft: Any,
    sensor: Any,
    mount: Any,
    drv: Any,
    kick: Any,
    speed: Any,
    h: float,
    gyro: Any,
    accelerometer: Any,
    attitude: Any,
    fresh: Any,
    flying: Any,
    height: Any,
    gain_fresh: Any,
    gain_stale: Any,
    carry: Any,
    goes_on: bool,
    states: Any,
    lags: Any,
    filters: Any,
    innovations: Any,
) -> None:
    """The state behind every row, from the past alone: the model, corrected by measurements.

    Row by row the model predicts gyro, accelerometer and attitude; gains (12, 12) turn the
    errors and the velocity itself, as if it were known to be about zero, into corrections of
    attitude, rates, low-passed rates and velocity in body axes. Velocity is the integral of the
    measured specific force. On the ground (``flying`` false) the state is what is measured.
    gyro, accelerometer, attitude: (n, 3), NaN where a row lacks it. height: (n,) m.
    carry: (34,) body, lag, filter, acceleration and time since a new attitude at the last row;
    with ``goes_on`` those of row 0, where an earlier call ended.
    Fills states (n, 17), lags (n, 3), filters (n, 10), innovations (n, 9; 0 where not known).
    """
    c = constants(craft)
    rows = len(gyro)
    y, lagged, filt = np.zeros(17), np.zeros(3), np.zeros(10)
    dy, before, w, still = np.zeros(17), np.empty(17), np.zeros((4, 17)), np.zeros(6)
    rate, felt, q, error, turn = np.empty(3), np.empty(3), np.empty(4), np.zeros(12), np.empty(4)
    back, own = np.empty(4), np.empty(3)
    now, then, force3 = np.zeros(3), np.zeros(3), np.empty(3)
    back[0] = mount[0]
    for i in range(1, 4):
        back[i] = -mount[i]
    m = sensor.mounting
    since = 0.0
    y[6], filt[0] = 1.0, 1.0
    for j in range(rows):
        known_rate = not math.isnan(gyro[j, 0])
        known_force = not math.isnan(accelerometer[j, 0])
        known_angle = not math.isnan(attitude[j, 0])
        since += h
        if j == 0 and goes_on:
            for i in range(17):
                y[i] = carry[i]
            for i in range(3):
                lagged[i], then[i] = carry[17 + i], carry[30 + i]
            for i in range(10):
                filt[i] = carry[20 + i]
            since = carry[33]
        elif j == 0 or not flying[j]:
            for i in range(3):
                if known_rate:
                    own[i] = gyro[j, i] - sensor.gyro_bias[i]
                y[i], y[3 + i], then[i] = 0.0, 0.0, 0.0
            if known_rate:
                for i in range(3):
                    y[10 + i] = m[i, 0] * own[0] + m[i, 1] * own[1] + m[i, 2] * own[2]
                    lagged[i] = y[10 + i]
            if known_angle:
                _quaternion(attitude[j], q)
                for i in range(4):
                    filt[i] = q[i]
                _product(q, back, y[6:10])
            for i in range(3):
                if known_force:
                    filt[4 + i] = accelerometer[j, i]
            for i in range(4):
                y[13 + i] = speed[2 * j, i]
            since = 0.0
        else:
            for i in range(17):
                before[i] = y[i]
            if not math.isnan(height[j - 1]):
                y[2] = height[j - 1]
            _advance(c, drv, kick, speed, j - 1, h, y, w, still)
            force = _slope_at(c, drv, kick, speed, j - 1, 2, h, y, still, dy)
            if sensor.gyro_lag > 0.0:
                _lag(sensor, h, before, w[0], y, dy, lagged)
            _sense(sensor, force, y, dy, lagged, rate, felt)
            for i in range(12):
                error[i] = 0.0
            for i in range(3):
                if known_rate:
                    error[i] = gyro[j, i] - rate[i]
                if known_force:
                    error[3 + i] = accelerometer[j, i] - felt[i]
                    own[i] = accelerometer[j, i] - sensor.accelerometer_bias[i]
                else:
                    own[i] = felt[i] - sensor.accelerometer_bias[i]
            lx, ly, lz = _lever(sensor, y, dy)
            for i in range(3):
                force3[i] = m[i, 0] * own[0] + m[i, 1] * own[1] + m[i, 2] * own[2]
            force3[0] -= lx
            force3[1] -= ly
            force3[2] -= lz
            _turn(y[6:10], force3, now)
            now[2] -= c.gravity
            if not flying[j - 1]:
                for i in range(3):
                    then[i] = now[i]
            for i in range(3):
                y[3 + i] = before[3 + i] + 0.5 * h * (then[i] + now[i])
                then[i] = now[i]
            if sensor.lean > 0.0:
                for i in range(3):
                    own[i] = accelerometer[j, i] if known_force else felt[i]
                    if known_rate:
                        rate[i] = gyro[j, i]
                _smooth(own, h, filt)
                if fresh[j]:
                    _fuse(sensor, rate, since, filt)
            new = fresh[j] and known_angle
            if fresh[j]:
                since = 0.0
            if new:
                _quaternion(attitude[j], q)
                if sensor.lean > 0.0:
                    for i in range(4):
                        turn[i] = filt[i]
                        filt[i] = q[i]
                else:
                    _product(y[6:10], mount, turn)
                for i in range(1, 4):
                    turn[i] = -turn[i]
                _product(turn, q, turn)
                scale = 2.0 if turn[0] >= 0.0 else -2.0
                for i in range(3):
                    own[i] = scale * turn[1 + i]
                for i in range(3):
                    error[6 + i] = m[i, 0] * own[0] + m[i, 1] * own[1] + m[i, 2] * own[2]
            _unturn(y[6:10], y[3:6], own)
            for i in range(3):
                error[9 + i] = -own[i]
            _correct(gain_fresh if new else gain_stale, error, y, lagged, sensor.gyro_lag > 0.0)
            for i in range(9):
                innovations[j, i] = error[i]
        for i in range(17):
            states[j, i] = y[i]
        for i in range(3):
            lags[j, i] = lagged[i]
        for i in range(10):
            filters[j, i] = filt[i]
    for i in range(17):
        carry[i] = y[i]
    for i in range(3):
        carry[17 + i], carry[30 + i] = lagged[i], then[i]
    for i in range(10):
        carry[20 + i] = filt[i]
    carry[33] = since


@inner
def _unturn(q: Any, v: Any, out: Any) -> None:
    """An inertial vector in the body frame."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c = v[0], v[1], v[2]
    out[0] = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y + w * z) * b + 2 * (x * z - w * y) * c
    out[1] = 2 * (x * y - w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z + w * x) * c
    out[2] = 2 * (x * z + w * y) * a + 2 * (y * z - w * x) * b + (1 - 2 * (x * x + y * y)) * c


@inner
def _correct(gain: Any, error: Any, y: Any, lagged: Any, lags: bool) -> None:
    delta = np.zeros(12)
    for i in range(12):
        total = 0.0
        for k in range(12):
            total += gain[i, k] * error[k]
        delta[i] = total
    velocity, turn = np.empty(3), np.empty(4)
    _turn(y[6:10], delta[9:12], velocity)
    turn[0] = 1.0
    for i in range(3):
        turn[1 + i] = 0.5 * delta[i]
        y[10 + i] += delta[3 + i]
        lagged[i] = lagged[i] + delta[6 + i] if lags else y[10 + i]
        y[3 + i] += velocity[i]
    _product(y[6:10], turn, y[6:10])
    norm = 1.0 / math.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
    for i in range(6, 10):
        y[i] *= norm
