"""Thrust near the ground relative to thrust far from it."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, Values, sets, size
from firmware_sim.layout import Record


@inner
def ground_factor(p: Record, height: float) -> float:
    """The factor at a height in m."""
    return 1.0 + p.ground_gain * math.exp(-max(height, 0.0) / p.ground_height)


def _present(p: Any) -> Values | None:
    if not p["ground_gain"]:
        return None
    return {"height_m": float(p["ground_height"]), "gain": float(p["ground_gain"])}


EFFECT = Effect(
    parameters={"height_m": (0.08, "m"), "gain": (0.25, "")},
    apply=sets(ground_height="height_m", ground_gain="gain"),
    present=_present,
    draw=lambda generator: {"height_m": size(generator, 0.03, 0.15), "gain": 0.25},
    limits={"height_m": (0.001, math.inf), "gain": (-0.9, 10.0)},
)
