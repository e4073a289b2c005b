"""Compiled flights: integrator, motors, and the rigid body with every effect.

Imported only where something is simulated.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from groundstation.compiled import called, inner, kernel, spliced
from groundstation.dynamics import effect as law
from groundstation.dynamics.chains import chain, loader, own_chain, state_access
from groundstation.dynamics.craft import LISTED_STATES
from groundstation.dynamics.effect import Body, Craft, Motor, Supply
from groundstation.dynamics.registry import COMPILED

# The one integrator: classical Runge-Kutta, order 4.


def runge_kutta(slope: Any) -> Any:
    """A step of y' = slope(context, half, y, dy) with a compiled ``slope`` that fills dy.

    half: how many half steps from the start, 0, 1 or 2. The step is called as
    (context, h, size, y, dy, base, total): it advances y[:size] by h; the rest is room.
    """

    @spliced
    def step(context: Any, h: float, size: int, y: Any, dy: Any, base: Any, total: Any) -> None:
        for i in range(size):
            base[i] = y[i]
            total[i] = 0.0
        for stage in range(4):
            slope(context, (stage + 1) // 2, y, dy)
            weight = 2.0 if stage == 1 or stage == 2 else 1.0
            ahead = h if stage == 2 else 0.5 * h
            for i in range(size):
                total[i] += weight * dy[i]
                y[i] = base[i] + ahead * dy[i]
        for i in range(size):
            y[i] = base[i] + h / 6.0 * total[i]

    return step


# The one craft of all kernels: motors, supply, rotors and rigid body with every effect.
#
# State: position 0-2, velocity 3-5, quaternion 6-9, rates 10-12, rotors 13-16,
# and behind them the states of effects.


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


# Compiled motors with everything between the reported supply and their speed.


BISECTIONS, SAG_ROUNDS = 60, 30
"""Halvings of a rotor's speed or duty; speed and supply depend on each other, and each round leaves
less than half of the error."""


@inner
def four(array: Any) -> Any:
    """The first four numbers of an array, by value."""
    return array[0], array[1], array[2], array[3]


@inner
def armature(p: Any, duty: Any, reported: float, before: float, period: float, n: Any) -> Any:
    """Armature voltages (4) in mV of duties (4) at a reported supply."""
    left = motor_supply(p, reported, before, period, duty, n)
    return duty[0] * left, duty[1] * left, duty[2] * left, duty[3] * left


@spliced
def driven(p: Any, voltage: Any, supply: Any, k: int, period: float, n: Any) -> Any:
    """Armature voltages of row k, made from a supply whose effects then act on them."""
    volts = (voltage[k, 0], voltage[k, 1], voltage[k, 2], voltage[k, 3])
    if p.acts_supply != 0 and supply[k] > 0.0:
        now = supply[k]
        duty = (volts[0] / now, volts[1] / now, volts[2] / now, volts[3] / now)
        volts = armature(p, duty, now, supply[max(k - 1, 0)], period, n)
    return volts


def _motors(who: int) -> Any:
    @spliced
    def slope(context: Any, half: int, y: Any, dy: Any) -> None:
        """Speed of a motor, and behind it the integral of its square."""
        p, a0, a1, a2, armature_mv = context
        dy[0] = motor_slope(p, a0, a1, a2, armature_mv, y[0], who)
        dy[1] = y[0] * y[0]

    step = runge_kutta(slope)

    @inner
    def run(
        p: Any,
        craft: Any,
        voltage: Any,
        supply: Any,
        period: float,
        substeps: int,
        start: Any,
        speed: Any,
        square: Any,
    ) -> None:
        count = voltage.shape[1]
        y, dy, base, total = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
        volts = np.empty(count)
        for i in range(count):
            speed[0, i] = start[i]
        h = period / substeps
        for k in range(voltage.shape[0]):
            for i in range(count):
                volts[i] = voltage[k, i]
            if p.acts_supply != 0 and count == 4:
                n = four(speed[k])
                volts[0], volts[1], volts[2], volts[3] = driven(p, voltage, supply, k, period, n)
            for i in range(count):
                one = i if count == 4 else 0
                context = (p, craft.a0[one], craft.a1[one], craft.a2[one], volts[i])
                y[0], y[1] = speed[k, i], 0.0
                for _ in range(substeps):
                    step(context, h, 2, y, dy, base, total)
                speed[k + 1, i], square[k, i] = y[0], y[1] / period

    return run


_run_motors, _run_motors_lawful = (_motors(who) for who in (LISTED, ALL))


@kernel
def run_motors(
    craft: Any,
    voltage: Any,
    supply: Any,
    period: float,
    substeps: int,
    start: Any,
    speed: Any,
    square: Any,
) -> None:
    """Motors on voltages (k, m) in mV that are held over each period, made from ``supply`` as in
    ``fly``. One motor of the record runs all columns unless these are four.

    Fills ``speed`` (k + 1, m) in rev/s and ``square`` (k, m), the mean square over a period.
    """
    p = physics(craft)
    given = (p, craft, voltage, supply, period, substeps, start, speed, square)
    if p.own[MOTOR] != 0 or p.own[SUPPLY] != 0:
        _run_motors_lawful(*given)
    else:
        _run_motors(*given)


@called
def armature_of(
    craft: Any, duty: Any, reported: float, before: float, period: float, n: Any
) -> Any:
    """``armature`` of a record."""
    return armature(physics(craft), duty, reported, before, period, n)


@called
def _slopes(craft: Any, volts: Any, n: Any) -> Any:
    return motor_slopes(physics(craft), volts, n, ALL)


@inner
def _settled(craft: Any, volts: Any) -> Any:
    """Speeds (4) at which constant armature voltages (4) settle."""
    low, high = (0.0, 0.0, 0.0, 0.0), (1e5, 1e5, 1e5, 1e5)
    for _ in range(BISECTIONS):
        middle = (
            0.5 * (low[0] + high[0]),
            0.5 * (low[1] + high[1]),
            0.5 * (low[2] + high[2]),
            0.5 * (low[3] + high[3]),
        )
        up = _slopes(craft, volts, middle)
        low = (
            middle[0] if up[0] > 0.0 else low[0],
            middle[1] if up[1] > 0.0 else low[1],
            middle[2] if up[2] > 0.0 else low[2],
            middle[3] if up[3] > 0.0 else low[3],
        )
        high = (
            high[0] if up[0] > 0.0 else middle[0],
            high[1] if up[1] > 0.0 else middle[1],
            high[2] if up[2] > 0.0 else middle[2],
            high[3] if up[3] > 0.0 else middle[3],
        )
    return low


@kernel
def settle(craft: Any, duty: Any, supply: float, speed: Any) -> None:
    """Fills the rotor speeds (4,) that constant duties (4,) at a reported voltage settle at."""
    driven, n = four(duty), (0.0, 0.0, 0.0, 0.0)
    for _ in range(SAG_ROUNDS if craft.acts_supply != 0 else 1):
        n = _settled(craft, armature_of(craft, driven, supply, supply, 1.0, n))
    for i in range(4):
        speed[i] = n[i]


@kernel
def duties(craft: Any, speed: Any, slope: Any, supply: float, duty: Any) -> None:
    """Fills the duties (4,), 0..1, that give rotors at a speed (4,) a slope (4,) in rev/s^2."""
    n = four(speed)
    low, high = np.zeros(4), np.ones(4)
    for _ in range(BISECTIONS):
        for i in range(4):
            duty[i] = 0.5 * (low[i] + high[i])
        volts = armature_of(craft, four(duty), supply, supply, 1.0, n)
        found = _slopes(craft, volts, n)
        for i in range(4):
            if found[i] < slope[i]:
                low[i] = duty[i]
            else:
                high[i] = duty[i]


# Compiled flights. Imported only where something is simulated.


def _craft_slope(who: int) -> Any:
    @spliced
    def slope(context: Any, half: int, y: Any, dy: Any) -> None:
        p, volts, push = context
        n = y[13], y[14], y[15], y[16]
        n_slope = motor_slopes(p, volts, n, who)
        dy[13], dy[14], dy[15], dy[16] = n_slope
        body_slope(p, n, n_slope, push, y, dy, who)

    return slope


bare_step, plain_step, craft_step = (runge_kutta(_craft_slope(who)) for who in (BARE, LISTED, ALL))
"""A step of the craft at (physics, armature voltages, push)."""


@spliced
def normalise(y: Any) -> None:
    """Make the quaternion of a body state one of length 1."""
    scale = 1.0 / math.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
    for i in range(6, 10):
        y[i] *= scale


def _run(step: Any) -> Any:
    @spliced
    def run(
        p: Any,
        size: int,
        voltage: Any,
        supply: Any,
        push: Any,
        period: float,
        substeps: int,
        states: Any,
    ) -> None:
        y, dy, base, total = np.empty(size), np.zeros(size), np.empty(size), np.empty(size)
        for i in range(size):
            y[i] = states[0, i]
        h = period / substeps
        for k in range(voltage.shape[0]):
            volts = driven(p, voltage, supply, k, period, (y[13], y[14], y[15], y[16]))
            row = k if push.shape[0] > 1 else 0
            given = (
                push[row, 0],
                push[row, 1],
                push[row, 2],
                push[row, 3],
                push[row, 4],
                push[row, 5],
            )
            context = (p, volts, given)
            for _ in range(substeps):
                step(context, h, size, y, dy, base, total)
            normalise(y)
            for i in range(size):
                states[k + 1, i] = y[i]

    return run


_fly_bare, _fly, _fly_all = (_run(step) for step in (bare_step, plain_step, craft_step))


@kernel
def fly(
    craft: Any,
    voltage: Any,
    supply: Any,
    push: Any,
    period: float,
    substeps: int,
    states: Any,
) -> None:
    """Runge-Kutta with inputs held over each period.

    voltage: (k, 4) mV. supply: (k,) mV that the voltages were made from, needed where an effect of
    the supply acts, which is reckoned at the start of each period; else (0,). push: (k, 6) or
    (1, 6), accelerations added: rad/s^2 about the body axes, m/s^2 in the inertial frame.
    Fills states (k + 1, 17 + the effects') from the first.
    """
    p = physics(craft)
    size = states.shape[1]
    own = p.own[0] + p.own[1] + p.own[2] + p.own[3] != 0
    if size > 17 or own:
        _fly_all(p, size, voltage, supply, push, period, substeps, states)
    elif p.acts_motor + p.acts_rotor + p.acts_body == 0:
        _fly_bare(p, 17, voltage, supply, push, period, substeps, states)
    else:
        _fly(p, 17, voltage, supply, push, period, substeps, states)


@kernel
def accelerations(craft: Any, states: Any, slopes: Any, period: float, out: Any) -> None:
    """Angular acceleration and specific force (k, 6) in body axes of states (k, 17) whose rotors
    change by slopes (k, 4) rev/s^2. States of effects are followed from row to row."""
    p, still = physics(craft), np.zeros(6)
    extra = craft.body_states
    size = 17 + extra
    y, dy, later = np.zeros(size), np.zeros(size), np.zeros(size)
    for i in range(extra):
        y[17 + i] = craft.body_initial[i]
    for k in range(len(states)):
        for i in range(17):
            y[i] = states[k, i]
        body = body_slope(p, four(y[13:]), four(slopes[k]), still, y, dy, ALL)
        for i in range(3):
            out[k, i], out[k, 3 + i] = body.angular[i], body.force[i]
        if extra > 0 and k + 1 < len(states):
            for i in range(17):
                later[i] = states[k + 1, i]
            for i in range(extra):
                later[17 + i] = y[17 + i] + period * dy[17 + i]
                y[17 + i] += 0.5 * period * dy[17 + i]
            body_slope(p, four(later[13:]), four(slopes[k + 1]), still, later, dy, ALL)
            for i in range(extra):
                y[17 + i] += 0.5 * period * dy[17 + i]
