"""Compiled flight on recorded inputs: motors, observer, prediction.

Row i of a recording shows the craft at t_i less the dead time. All of this works on that shifted
grid: ``spin`` runs the motors on inputs that change at t_i and gives their speeds on the shifted
grid, at its points and half-way; body and sensors then know no delay.

A body state is that of ``dynamics/kernels.py``; a filter state that of the attitude filter in
``dynamics/sensing.py``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import called, inner, kernel, spliced
from groundstation.dynamics import sensing as quaternion
from groundstation.dynamics.craft import SENSOR_STATES
from groundstation.dynamics.effect import FAR_M, Body, Reading
from groundstation.dynamics.kernels import (
    ALL,
    armature_of,
    body_slope,
    four,
    motor_slopes,
    normalise,
    physics,
    runge_kutta,
)
from groundstation.dynamics.sensing import (
    ROOM,
    begin,
    carried,
    estimated,
    feel,
    follow,
    fuse,
    sense,
    smoothed,
)
from groundstation.dynamics.sensors import FILTER

NO_BODY = Body(
    FAR_M,
    (1.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0),
    0.0,
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0),
)
NO_READING = Reading((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@spliced
def _motors_slope(context: Any, half: int, n: Any, dn: Any) -> None:
    p, volts = context
    dn[0], dn[1], dn[2], dn[3] = motor_slopes(p, volts, (n[0], n[1], n[2], n[3]), ALL)


_motors_step = runge_kutta(_motors_slope)


@spliced
def _armature_at(craft: Any, duty: Any, supply: Any, setting: int, period: float, n: Any) -> Any:
    here = min(max(setting, 0), len(duty) - 1)
    at = here // (len(duty) // len(supply))
    driven = (duty[here, 0], duty[here, 1], duty[here, 2], duty[here, 3])
    speed = (n[0], n[1], n[2], n[3])
    return armature_of(craft, driven, supply[at], supply[max(at - 1, 0)], period, speed)


@kernel
def spin(
    craft: Any, duty: Any, supply: Any, period: float, delay: float, start: Any, speed: Any
) -> None:
    """Rotor speeds (2 n - 1, 4) at every row less ``delay``, and half-way to the next.

    duty: (n, 4), supply: (n,) mV as reported; row i acts from t_(i-1) to t_i. A duty of (2 n, 4)
    has two settings a row, each for half a period. start: (4,) at the first point.
    """
    p = physics(craft)
    rows = len(supply)
    each = len(duty) // rows
    n, dn, base, total = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    for i in range(4):
        n[i] = start[i]
        speed[0, i] = start[i]
    offset = delay / period
    # Settings count from the one that ends at the first row, which is number each - 1.
    ended = math.floor(-offset * each) + 1
    volts = _armature_at(craft, duty, supply, ended + each - 1, period, n)
    for point in range(1, 2 * rows - 1):
        at = 0.5 * (point - 1) - offset
        left = 0.5
        while left > 1e-9:
            step = min(ended / each - at, left)
            if step < 1e-9:
                ended += 1
                volts = _armature_at(craft, duty, supply, ended + each - 1, period, n)
                continue
            _motors_step((p, volts), step * period, 4, n, dn, base, total)
            at += step
            left -= step
        for i in range(4):
            speed[point, i] = n[i]


@kernel
def drives(craft: Any, speed: Any, period: float, out: Any) -> None:
    """What rotors at speeds (2 n - 1, 4) do to a craft at rest, (2 n - 1, 5): specific force along
    z far from the ground and on it, m/s^2, and angular acceleration, rad/s^2."""
    size = 17 + craft.body_states
    y, dy = np.zeros(size), np.zeros(size)
    y[6] = 1.0
    for i in range(craft.body_states):
        y[17 + i] = craft.body_initial[i]
    for k in range(len(speed)):
        row = min(k // 2, len(speed) // 2 - 1)
        y[2] = FAR_M
        body = _body_at(craft, speed, row, k - 2 * row, period, y, dy)
        out[k, 0], out[k, 1] = body.force[2], body.force[2]
        out[k, 2], out[k, 3], out[k, 4] = body.angular
        if craft.acts_rotor != 0:
            y[2] = 0.0
            out[k, 1] = _body_at(craft, speed, row, k - 2 * row, period, y, dy).force[2]


@inner
def _row_slope(speed: Any, row: int, period: float) -> Any:
    """Mean slope (4) of the rotors' speeds over a row."""
    one, other = 2 * row, 2 * row + 2
    return (
        (speed[other, 0] - speed[one, 0]) / period,
        (speed[other, 1] - speed[one, 1]) / period,
        (speed[other, 2] - speed[one, 2]) / period,
        (speed[other, 3] - speed[one, 3]) / period,
    )


