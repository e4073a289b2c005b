"""Torque against the yaw rate."""

from __future__ import annotations

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, one, reads, sets
from firmware_sim.layout import Record


@inner
def turn_damping(p: Record, yaw_rate: float) -> float:
    """Torque in N m on yaw."""
    torque: float = -p.turn_damping * yaw_rate
    return torque


EFFECT = Effect(
    parameters={"damping_n_m_s": (4e-6, "N m s")},
    apply=sets(turn_damping="damping_n_m_s"),
    present=reads(turn_damping="damping_n_m_s"),
    draw=one("damping_n_m_s", 1e-6, 1e-5),
    hidden=11,
)
