"""Torque against the rate, on roll and pitch."""

from __future__ import annotations

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, one, reads, sets
from firmware_sim.layout import Record


@inner
def linear_damping(p: Record, rate: float) -> float:
    """Torque in N m on roll or pitch."""
    torque: float = -p.tilt_damping * rate
    return torque


EFFECT = Effect(
    parameters={"damping_n_m_s": (1e-5, "N m s")},
    apply=sets(tilt_damping="damping_n_m_s"),
    present=reads(tilt_damping="damping_n_m_s"),
    draw=one("damping_n_m_s", 3e-6, 3e-5),
)
