"""Torque against the rate times its magnitude, on roll and pitch."""

from __future__ import annotations

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, one, reads, sets
from firmware_sim.layout import Record


@inner
def quadratic_damping(p: Record, rate: float) -> float:
    """Torque in N m on roll or pitch."""
    torque: float = -p.quadratic_damping * abs(rate) * rate
    return torque


EFFECT = Effect(
    parameters={"damping_n_m_s2": (1.5e-5, "N m s^2")},
    apply=sets(quadratic_damping="damping_n_m_s2"),
    present=reads(quadratic_damping="damping_n_m_s2"),
    draw=one("damping_n_m_s2", 5e-6, 4e-5),
)
