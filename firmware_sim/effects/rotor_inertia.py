"""What a craft has: one inertia of the rotors, both torques."""

from __future__ import annotations

from firmware_sim.effects.effect import Effect, one, sets

EFFECT = Effect(
    parameters={"rotor_inertia_kg_m2": (5e-8, "kg m^2")},
    apply=sets(rotor_inertia_gyro="rotor_inertia_kg_m2", rotor_inertia_yaw="rotor_inertia_kg_m2"),
    draw=one("rotor_inertia_kg_m2", 2e-8, 1.5e-7),
    limits={"rotor_inertia_kg_m2": (0.0, 4e-6)},
    listed=False,
)
