"""Compiled flights. Imported only where something is simulated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import kernel, spliced
from groundstation.dynamics.integrator import runge_kutta
from groundstation.dynamics.motor_kernels import driven, four
from groundstation.dynamics.rigid_body import ALL, BARE, LISTED, body_slope, motor_slopes, physics


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
