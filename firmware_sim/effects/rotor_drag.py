"""In-plane force against the body velocity."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, one, reads, sets
from firmware_sim.layout import Record


@inner
def drag_force(p: Record, forward: float, left: float) -> Any:
    """Force in N at a body velocity in m/s."""
    return -p.plane_drag * forward, -p.plane_drag * left


EFFECT = Effect(
    parameters={"drag_n_s_m": (0.008, "N s/m")},
    apply=sets(plane_drag="drag_n_s_m"),
    present=reads(plane_drag="drag_n_s_m"),
    draw=one("drag_n_s_m", 0.003, 0.02),
)
