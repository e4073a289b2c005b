"""What gyro and accelerometer show of a craft, compiled: rotations, the attitude filter, the
sensors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import called, inner, kernel, spliced
from groundstation.dynamics import effect as law
from groundstation.dynamics.chains import chain, loader, own_chain, reckoned, state_access
from groundstation.dynamics.craft import LISTED_STATES, SENSOR_STATES, first_state
from groundstation.dynamics.effect import FAR_M, Body, Reading, butterworth_behind
from groundstation.dynamics.kernels import ALL, LISTED, SENSOR, craft_of, own_values, runge_kutta

# Rotations inside kernels: unit quaternions (w, x, y, z), body to inertial, as tuples.
#
# For arrays, and for the conventions, see ``rotations.py``; ``to_inertial`` and ``to_body`` are
# those of ``effect.py``.


to_inertial = inner(law.to_inertial)


@inner
def conjugate(q: Any) -> Any:
    """The rotation back."""
    return q[0], -q[1], -q[2], -q[3]


@inner
def to_body(q: Any, v: Any) -> Any:
    """An inertial vector in body axes."""
    return to_inertial((q[0], -q[1], -q[2], -q[3]), v)


@inner
def product(a: Any, b: Any) -> Any:
    """The rotation b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@inner
def normalised(q: Any) -> Any:
    """The same rotation with length 1."""
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


@inner
def slope(q: Any, rate: Any) -> Any:
    """dq/dt at body rates in rad/s."""
    w, x, y, z = q
    a, b, c = rate
    return (
        0.5 * (-x * a - y * b - z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
    )


@inner
def angles(q: Any) -> Any:
    """Roll, pitch (nose down positive), yaw in rad (thesis eq. 3.6)."""
    w, x, y, z = q
    return (
        math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(min(max(2.0 * (w * y - x * z), -1.0), 1.0)),
        math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)),
    )


@inner
def of_angles(attitude: Any) -> Any:
    """The quaternion of roll, pitch, yaw in rad."""
    cr, sr = math.cos(0.5 * attitude[0]), math.sin(0.5 * attitude[0])
    cp, sp = math.cos(0.5 * attitude[1]), math.sin(0.5 * attitude[1])
    cy, sy = math.cos(0.5 * attitude[2]), math.sin(0.5 * attitude[2])
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


# The on-board attitude filter: Mahony, Hamel and Pflimlin, 2008, as the Crazyflie firmware has it.
#
# A filter is ten numbers: quaternion 0-3, accelerometer as the filter has it 4-6, integral of the
# error 7-9. Release 2014.01.0 smooths the accelerometer for the filter alone
# (``imu_acc_lpf.factor`` 32 of 256); today's complementary estimator takes what its sensors' own
# low-pass leaves (``estimator_complementary.c``).


SMOOTHING, SMOOTHING_S = 0.125, 0.002
"""The accelerometer filter of 2014's firmware: share of each new sample, at this period."""
UNSMOOTHED = 1.0
"""Such a share of today's."""


@inner
def smoothed(before: Any, accelerometer: Any, period: float, share: float) -> Any:
    """The accelerometer as the filter has it, one sample later. share: ``SMOOTHING`` or
    ``UNSMOOTHED``."""
    if period != SMOOTHING_S:
        share = 1.0 - (1.0 - share) ** (period / SMOOTHING_S)
    return (
        before[0] + share * (accelerometer[0] - before[0]),
        before[1] + share * (accelerometer[1] - before[1]),
        before[2] + share * (accelerometer[2] - before[2]),
    )


@inner
def fuse(q: Any, integral: Any, gyro: Any, felt: Any, gains: Any, period: float) -> Any:
    """One pass: (quaternion, integral) from the gyro (rad/s) and what the accelerometer feels.

    gains: proportional (1/s) and integral (1/s^2); a first-order step over ``period``.
    """
    w, x, y, z = q
    ex, ey, ez = 0.0, 0.0, 0.0
    size = math.sqrt(felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2])
    if size > 0.0:
        ax, ay, az = felt[0] / size, felt[1] / size, felt[2] / size
        # Up in sensor axes as the filter has it, and how far the accelerometer is from it.
        ux, uy, uz = 2.0 * (x * z - w * y), 2.0 * (w * x + y * z), w * w - x * x - y * y + z * z
        ex, ey, ez = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    step = gains[1] * period
    kept = (integral[0] + step * ex, integral[1] + step * ey, integral[2] + step * ez)
    rate = (
        gyro[0] + kept[0] + gains[0] * ex,
        gyro[1] + kept[1] + gains[0] * ey,
        gyro[2] + kept[2] + gains[0] * ez,
    )
    turn = slope(q, rate)
    moved = (
        w + period * turn[0],
        x + period * turn[1],
        y + period * turn[2],
        z + period * turn[3],
    )
    return normalised(moved), kept


