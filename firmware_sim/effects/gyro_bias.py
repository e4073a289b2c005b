"""A constant added to the register of the gyro."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_sim.effects.effect import Effect, Values, vector

NAMES = ("x_dps", "y_dps", "z_dps")


def _apply(p: Any, values: Values) -> None:
    p["gyro_offset"] += np.radians([values[name] for name in NAMES])


def _present(p: Any) -> Values | None:
    if not p["gyro_offset"].any():
        return None
    return dict(zip(NAMES, (np.degrees(p["gyro_offset"])).tolist(), strict=True))


EFFECT = Effect(
    parameters=dict.fromkeys(NAMES, (0.0, "deg/s")),
    apply=_apply,
    present=_present,
    draw=vector(0.2, 3.0, *NAMES),
)
