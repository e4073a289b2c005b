"""The torque that speeds rotors up, on yaw."""

from __future__ import annotations

import math

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import POSITIVE, Effect, one, reads, sets
from firmware_sim.layout import Record

RADIANS_PER_REVOLUTION = 2.0 * math.pi


@inner
def acceleration_torque(p: Record, spin_acceleration: float) -> float:
    """Torque in N m on yaw: the body takes what the rotors' spin gains."""
    torque: float = -p.rotor_inertia_yaw * RADIANS_PER_REVOLUTION * spin_acceleration
    return torque


EFFECT = Effect(
    parameters={"rotor_inertia_kg_m2": (5e-8, "kg m^2")},
    apply=sets(rotor_inertia_yaw="rotor_inertia_kg_m2"),
    present=reads(rotor_inertia_yaw="rotor_inertia_kg_m2"),
    draw=one("rotor_inertia_kg_m2", 2e-8, 1.5e-7),
    limits={"rotor_inertia_kg_m2": POSITIVE},
    hidden=1,
)