@called
def _body_at(craft: Any, speed: Any, row: int, half: int, period: float, y: Any, dy: Any) -> Any:
    """The body at the start (half 0) or end (2) of a row's period; fills its slope."""
    n = four(speed[2 * row + half])
    return body_slope(physics(craft), n, _row_slope(speed, row, period), STILL, y, dy, ALL)


@spliced
def _slope(context: Any, half: int, y: Any, dy: Any) -> None:
    p, speed, row, slope = context
    at = 2 * row + half
    n = (speed[at, 0], speed[at, 1], speed[at, 2], speed[at, 3])
    body_slope(p, n, slope, STILL, y, dy, ALL)


_step = runge_kutta(_slope)


@spliced
def _advance(
    craft: Any,
    p: Any,
    way: Any,
    speed: Any,
    row: int,
    h: float,
    y: Any,
    work: Any,
    z: Any,
    read: bool,
) -> Any:
    """One period of body and sensors, from point ``row`` to the next; their (body, reading) there.

    way: how the sensors' states go on (``carried``). y: body; z (ROOM, SENSOR_STATES): states of
    the sensors, and room; work (3, size): room. read: whether the reading is wanted; it is made all
    the same where the sensors have states.
    """
    slope = _row_slope(speed, row, h)
    dy = work[0]
    before, body, reading = NO_BODY, NO_BODY, NO_READING
    if craft.sensor_states > 0:
        before = _body_at(craft, speed, row, 0, h, y, dy)
    _step((p, speed, row, slope), h, 17 + craft.body_states, y, dy, work[1], work[2])
    normalise(y)
    for i in range(4):
        y[13 + i] = speed[2 * row + 2, i]
    if read or craft.sensor_states > 0:
        body = _body_at(craft, speed, row, 2, h, y, dy)
        if craft.sensor_states > 0:
            follow(craft, way, before, body, h, z)
        reading = sense(craft, body, z[0], z[1])
    return body, reading


@spliced
def _lean(f: Any, sensor: Any, gyro: Any, felt: Any, h: float, fresh: bool, since: float) -> None:
    """The attitude filter f one row later; it turns on fresh rows. The firmware takes off the bias
    that it found at rest."""
    kept = smoothed((f[4], f[5], f[6]), felt, h, sensor.smoothing)
    f[4], f[5], f[6] = kept
    if fresh:
        rate = (gyro[0] - sensor.zero[0], gyro[1] - sensor.zero[1], gyro[2] - sensor.zero[2])
        gains = (sensor.gains[0], sensor.gains[1])
        q, integral = fuse((f[0], f[1], f[2], f[3]), (f[7], f[8], f[9]), rate, kept, gains, since)
        f[0], f[1], f[2], f[3] = q
        f[7], f[8], f[9] = integral


