"""A first-order lag of the reported voltage, beside the firmware's own filter."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.battery import ADC_FILTER, ADC_PASSES
from firmware_sim.effects.effect import POSITIVE, Effect, Values, one, sets, zeroes
from firmware_sim.layout import PASS_NS

ADC_LAG_S = -ADC_PASSES * PASS_NS * 1e-9 / math.log(1.0 - ADC_FILTER)
"""Time constant of the firmware's battery filter: what is left of a step falls by a factor e."""


def _present(p: Any) -> Values | None:
    lag_s = float(p["reading_lag"] + ADC_LAG_S * p["adc_filter"])
    return {"time_constant_s": lag_s} if lag_s else None


EFFECT = Effect(
    parameters={"time_constant_s": (0.155, "s")},
    apply=sets(reading_lag="time_constant_s"),
    clear=zeroes("adc_filter"),
    present=_present,
    draw=one("time_constant_s", 0.15, 0.6),
    limits={"time_constant_s": POSITIVE},
)