# What gyro and accelerometer show of a craft, with the sensors' effects and their states.


sensor_chain, own_sensor = chain("sensor"), own_chain("sensor")
read_states, write_states = state_access("sensor")
load = loader("sensor")
OWN_SENSOR = LISTED_STATES["sensor"]
GYRO_FILTER = first_state("gyro_filter")
ROOM = 6
"""Rows of states that it takes to follow them."""
STEP = 0.5
"""Longest step of the integrator over the fastest time constant, where a user's own sensors act:
what a filter has of a jump is off by 0.02 % of it at most."""
TERMS = 14
"""Of a series in a matrix whose entries sum to 0.5 at most: what is left out is below 1e-15."""
MOST_DOUBLINGS = 1000.0
"""A filter that is faster still forgets all."""
SETTLE_S, SETTLE_STEP_S = 2.0, 0.002


@spliced
def sense(craft: Any, body: Any, z: Any, dz: Any) -> Any:
    """The ``Reading`` of a body by a ``CRAFT`` record and sensors' states z (``SENSOR_STATES``,);
    fills their slopes."""
    reading = Reading(body.rate, body.force, body.rotor)
    if craft.acts_sensor != 0:
        reading = _acted_on(craft, body, z, dz, ALL)
    return reading


@spliced
def _acted_on(craft: Any, body: Any, z: Any, dz: Any, who: int) -> Any:
    """The same where effects act. who: a constant, ``LISTED`` or ``ALL`` of them."""
    c, before = craft_of(craft), Reading(body.rate, body.force, body.rotor)
    reading, slopes = sensor_chain(load(craft)[0], c, body, before, read_states(z, 0))
    write_states(dz, 0, slopes)
    if who == ALL and craft.own[SENSOR] != 0:
        own = craft.own[SENSOR]
        reading = own_sensor(own, own_values(craft), c, body, reading, z, dz, OWN_SENSOR)
    return reading


@inner
def estimated(craft: Any, q: Any, z: Any) -> Any:
    """The attitude q as an estimator on board has it, which turns by what the gyro shows: behind
    the firmware's filter (``sensors_bmi088_bmp3xx.c`` gives the estimator filtered rates), and by
    what effects add."""
    if craft.turning != 0:
        roll, pitch, yaw = angles(q)
        for i in range(SENSOR_STATES):
            if craft.turns[i] == 0:
                roll += z[i]
            elif craft.turns[i] == 1:
                pitch += z[i]
            elif craft.turns[i] == 2:
                yaw += z[i]
        q = of_angles((roll, pitch, yaw))
    if craft.gyro_filter[0] == 0.0:
        return q
    i = GYRO_FILTER
    state = (z[i], z[i + 1], z[i + 2], z[i + 3], z[i + 4], z[i + 5])
    x, y, w = butterworth_behind(state, craft.gyro_filter[1])
    return normalised(product(q, (1.0, -0.5 * x, -0.5 * y, -0.5 * w)))


@spliced
def feel(craft: Any, body: Any, force: Any, h: float, room: Any) -> None:
    """Lean by the specific force that was measured over the row before a body, not by its own.

    room: (ROOM, states); the first are the sensors' states, of which those change that turn
    reported angles.
    """
    sense(craft, body, room[0], room[1])
    sense(craft, reckoned(body, (body.angular, force)), room[0], room[2])
    for i in range(SENSOR_STATES):
        if craft.turns[i] >= 0:
            room[0, i] += h * (room[2, i] - room[1, i])