@kernel
def coast(
    craft: Any,
    sensor: Any,
    speed: Any,
    h: float,
    fresh: Any,
    rows: Any,
    horizons: Any,
    states: Any,
    sensed: Any,
    filters: Any,
    shown: Any,
    measured: Any,
) -> None:
    """From the state at each of ``rows`` (m,) fly on the inputs alone; no measurement is read.

    horizons: (g,) rows ahead, ascending. fresh: (n,) rows whose attitude is new. states (m, 17 +
    the effects'), sensed (m, SENSOR_STATES), filters (m, 10), shown (m, 4): body, sensors'
    states, attitude filter and the quaternion last reported, at ``rows``, and changed to those
    at the last horizon. Fills measured (m, g, 9): gyro, accelerometer, roll pitch yaw.
    """
    p, way = physics(craft), carried(craft, h)
    size = 17 + craft.body_states
    work, z = np.zeros((3, size)), np.zeros((ROOM, SENSOR_STATES))
    leans = sensor.gains[0] > 0.0
    mount = four(sensor.mount)
    for k in range(len(rows)):
        y, f, held = states[k], filters[k], shown[k]
        for i in range(SENSOR_STATES):
            z[0, i] = sensed[k, i]
        row, since, g = rows[k], 0.0, 0
        while not fresh[row - round(since / h)] and since < row * h:
            since += h
        for ahead in range(1, horizons[-1] + 1):
            wanted = ahead == horizons[g]
            _, reading = _advance(craft, p, way, speed, row, h, y, work, z, leans or wanted)
            since += h
            row += 1
            if leans:
                felt = reading.accelerometer
                _lean(f, sensor, reading.gyro, felt, h, fresh[row], since)
                if fresh[row]:
                    held[0], held[1], held[2], held[3] = f[0], f[1], f[2], f[3]
            elif fresh[row]:
                q = estimated(craft, (y[6], y[7], y[8], y[9]), z[0])
                if sensor.rotated != 0:
                    q = quaternion.product(q, mount)
                held[0], held[1], held[2], held[3] = q
            if fresh[row]:
                since = 0.0
            if wanted:
                report = quaternion.angles((held[0], held[1], held[2], held[3]))
                for i in range(3):
                    measured[k, g, i] = reading.gyro[i]
                    measured[k, g, 3 + i] = reading.accelerometer[i]
                    measured[k, g, 6 + i] = report[i]
                g += 1
        for i in range(SENSOR_STATES):
            sensed[k, i] = z[0, i]


@inner
def _turned(m: Any, v: Any) -> Any:
    """A matrix times a vector."""
    return (
        m[0, 0] * v[0] + m[0, 1] * v[1] + m[0, 2] * v[2],
        m[1, 0] * v[0] + m[1, 1] * v[1] + m[1, 2] * v[2],
        m[2, 0] * v[0] + m[2, 1] * v[1] + m[2, 2] * v[2],
    )


@inner
def _moving(rate: Any, force: Any) -> Any:
    one = NO_BODY
    still = (0.0, 0.0, 0.0)
    return Body(FAR_M, one.quaternion, still, rate, one.rotor, one.rotor, 0.0, still, force)


@spliced
def _land(
    craft: Any, sensor: Any, gyro: Any, accelerometer: Any, attitude: Any, y: Any, z: Any, f: Any
) -> None:
    """On the ground the state is what is measured."""
    for i in range(3):
        y[i], y[3 + i] = 0.0, 0.0
    if not math.isnan(attitude[0]):
        q = quaternion.of_angles((attitude[0], attitude[1], attitude[2]))
        f[0], f[1], f[2], f[3] = q
        back = quaternion.conjugate(four(sensor.mount))
        y[6], y[7], y[8], y[9] = quaternion.product(q, back)
    for i in range(craft.body_states):
        y[17 + i] = craft.body_initial[i]
    rate, felt = (y[10], y[11], y[12]), (f[4], f[5], f[6])
    m, zero = sensor.mounting, sensor.zero
    if not math.isnan(gyro[0]):
        rate = _turned(m, (gyro[0] - zero[0], gyro[1] - zero[1], gyro[2] - zero[2]))
        y[10], y[11], y[12] = rate
    if not math.isnan(accelerometer[0]):
        felt = (accelerometer[0], accelerometer[1], accelerometer[2])
        f[4], f[5], f[6] = felt
    force = _turned(m, (felt[0] - zero[3], felt[1] - zero[4], felt[2] - zero[5]))
    begin(craft, _moving(rate, force), z)


