"""Compiled motors with everything between the reported supply and their speed."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.compiled import called, inner, kernel, spliced
from groundstation.dynamics.integrator import runge_kutta
from groundstation.dynamics.rigid_body import (
    ALL,
    LISTED,
    MOTOR,
    SUPPLY,
    motor_slope,
    motor_slopes,
    motor_supply,
    physics,
)

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