@inner
def between(one: Any, other: Any, span: float, share: float) -> Any:
    """A body within a row: rates by Hermite's cubic, specific force linear, the rest from the end.

    span: s between the two; share: 0..1.
    """
    s, r = share, 1.0 - share
    rate0, rate1, slope0, slope1 = one.rate, other.rate, one.angular, other.angular
    a, b = (1.0 + 2.0 * s) * r * r, s * s * (3.0 - 2.0 * s)
    c, d = span * s * r * r, -span * s * s * r
    e, f, g = 6.0 * s * r / span, (1.0 - 3.0 * s) * r, s * (3.0 * s - 2.0)
    rate = (
        a * rate0[0] + b * rate1[0] + c * slope0[0] + d * slope1[0],
        a * rate0[1] + b * rate1[1] + c * slope0[1] + d * slope1[1],
        a * rate0[2] + b * rate1[2] + c * slope0[2] + d * slope1[2],
    )
    angular = (
        e * (rate1[0] - rate0[0]) + f * slope0[0] + g * slope1[0],
        e * (rate1[1] - rate0[1]) + f * slope0[1] + g * slope1[1],
        e * (rate1[2] - rate0[2]) + f * slope0[2] + g * slope1[2],
    )
    force = (
        r * one.force[0] + s * other.force[0],
        r * one.force[1] + s * other.force[1],
        r * one.force[2] + s * other.force[2],
    )
    return Body(
        other.height,
        other.quaternion,
        other.velocity,
        rate,
        other.rotor,
        other.rotor_slope,
        other.thrust,
        angular,
        force,
    )


@called
def carried(craft: Any, span: float) -> Any:
    """How the states of listed sensors' effects, which are linear in them, go on over ``span`` s.

    Returns (m, 2): the state that each entry goes to and the one it comes from; (m, 4): what it
    multiplies of that state, and of the slope that the craft alone makes of it at the start, in the
    middle and at the end: exact where this slope is a parabola in time.
    """
    size = OWN_SENSOR if craft.sensor_states > 0 and craft.own[SENSOR] == 0 else 0
    z, alone, slopes = np.zeros(SENSOR_STATES), np.zeros(SENSOR_STATES), np.zeros(SENSOR_STATES)
    zero, still = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), zero, zero, still, still, 0.0, zero, zero)
    a = np.zeros((size, size))
    if size > 0:
        _acted_on(craft, body, z, alone, LISTED)
    for k in range(size):
        z[k] = 1.0
        _acted_on(craft, body, z, slopes, LISTED)
        z[k] = 0.0
        for i in range(size):
            a[i, k] = span * (slopes[i] - alone[i])
    whole, first, second, third = _phi(a)
    places, gains, m = np.empty((size * size, 2), np.int64), np.empty((size * size, 4)), 0
    for i in range(size):
        for k in range(size):
            if first[i, k] != 0.0:
                places[m, 0], places[m, 1] = i, k
                gains[m, 0] = whole[i, k]
                gains[m, 1] = span * (first[i, k] - 3.0 * second[i, k] + 4.0 * third[i, k])
                gains[m, 2] = span * (4.0 * second[i, k] - 8.0 * third[i, k])
                gains[m, 3] = span * (4.0 * third[i, k] - second[i, k])
                m += 1
    return places[:m], gains[:m]


@called
def _times(a: Any, b: Any) -> Any:
    """A matrix times another."""
    c = np.zeros_like(a)
    for i in range(len(a)):
        for k in range(len(a)):
            if a[i, k] != 0.0:
                for j in range(len(a)):
                    c[i, j] += a[i, k] * b[k, j]
    return c


@called
def _phi(a: Any) -> Any:
    """phi_0 to phi_3 of a matrix: the first is its exponential, and phi_n(a) a is phi_(n-1)(a) less
    1 / (n - 1)! (Hochbruck and Ostermann 2010): a series for a / 2^k, doubled k times."""
    one = np.eye(len(a))
    doublings = math.ceil(min(max(math.log2(2.0 * np.abs(a).sum() + 1e-9), 0.0), MOST_DOUBLINGS))
    a = a * 0.5**doublings
    third = one
    for n in range(TERMS, 3, -1):
        third = one + _times(a, third) / n
    third = third / 6.0
    second = 0.5 * one + _times(a, third)
    first = one + _times(a, second)
    whole = one + _times(a, first)
    for _ in range(doublings):
        third = 0.125 * (_times(whole, third) + third + second + 0.5 * first)
        second = 0.25 * (_times(whole, second) + second + first)
        first = 0.5 * (_times(whole, first) + first)
        whole = _times(whole, whole)
    return whole, first, second, third