@kernel
def observe(
    craft: Any,
    sensor: Any,
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
    start: Any,
    carry: Any,
    goes_on: bool,
    states: Any,
    sensed: Any,
    filters: Any,
    innovations: Any,
) -> None:
    """The state behind every row, from the past alone: the model, corrected by measurements.

    Row by row the model predicts gyro, accelerometer and attitude; gains (e, 12) turn the
    errors and the velocity itself, as if it were known to be about zero, into corrections of
    attitude, rates, delayed rates and velocity in body axes. Velocity is the integral of the
    measured specific force. On the ground (``flying`` false) the state is what is measured.
    gyro, accelerometer, attitude: (n, 3), NaN where a row lacks it. height: (n,) m.
    start: inertial velocity (3,) at row 0 where it is in the air and nothing goes on.
    carry: acceleration (3,), time since a new attitude, body, sensors and filter at the last row;
    with ``goes_on`` those of row 0, where an earlier call ended.
    Fills states (n, 17 + the effects'), sensed (n, SENSOR_STATES), filters (n, 10), innovations
    (n, 9; 0 where not known).
    """
    p, way = physics(craft), carried(craft, h)
    size = 17 + craft.body_states
    y, work, z = np.zeros(size), np.zeros((3, size)), np.zeros((ROOM, SENSOR_STATES))
    f, error = np.zeros(FILTER), np.zeros(12)
    m, mount = sensor.mounting, four(sensor.mount)
    leans = sensor.gains[0] > 0.0
    places = _places(craft, len(gain_fresh))
    then, since = (0.0, 0.0, 0.0), 0.0
    y[6], f[0] = 1.0, 1.0
    for j in range(len(gyro)):
        since += h
        known = not math.isnan(gyro[j, 0]), not math.isnan(accelerometer[j, 0])
        if j == 0 and goes_on:
            then, since = (carry[0], carry[1], carry[2]), carry[3]
            for i in range(size):
                y[i] = carry[4 + i]
            for i in range(SENSOR_STATES):
                z[0, i] = carry[4 + size + i]
            for i in range(FILTER):
                f[i] = carry[4 + size + SENSOR_STATES + i]
        elif j == 0 or not flying[j]:
            _land(craft, sensor, gyro[j], accelerometer[j], attitude[j], y, z[0], f)
            for i in range(4):
                y[13 + i] = speed[2 * j, i]
            if flying[j]:
                y[3], y[4], y[5] = start[0], start[1], start[2]
            then, since = (0.0, 0.0, 0.0), 0.0
        else:
            before = (y[3], y[4], y[5])
            if not math.isnan(height[j - 1]):
                y[2] = height[j - 1]
            body, reading = _advance(craft, p, way, speed, j - 1, h, y, work, z, True)
            shown, felt = reading.gyro, reading.accelerometer
            if known[0]:
                shown = (gyro[j, 0], gyro[j, 1], gyro[j, 2])
            if known[1]:
                felt = (accelerometer[j, 0], accelerometer[j, 1], accelerometer[j, 2])
            surplus = (
                felt[0] - reading.accelerometer[0],
                felt[1] - reading.accelerometer[1],
                felt[2] - reading.accelerometer[2],
            )
            for i in range(3):
                error[i] = shown[i] - reading.gyro[i]
                error[3 + i] = surplus[i]
                error[6 + i] = 0.0
            more = _turned(m, surplus)
            force = (body.force[0] + more[0], body.force[1] + more[1], body.force[2] + more[2])
            now = quaternion.to_inertial((y[6], y[7], y[8], y[9]), force)
            now = (now[0], now[1], now[2] - craft.gravity)
            if not flying[j - 1]:
                then = now
            for i in range(3):
                y[3 + i] = before[i] + 0.5 * h * (then[i] + now[i])
            then = now
            if leans:
                _lean(f, sensor, shown, felt, h, fresh[j], since)
            if craft.turning != 0 and known[1]:
                feel(craft, body, force, h, z)
            new = fresh[j] and not math.isnan(attitude[j, 0])
            if fresh[j]:
                since = 0.0
            if new:
                q = quaternion.of_angles((attitude[j, 0], attitude[j, 1], attitude[j, 2]))
                expected = (f[0], f[1], f[2], f[3])
                if leans:
                    f[0], f[1], f[2], f[3] = q
                else:
                    q_seen = estimated(craft, (y[6], y[7], y[8], y[9]), z[0])
                    expected = quaternion.product(q_seen, mount)
                turn = quaternion.product(quaternion.conjugate(expected), q)
                scale = 2.0 if turn[0] >= 0.0 else -2.0
                off = _turned(m, (scale * turn[1], scale * turn[2], scale * turn[3]))
                error[6], error[7], error[8] = off
            wind = quaternion.to_body((y[6], y[7], y[8], y[9]), (y[3], y[4], y[5]))
            error[9], error[10], error[11] = -wind[0], -wind[1], -wind[2]
            _correct(craft, gain_fresh if new else gain_stale, places, error, y, z[0])
            for i in range(9):
                innovations[j, i] = error[i]
        for i in range(size):
            states[j, i] = y[i]
        for i in range(SENSOR_STATES):
            sensed[j, i] = z[0, i]
        for i in range(FILTER):
            filters[j, i] = f[i]
    carry[0], carry[1], carry[2], carry[3] = then[0], then[1], then[2], since
    for i in range(size):
        carry[4 + i] = y[i]
    for i in range(SENSOR_STATES):
        carry[4 + size + i] = z[0, i]
    for i in range(FILTER):
        carry[4 + size + SENSOR_STATES + i] = f[i]


