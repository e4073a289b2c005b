"""A first-order lag of the gyro, beside the chip's own filter."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.effects.dead_time import measure_in_step
from firmware_sim.effects.effect import Effect, Values, one
from firmware_sim.layout import ALL_STATES


def _apply(p: Any, values: Values) -> None:
    if values["bandwidth_hz"] > 0:
        p["gyro_lag"] = 1 / (2 * math.pi * values["bandwidth_hz"])
        p["states"] = ALL_STATES


def _clear(p: Any) -> None:
    """The sensor's lag is the model's, and so is its delay, if there is one."""
    p["dlpf_s"] = 0.0
    measure_in_step(p)


def _present(p: Any) -> Values | None:
    if not p["gyro_lag"]:
        return None
    return {"bandwidth_hz": float(1 / (2 * math.pi * p["gyro_lag"]))}


EFFECT = Effect(
    parameters={"bandwidth_hz": (30.0, "Hz")},
    apply=_apply,
    clear=_clear,
    present=_present,
    draw=one("bandwidth_hz", 12.0, 60.0),
    limits={"bandwidth_hz": (0.0, 500.0)},
    hidden=9,
)
