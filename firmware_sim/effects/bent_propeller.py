"""A torque that turns with its rotor: outside every list."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import ROTOR, Effect, Values, size
from firmware_sim.layout import ALL_STATES, Record


@inner
def bent_propeller(p: Record, speed: float, phase: float) -> Any:
    """A torque (N m on roll and pitch) that turns once with the rotor."""
    torque = p.bent_torque * speed * speed
    angle = 2.0 * math.pi * phase
    return torque * math.cos(angle), torque * math.sin(angle)


def _apply(p: Any, values: Values) -> None:
    p["bent_torque"] = values["torque_n_m"] / 250.0**2
    p["bent_rotor"] = int(values["rotor"]) - 1
    if values["torque_n_m"] != 0:
        p["states"] = ALL_STATES


EFFECT = Effect(
    parameters={"rotor": (1.0, ""), "torque_n_m": (5e-5, "N m")},
    apply=_apply,
    draw=lambda generator: {
        "rotor": float(generator.integers(1, 5)),
        "torque_n_m": size(generator, 2e-5, 2e-4),
    },
    limits={"rotor": ROTOR, "torque_n_m": (-0.01, 0.01)},
    listed=False,
)
