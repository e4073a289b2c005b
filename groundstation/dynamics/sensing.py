"""What gyro and accelerometer show of a craft, with the sensors' effects and their states."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import called, inner, kernel, spliced
from groundstation.dynamics import quaternion
from groundstation.dynamics.chains import chain, loader, own_chain, reckoned, state_access
from groundstation.dynamics.craft import LISTED_STATES, SENSOR_STATES, first_state
from groundstation.dynamics.integrator import runge_kutta
from groundstation.dynamics.law import FAR_M, Body, Reading, butterworth_behind
from groundstation.dynamics.rigid_body import ALL, LISTED, SENSOR, craft_of, own_values

sensor_chain, own_sensor = chain("sensor"), own_chain("sensor")
read_states, write_states = state_access("sensor")
load = loader("sensor")
OWN_SENSOR = LISTED_STATES["sensor"]
GYRO_FILTER = first_state("gyro_filter")
STEP = 0.5
"""Longest step of the integrator over the fastest time constant of the sensors: what a filter has
of a jump is off by 0.02 % of it at most."""
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
        roll, pitch, yaw = quaternion.angles(q)
        for i in range(SENSOR_STATES):
            if craft.turns[i] == 0:
                roll += z[i]
            elif craft.turns[i] == 1:
                pitch += z[i]
            elif craft.turns[i] == 2:
                yaw += z[i]
        q = quaternion.of_angles((roll, pitch, yaw))
    if craft.gyro_filter[0] == 0.0:
        return q
    i = GYRO_FILTER
    state = (z[i], z[i + 1], z[i + 2], z[i + 3], z[i + 4], z[i + 5])
    x, y, w = butterworth_behind(state, craft.gyro_filter[1])
    return quaternion.normalised(quaternion.product(q, (1.0, -0.5 * x, -0.5 * y, -0.5 * w)))


@spliced
def feel(craft: Any, body: Any, force: Any, h: float, room: Any) -> None:
    """Lean by the specific force that was measured over the row before a body, not by its own.

    room: (4, states); the first are the sensors' states, of which those change that turn reported
    angles.
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


def _follow(who: int, size: int) -> Any:
    """Effects with states act: to ask of every slope whether they do doubles what it costs."""

    @spliced
    def slope(context: Any, half: int, z: Any, dz: Any) -> None:
        craft, one, other, span, first, step = context
        _acted_on(craft, between(one, other, span, first + 0.5 * half * step), z, dz, who)

    step = runge_kutta(slope)

    @called
    def follow(craft: Any, one: Any, other: Any, span: float, room: Any) -> None:
        z, dz, base, total = room[0], room[1], room[2], room[3]
        parts = max(1, math.ceil(span * craft.fastest / STEP))
        for part in range(parts):
            context = (craft, one, other, span, part / parts, 1.0 / parts)
            step(context, span / parts, size, z, dz, base, total)

    return follow


_follow_listed, _follow_all = _follow(LISTED, OWN_SENSOR), _follow(ALL, SENSOR_STATES)


@inner
def follow(craft: Any, one: Any, other: Any, span: float, room: Any) -> None:
    """The sensors' states room[0] from a body to the next, ``span`` s later; room: (4, states).
    For crafts whose sensors have states."""
    if craft.own[SENSOR] == 0:
        _follow_listed(craft, one, other, span, room)
    else:
        _follow_all(craft, one, other, span, room)


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
    room = np.zeros((4, SENSOR_STATES))
    begin(craft, begun, room[0])
    bias = sense(craft, begun, room[0], room[1]).gyro[0]
    for k in range(len(out)):
        follow(craft, body, body, period, room)
        out[k] = sense(craft, body, room[0], room[1]).gyro[0] - bias


@kernel
def settled_reading(craft: Any, rate: Any, force: Any, out: Any) -> None:
    """What gyro and accelerometer (6,) show of constant rates (3,) and specific force (3,) of a
    craft whose angular acceleration is zero, once their filters have settled."""
    zero, still = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
    turn, felt = (rate[0], rate[1], rate[2]), (force[0], force[1], force[2])
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), zero, turn, still, still, 0.0, zero, felt)
    room = np.zeros((4, SENSOR_STATES))
    begin(craft, body, room[0])
    if craft.sensor_states > 0:
        for _ in range(int(SETTLE_S / SETTLE_STEP_S)):
            follow(craft, body, body, SETTLE_STEP_S, room)
    reading = sense(craft, body, room[0], room[1])
    for i in range(3):
        out[i], out[3 + i] = reading.gyro[i], reading.accelerometer[i]
