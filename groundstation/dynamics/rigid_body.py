"""The one craft of all kernels: motors, supply, rotors and rigid body with every effect.

State as in ``state.py``: position 0-2, velocity 3-5, quaternion 6-9, rates 10-12, rotors 13-16,
and behind them the states of effects.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from groundstation.compiled import inner, spliced
from groundstation.dynamics import law
from groundstation.dynamics.chains import chain, loader, own_chain, state_access
from groundstation.dynamics.craft import LISTED_STATES
from groundstation.dynamics.law import Body, Craft, Motor, Supply
from groundstation.dynamics.registry import COMPILED

supply_chain, motor_chain, rotor_chain, body_chain = (
    chain(stage) for stage in ("supply", "motor", "rotor", "body")
)
own_supply, own_motor, own_rotor, own_body = (
    own_chain(stage) for stage in ("supply", "motor", "rotor", "body")
)
rotor_wrench = inner(law.rotor_wrench)
read_states, write_states = state_access("body")
NO_STATES = (0.0,) * max(LISTED_STATES["body"], 1)
BARE, LISTED, ALL = 0, 1, 2
"""Who may act in a kernel: no effect, listed ones without states, all. What could act costs speed
by being there."""
SUPPLY, MOTOR, ROTOR, BODY, SENSOR = range(len(COMPILED))
load = loader(*COMPILED[:SENSOR])
OWN_BODY = 17 + LISTED_STATES["body"]
"""Where the states of a user's own body effects begin."""


class Physics(NamedTuple):
    """A ``CRAFT`` record by value: what is stored to arrays cannot change it, so the compiler keeps
    it in registers. effects: the values of those within the equations of motion; ``sensing`` has
    the sensors'. own_values: the record's, for a user's own effects.
    """

    craft: Craft
    effects: Any
    acts_supply: int
    acts_motor: int
    acts_rotor: int
    acts_body: int
    acts_velocity: int
    own: Any
    own_values: Any


@inner
def craft_of(c: Any) -> Any:
    """A ``CRAFT`` record's own numbers by value."""
    return Craft(
        c.mass,
        c.gravity,
        (c.inertia[0], c.inertia[1], c.inertia[2]),
        c.thrust,
        c.drag,
        (c.rotor_x[0], c.rotor_x[1], c.rotor_x[2], c.rotor_x[3]),
        (c.rotor_y[0], c.rotor_y[1], c.rotor_y[2], c.rotor_y[3]),
        (c.a0[0], c.a0[1], c.a0[2], c.a0[3]),
        (c.a1[0], c.a1[1], c.a1[2], c.a1[3]),
        (c.a2[0], c.a2[1], c.a2[2], c.a2[3]),
        c.winding_ohm,
        (c.back_emf_mv[0], c.back_emf_mv[1], c.back_emf_mv[2], c.back_emf_mv[3]),
    )


@inner
def own_values(c: Any) -> Any:
    """A ``CRAFT`` record's numbers of a user's own effects by value."""
    return (
        c.own_values[0],
        c.own_values[1],
        c.own_values[2],
        c.own_values[3],
        c.own_values[4],
        c.own_values[5],
        c.own_values[6],
        c.own_values[7],
        c.own_values[8],
        c.own_values[9],
        c.own_values[10],
        c.own_values[11],
        c.own_values[12],
        c.own_values[13],
        c.own_values[14],
        c.own_values[15],
    )


@inner
def physics(c: Any) -> Any:
    """A ``CRAFT`` record as ``Physics``."""
    return Physics(
        craft_of(c),
        load(c),
        c.acts_supply,
        c.acts_motor,
        c.acts_rotor,
        c.acts_body,
        c.acts_velocity,
        (c.own[0], c.own[1], c.own[2], c.own[3], c.own[4]),
        own_values(c),
    )


@inner
def motor_slope(
    p: Any, a0: float, a1: float, a2: float, armature_mv: float, n: float, who: int
) -> Any:
    """dn/dt of thesis eq. 3.82 in rev/s^2, with the motors' effects."""
    slope = a0 * armature_mv - (a1 + a2 * n) * n
    if who > BARE and p.acts_motor != 0:
        motor = Motor(a0, a1, a2, armature_mv, n)
        slope, _ = motor_chain(p.effects[MOTOR], 0.0, motor, slope, 0.0)
        if who == ALL and p.own[MOTOR] != 0:
            slope = own_motor(p.own[MOTOR], p.own_values, p.craft, motor, slope, 0.0, 0.0, 0)
    return slope


@inner
def motor_slopes(p: Any, volts: Any, n: Any, who: int) -> Any:
    """dn/dt (4) of speeds n (4) at armature voltages (4,) in mV."""
    c = p.craft
    return (
        motor_slope(p, c.a0[0], c.a1[0], c.a2[0], volts[0], n[0], who),
        motor_slope(p, c.a0[1], c.a1[1], c.a2[1], volts[1], n[1], who),
        motor_slope(p, c.a0[2], c.a1[2], c.a2[2], volts[2], n[2], who),
        motor_slope(p, c.a0[3], c.a1[3], c.a2[3], volts[3], n[3], who),
    )


