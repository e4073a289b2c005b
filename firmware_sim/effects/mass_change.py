"""A payload, or a lighter battery, at the centre of gravity: mass without inertia."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_sim.effects.effect import Effect, Values, size


def _apply(p: Any, values: Values) -> None:
    p["payload"] = values["percent"] / 100.0
    p["mass"] *= 1.0 + p["payload"]


def _present(p: Any) -> Values | None:
    return {"percent": 100.0 * float(p["payload"])} if p["payload"] else None


def _draw(generator: np.random.Generator) -> Values:
    return {"percent": float(generator.choice([-1.0, 1.0])) * size(generator, 5.0, 20.0)}


EFFECT = Effect(
    parameters={"percent": (10.0, "%")},
    apply=_apply,
    present=_present,
    draw=_draw,
    limits={"percent": (-90.0, 1000.0)},
)
