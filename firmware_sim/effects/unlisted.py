"""Physics that no list of effects names: what an honest search must leave unexplained."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import ARM, LOAD, Record

ATTACHMENT_M = 0.01
"""The load's line is tied this far below the centre of gravity."""


@inner
def slung_load(p: Record, y: Any, dy: Any, lift: float) -> Any:
    """A load on a line, small swings; returns its pull (N, inertial x, y, z).

    ``lift`` is the vertical force (N) that carries craft and load. The swing's own equation,
    dy[LOAD], still lacks the craft's acceleration: the caller subtracts it.
    """
    taut = min(max(y[2] / p.load_length * 2.0 - 1.0, 0.0), 1.0)
    gravity = taut * max(lift, 0.0) / (p.mass + p.load_mass)
    for axis in range(2):
        swing, speed = y[LOAD + axis], y[LOAD + 2 + axis]
        dy[LOAD + axis] = speed
        dy[LOAD + 2 + axis] = -gravity / p.load_length * swing - 0.4 * speed
    pull = p.load_mass * gravity
    return (
        pull * y[LOAD] / p.load_length,
        pull * y[LOAD + 1] / p.load_length,
        -pull,
    )


@inner
def cracked_arm(p: Record, y: Any, dy: Any, thrust: float) -> float:
    """The thrust (N) that a cracked arm hands on more, or less, than its rotor makes."""
    pulsation = 2.0 * math.pi * p.arm_hz
    bend, speed = y[ARM], y[ARM + 1]
    dy[ARM] = speed
    dy[ARM + 1] = pulsation * (pulsation * (thrust - bend) - 2.0 * p.arm_damping * speed)
    extra: float = p.arm_gain * (bend - thrust)
    return extra


@inner
def bent_propeller(p: Record, speed: float, phase: float) -> Any:
    """A torque (N m on roll and pitch) that turns once with the rotor."""
    torque = p.bent_torque * speed * speed
    angle = 2.0 * math.pi * phase
    return torque * math.cos(angle), torque * math.sin(angle)


@inner
def side_gust(p: Record, time_s: float) -> Any:
    """A periodic gust from the right: force along inertial y (N) and roll torque (N m)."""
    wave = math.sin(2.0 * math.pi * p.gust_hz * time_s)
    return p.gust_force * wave, p.gust_moment * wave
