"""One arm's thrust resonates: outside every list."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import ROTOR, Effect, Values, size
from firmware_sim.layout import ALL_STATES, ARM, Record


@inner
def cracked_arm(p: Record, y: Any, dy: Any, thrust: float) -> float:
    """The thrust (N) that a cracked arm hands on more, or less, than its rotor makes."""
    pulsation = 2.0 * math.pi * p.arm_hz
    bend, speed = y[ARM], y[ARM + 1]
    dy[ARM] = speed
    dy[ARM + 1] = pulsation * (pulsation * (thrust - bend) - 2.0 * p.arm_damping * speed)
    extra: float = p.arm_gain * (bend - thrust)
    return extra


def _apply(p: Any, values: Values) -> None:
    p["arm_hz"], p["arm_gain"] = values["frequency_hz"], values["gain"]
    p["arm_damping"], p["arm_rotor"] = values["damping"], int(values["rotor"]) - 1
    if values["gain"] != 0:
        p["states"] = ALL_STATES


EFFECT = Effect(
    parameters={
        "rotor": (1.0, ""),
        "frequency_hz": (35.0, "Hz"),
        "gain": (0.4, ""),
        "damping": (0.05, ""),
    },
    apply=_apply,
    draw=lambda generator: {
        "rotor": float(generator.integers(1, 5)),
        "frequency_hz": size(generator, 15.0, 60.0),
        "gain": size(generator, 0.1, 0.5),
        "damping": 0.05,
    },
    limits={
        "rotor": ROTOR,
        "frequency_hz": (0.1, 250.0),
        "gain": (-10.0, 10.0),
        "damping": (0.0, 1.0),
    },
    listed=False,
)
