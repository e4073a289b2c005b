"""A constant added to the register of the accelerometer."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_sim.effects.effect import Effect, G, Values, vector

NAMES = ("x_g", "y_g", "z_g")


def _apply(p: Any, values: Values) -> None:
    p["accel_bias"] += np.multiply([values[name] for name in NAMES], G)


def _present(p: Any) -> Values | None:
    if not p["accel_bias"].any():
        return None
    return dict(zip(NAMES, (p["accel_bias"] / G).tolist(), strict=True))


EFFECT = Effect(
    parameters=dict.fromkeys(NAMES, (0.0, "g")),
    apply=_apply,
    present=_present,
    draw=vector(0.01, 0.08, *NAMES),
    hidden=10,
)
