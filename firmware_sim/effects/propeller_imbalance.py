"""A propeller out of balance: a force and a torque in the rotors' plane that turn with it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import POSITIVE, ROTOR, Effect, Values, size, zeroes
from firmware_sim.layout import ALL_STATES, Record

HUB_M = (0.005, 0.015)
"""How far above the centre of gravity hubs are."""


@inner
def propeller_imbalance(p: Record, rotor: int, speed: float, phase: float) -> Any:
    """Force forward and left (N), torque about roll, pitch and yaw (N m), of a rotor that has
    turned ``phase`` times: counter-clockwise where ``spin`` is positive."""
    angle = 2.0 * math.pi * phase * p.spin[rotor]
    pull = p.shaking_pull * speed * speed
    twist = p.shaking_twist * speed * speed
    forward, left = pull * math.cos(angle), pull * math.sin(angle)
    about_z = p.rotor_x[rotor] * left - p.rotor_y[rotor] * forward
    return forward, left, twist * math.cos(angle), twist * math.sin(angle), about_z


def put(p: Any, rotor: float, pull: float, twist: float) -> None:
    """pull: N, twist: N m at one turn a second."""
    p["shaking_rotor"] = int(rotor) - 1
    p["shaking_pull"], p["shaking_twist"] = pull, twist
    if pull != 0.0 or twist != 0.0:
        p["states"] = ALL_STATES


def _apply(p: Any, values: Values) -> None:
    square = (2.0 * math.pi) ** 2
    pull, twist = 1e-6 * values["imbalance_g_mm"], 1e-9 * values["couple_g_mm2"]
    put(p, values["rotor"], square * pull, square * twist)


def _present(p: Any) -> Values | None:
    square = (2.0 * math.pi) ** 2
    pull, twist = float(p["shaking_pull"]), float(p["shaking_twist"])
    if pull == 0.0 and twist == 0.0:
        return None
    return {
        "rotor": float(p["shaking_rotor"] + 1),
        "imbalance_g_mm": 1e6 * pull / square,
        "couple_g_mm2": 1e9 * twist / square,
    }


def _draw(generator: np.random.Generator) -> Values:
    imbalance = size(generator, 0.01, 0.1)
    hub_mm = 1e3 * size(generator, *HUB_M)
    return {
        "rotor": float(generator.integers(1, 5)),
        "imbalance_g_mm": imbalance,
        "couple_g_mm2": imbalance * hub_mm,
    }


EFFECT = Effect(
    parameters={
        "rotor": (1.0, ""),
        "imbalance_g_mm": (0.03, "g mm"),
        "couple_g_mm2": (0.3, "g mm^2"),
    },
    apply=_apply,
    clear=zeroes("shaking_pull", "shaking_twist"),
    present=_present,
    draw=_draw,
    limits={"rotor": ROTOR, "imbalance_g_mm": POSITIVE, "couple_g_mm2": POSITIVE},
)