@called
def _carry(craft: Any, way: Any, one: Any, other: Any, span: float, room: Any) -> None:
    places, gains = way
    z, new, none = room[0], room[4], room[5]
    for k in range(3):
        _acted_on(craft, between(one, other, span, 0.5 * k), none, room[1 + k], LISTED)
    for i in range(OWN_SENSOR):
        new[i] = 0.0
    for m in range(len(places)):
        i, k = places[m, 0], places[m, 1]
        new[i] += gains[m, 0] * z[k]
        new[i] += gains[m, 1] * room[1, k] + gains[m, 2] * room[2, k] + gains[m, 3] * room[3, k]
    for i in range(OWN_SENSOR):
        z[i] = new[i]


@spliced
def _slope(context: Any, half: int, z: Any, dz: Any) -> None:
    craft, one, other, span, first, step = context
    _acted_on(craft, between(one, other, span, first + 0.5 * half * step), z, dz, ALL)


_step = runge_kutta(_slope)


@called
def _integrate(craft: Any, one: Any, other: Any, span: float, room: Any) -> None:
    z, dz, base, total = room[0], room[1], room[2], room[3]
    parts = max(1, math.ceil(span * craft.fastest / STEP))
    for part in range(parts):
        context = (craft, one, other, span, part / parts, 1.0 / parts)
        _step(context, span / parts, SENSOR_STATES, z, dz, base, total)


@inner
def follow(craft: Any, way: Any, one: Any, other: Any, span: float, room: Any) -> None:
    """The sensors' states room[0] from a body to the next, ``span`` s later; room: (ROOM, states),
    of which the last stays 0. way: ``carried`` of the craft and the span. For crafts whose sensors
    have states; those of a user's own need not be linear, and are integrated."""
    if craft.own[SENSOR] == 0:
        _carry(craft, way, one, other, span, room)
    else:
        _integrate(craft, one, other, span, room)


@spliced
def begin(craft: Any, body: Any, z: Any) -> None:
    """Sensors' states of a craft that has moved as it does for long."""
    for i in range(SENSOR_STATES):
        z[i] = craft.sensor_initial[i]
        follows = craft.follows[i]
        if follows >= 3:
            z[i] = body.force[follows - 3]
        elif follows >= 0:
            z[i] = body.rate[follows]


@kernel
def gyro_step(craft: Any, period: float, out: Any) -> None:
    """Fills what the roll gyro shows (k,) after a step of the rate by 1 rad/s."""
    zero, still = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
    begun = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), zero, zero, still, still, 0.0, zero, zero)
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), zero, (1.0, 0.0, 0.0), still, still, 0.0, zero, zero)
    room, way = np.zeros((ROOM, SENSOR_STATES)), carried(craft, period)
    begin(craft, begun, room[0])
    bias = sense(craft, begun, room[0], room[1]).gyro[0]
    for k in range(len(out)):
        follow(craft, way, body, body, period, room)
        out[k] = sense(craft, body, room[0], room[1]).gyro[0] - bias


@kernel
def settled_reading(craft: Any, rate: Any, force: Any, out: Any) -> None:
    """What gyro and accelerometer (6,) show of constant rates (3,) and specific force (3,) of a
    craft whose angular acceleration is zero, once their filters have settled."""
    zero, still = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
    turn, felt = (rate[0], rate[1], rate[2]), (force[0], force[1], force[2])
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), zero, turn, still, still, 0.0, zero, felt)
    room, way = np.zeros((ROOM, SENSOR_STATES)), carried(craft, SETTLE_STEP_S)
    begin(craft, body, room[0])
    if craft.sensor_states > 0:
        for _ in range(int(SETTLE_S / SETTLE_STEP_S)):
            follow(craft, way, body, body, SETTLE_STEP_S, room)
    reading = sense(craft, body, room[0], room[1])
    for i in range(3):
        out[i], out[3 + i] = reading.gyro[i], reading.accelerometer[i]
