"""Steady states: the speed that carries a craft, the duty for it, the speed that a duty gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from groundstation.dynamics.craft import Crafts
from groundstation.dynamics.law import FAR_M
from groundstation.dynamics.simulation import specific_force
from groundstation.dynamics.state import craft_state
from groundstation.telemetry.arrays import Array

HOVER_ROUNDS = 3
"""Thrust goes with the square of the speed but for what effects add to it: each round leaves less
than a hundredth of the error."""


def hover_rev_s(craft: Crafts) -> float:
    """Rotor speed that carries the craft far from the ground, all rotors alike."""
    one = craft[0]
    speed = float(np.sqrt(one["mass"] * one["gravity"] / one["thrust"] / 4.0))
    for _ in range(HOVER_ROUNDS):
        lift = specific_force(craft, craft_state((0.0, 0.0, FAR_M), rotor_rev_s=speed))[2]
        speed *= float(np.sqrt(one["gravity"] / lift))
    return speed


def hover_duty(craft: Crafts, rotor_rev_s: float, supply_mv: ArrayLike) -> Array:
    """Duty 0..1 (k,), mean of the rotors, that holds a speed at reported supplies (k,) in mV."""
    still = np.zeros(4)
    voltages, place = np.unique(np.asarray(supply_mv, np.float64), return_inverse=True)
    speed = np.full(4, rotor_rev_s)
    found = [duties_for(craft, speed, still, float(voltage)).mean() for voltage in voltages]
    return np.array(found)[place]


def duties_for(craft: Crafts, rotor_rev_s: Array, slope: Array, supply_mv: float) -> Array:
    """Duties (4,), within 0..1, that give rotors at a speed (4,) a slope (4,) in rev/s^2."""
    from groundstation.dynamics.motor_kernels import duties

    duty = np.empty(4)
    duties(craft[0], rotor_rev_s, slope, supply_mv, duty)
    return duty


def settled_rev_s(craft: Crafts, duty: Array, supply_mv: float) -> Array:
    """Rotor speeds (4,) that a constant duty (4,) at a reported voltage settles at."""
    from groundstation.dynamics.motor_kernels import settle

    speed = np.empty(4)
    settle(craft[0], duty, supply_mv, speed)
    return speed