@inner
def _heading(q: Any) -> Any:
    """Where the nose points over ground, (east, north) of length 1."""
    nose = quaternion.to_inertial(q, (1.0, 0.0, 0.0))
    level = max(math.hypot(nose[0], nose[1]), 1e-9)
    return nose[0] / level, nose[1] / level


@spliced
def _places(craft: Any, size: int) -> Any:
    """Which of ``size`` corrections is that of each filter behind the gyro (SENSOR_STATES,): an
    axis's delayed rate for the last one, of its own for one before it; -1 for no such filter."""
    found = np.full(SENSOR_STATES, -1)
    if craft.sensor_states > 0:
        place = 12
        for i in range(craft.body_states):
            if place < size and craft.body_noise[i] > 0.0:
                place += 1
        for i in range(SENSOR_STATES):
            axis = craft.follows[i]
            if 0 <= axis < 3:
                found[i] = 6 + axis
                for j in range(i + 1, SENSOR_STATES):
                    if craft.follows[j] == axis:  # a later filter shows it
                        found[i] = place
                if found[i] == place:
                    place += 1
    return found


@spliced
def _correct(craft: Any, gain: Any, places: Any, error: Any, y: Any, z: Any) -> None:
    delta = np.zeros(len(gain))
    for i in range(len(gain)):
        total = 0.0
        for k in range(12):
            total += gain[i, k] * error[k]
        delta[i] = total
    q = (y[6], y[7], y[8], y[9])
    velocity = quaternion.to_inertial(q, (delta[9], delta[10], delta[11]))
    for i in range(3):
        y[10 + i] += delta[3 + i]
        y[3 + i] += velocity[i]
    place, ahead = 12, (1.0, 0.0)
    if craft.body_states > 0:
        ahead = _heading(q)
    for i in range(craft.body_states):
        if place < len(gain) and craft.body_noise[i] > 0.0:
            more = delta[place]
            if craft.body_inertial[i] == 1:  # gains are those of a craft that heads along x
                more = ahead[0] * delta[place] - ahead[1] * delta[place + 1]
            elif craft.body_inertial[i] == 2:
                more = ahead[1] * delta[place - 1] + ahead[0] * delta[place]
            y[17 + i] += more
            place += 1
    for i in range(len(places)):
        if places[i] >= 0:
            z[i] += delta[places[i]]
    turn = (1.0, 0.5 * delta[0], 0.5 * delta[1], 0.5 * delta[2])
    y[6], y[7], y[8], y[9] = quaternion.normalised(quaternion.product(q, turn))
