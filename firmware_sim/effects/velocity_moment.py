"""The rotors tip back against the motion (blade flapping)."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, one, reads, sets
from firmware_sim.layout import Record


@inner
def flapping_acceleration(p: Record, forward: float, left: float) -> Any:
    """Angular acceleration in rad/s^2 on roll and pitch at a body velocity in m/s."""
    return p.flapping * left, -p.flapping * forward


EFFECT = Effect(
    parameters={"moment": (10.0, "rad/s^2 per m/s")},
    apply=sets(flapping="moment"),
    present=reads(flapping="moment"),
    draw=one("moment", 2.0, 30.0),
    hidden=4,
)
