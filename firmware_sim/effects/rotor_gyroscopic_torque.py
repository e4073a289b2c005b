"""Rotors whose angular momenta do not cancel, on roll and pitch."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import POSITIVE, Effect, one, reads, sets
from firmware_sim.layout import Record

RADIANS_PER_REVOLUTION = 2.0 * math.pi


@inner
def gyroscopic_torque(p: Record, roll_rate: float, pitch_rate: float, spin_sum: float) -> Any:
    """Torque in N m on roll and pitch.

    ``spin_sum`` is the sum of spin times speed (rev/s), positive counter-clockwise; the rotors'
    angular momentum h along z gives -Omega x (0, 0, h).
    """
    momentum = p.rotor_inertia_gyro * RADIANS_PER_REVOLUTION * spin_sum
    return -pitch_rate * momentum, roll_rate * momentum


EFFECT = Effect(
    parameters={"rotor_inertia_kg_m2": (5e-8, "kg m^2")},
    apply=sets(rotor_inertia_gyro="rotor_inertia_kg_m2"),
    present=reads(rotor_inertia_gyro="rotor_inertia_kg_m2"),
    draw=one("rotor_inertia_kg_m2", 2e-8, 1.5e-7),
    limits={"rotor_inertia_kg_m2": POSITIVE},
)