@inner
def motor_supply(p: Any, reported: float, before: float, period: float, duty: Any, n: Any) -> Any:
    """Supply voltage at the motors, mV, of a report now and a row before."""
    left = reported
    if p.acts_supply != 0:
        given = Supply(reported, before, period, duty, n)
        left, _ = supply_chain(p.effects[SUPPLY], p.craft, given, left, 0.0)
        if p.own[SUPPLY] != 0:
            left = own_supply(p.own[SUPPLY], p.own_values, p.craft, given, left, 0.0, 0.0, 0)
    return left


@inner
def _across(w: float, a: float, b: float, d: float) -> Any:
    """The body's x axis and y axis in the inertial frame, which few effects need."""
    return (
        1.0 - 2.0 * (b * b + d * d),
        2.0 * (a * b + w * d),
        2.0 * (a * d - w * b),
        2.0 * (a * b - w * d),
        1.0 - 2.0 * (a * a + d * d),
        2.0 * (b * d + w * a),
    )


@spliced
def body_slope(p: Any, n: Any, n_slope: Any, push: Any, y: Any, dy: Any, who: int) -> Any:
    """Thesis eq. 3.33-3.35 with the effects of rotors and body.

    n, n_slope: (4) rotors' speed and its slope. push: (6,) accelerations added, rad/s^2 about the
    body axes and m/s^2 along the inertial ones. who: a constant, which effects may act.

    Fills dy[0:13] and the slopes of states; returns the ``Body`` with its angular acceleration and
    specific force, without ``push``.
    """
    c = p.craft
    w, a, b, d = y[6], y[7], y[8], y[9]
    pr, qr, rr = y[10], y[11], y[12]
    r13, r23, r33 = 2.0 * (a * d + w * b), 2.0 * (b * d - w * a), 1.0 - 2.0 * (a * a + b * b)
    forward, left, climb = 0.0, 0.0, 0.0
    if who > BARE and p.acts_velocity != 0:
        r11, r21, r31, r12, r22, r32 = _across(w, a, b, d)
        forward = r11 * y[3] + r21 * y[4] + r31 * y[5]
        left = r12 * y[3] + r22 * y[4] + r32 * y[5]
        climb = r13 * y[3] + r23 * y[4] + r33 * y[5]
    wrench = rotor_wrench(c, n)
    zero = (0.0, 0.0, 0.0)
    place, speed, rate = (w, a, b, d), (forward, left, climb), (pr, qr, rr)
    if who > BARE and p.acts_rotor != 0:
        body = Body(y[2], place, speed, rate, n, n_slope, wrench[0], zero, zero)
        wrench, _ = rotor_chain(p.effects[ROTOR], c, body, wrench, 0.0)
        if who == ALL and p.own[ROTOR] != 0:
            wrench = own_rotor(p.own[ROTOR], p.own_values, c, body, wrench, 0.0, 0.0, 0)
    turn = (wrench[1] / c.inertia[0], wrench[2] / c.inertia[1], wrench[3] / c.inertia[2])
    force = (0.0, 0.0, wrench[0] / c.mass)
    if who > BARE and p.acts_body != 0:
        body = Body(y[2], place, speed, rate, n, n_slope, wrench[0], turn, force)
        if who == ALL and y.size > 17:  # of a craft whose effects have states
            states = read_states(y, 17)
            added, slopes = body_chain(p.effects[BODY], c, body, (turn, force), states)
            write_states(dy, 17, slopes)
        else:
            added, _ = body_chain(p.effects[BODY], c, body, (turn, force), NO_STATES)
        turn, force = added
        if who == ALL and p.own[BODY] != 0:
            body = Body(y[2], place, speed, rate, n, n_slope, wrench[0], turn, force)
            added = own_body(p.own[BODY], p.own_values, c, body, (turn, force), y, dy, OWN_BODY)
            turn, force = added
    dy[0], dy[1], dy[2] = y[3], y[4], y[5]
    dy[3], dy[4] = r13 * force[2] + push[3], r23 * force[2] + push[4]
    dy[5] = r33 * force[2] - c.gravity + push[5]
    if who > BARE and (force[0] != 0.0 or force[1] != 0.0):
        r11, r21, r31, r12, r22, r32 = _across(w, a, b, d)
        dy[3] += r11 * force[0] + r12 * force[1]
        dy[4] += r21 * force[0] + r22 * force[1]
        dy[5] += r31 * force[0] + r32 * force[1]
    dy[6] = 0.5 * (-a * pr - b * qr - d * rr)
    dy[7] = 0.5 * (w * pr + b * rr - d * qr)
    dy[8] = 0.5 * (w * qr + d * pr - a * rr)
    dy[9] = 0.5 * (w * rr + a * qr - b * pr)
    dy[10], dy[11], dy[12] = turn[0] + push[0], turn[1] + push[1], turn[2] + push[2]
    return Body(y[2], place, speed, rate, n, n_slope, wrench[0], turn, force)
