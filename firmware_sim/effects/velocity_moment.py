"""The rotors tip back against the motion (blade flapping)."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, Values, reads, sets, size
from firmware_sim.layout import Record


@inner
def flapping_acceleration(p: Record, forward: float, left: float) -> Any:
    """Angular acceleration in rad/s^2 on roll and pitch at a body velocity in m/s."""
    lopsided = p.flapping * p.flapping_asymmetry
    return (p.flapping - lopsided) * left, -(p.flapping + lopsided) * forward


def _drawn(generator: np.random.Generator) -> Values:
    return {"moment": size(generator, 2.0, 30.0), "asymmetry": generator.uniform(-0.3, 0.3)}


EFFECT = Effect(
    parameters={"moment": (10.0, "rad/s^2 per m/s"), "asymmetry": (0.0, "")},
    apply=sets(flapping="moment", flapping_asymmetry="asymmetry"),
    present=lambda p: (
        reads(flapping="moment", flapping_asymmetry="asymmetry")(p) if p["flapping"] else None
    ),
    draw=_drawn,
    hidden=4,
)
