"""A load on a line: a pendulum of any angle, by the offset of the load from the craft."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, Values, size, zeroes
from firmware_sim.layout import ALL_STATES, LOAD, Record

STEEPEST = 0.995
"""Of the offset over the length: nearly level, where a line without a spring has no height."""
DRAG_PER_S = 10.0
"""How fast a load that lies on the ground is dragged to below the craft, as fast as that can be
without a swing: left where it lies, it comes further away than its line is long."""


@inner
def slung_load(p: Record, y: Any, dy: Any, push_x: float, push_y: float, push_z: float) -> Any:
    """A load on a line; fills the swing's slopes, returns its pull per unit of the bare craft's
    mass (m/s^2, inertial x, y, z).

    The offset r of the load keeps its length: r'' = g r - push - damping r', with the g that makes
    (r . r)'' vanish. Below half of its length above the ground the line is slack: the load lies
    there, and is dragged along. push: what else accelerates the bare craft, gravity not counted.
    """
    taut = min(max(y[2] / p.load_length * 2.0 - 1.0, 0.0), 1.0)
    x, z = y[LOAD], y[LOAD + 1]
    u, v = y[LOAD + 2], y[LOAD + 3]
    square = p.load_length * p.load_length
    flat = min(x * x + z * z, STEEPEST * square)
    down = -math.sqrt(square - flat)
    w = -(x * u + z * v) / down
    along = x * push_x + z * push_y + down * push_z
    back = taut * (along - (u * u + v * v + w * w)) / square
    dy[LOAD], dy[LOAD + 1] = u, v
    loose = DRAG_PER_S * (1.0 - taut)
    drag_u, drag_v = loose * (DRAG_PER_S * x + 2.0 * u), loose * (DRAG_PER_S * z + 2.0 * v)
    dy[LOAD + 2] = back * x - taut * push_x - p.load_damping * u - drag_u
    dy[LOAD + 3] = back * z - taut * push_y - p.load_damping * v - drag_v
    share = p.load_share
    return -share * back * x, -share * back * z, -share * back * down


def _apply(p: Any, values: Values) -> None:
    p["load_share"], p["load_length"] = values["percent"] / 100.0, values["length_m"]
    p["load_damping"], p["load_below"] = values["damping_per_s"], values["below_m"]
    if values["percent"] > 0:
        p["states"] = ALL_STATES


def _present(p: Any) -> Values | None:
    if not p["load_share"]:
        return None
    return {
        "percent": 100.0 * float(p["load_share"]),
        "length_m": float(p["load_length"]),
        "damping_per_s": float(p["load_damping"]),
        "below_m": float(p["load_below"]),
    }


def _draw(generator: np.random.Generator) -> Values:
    return {
        "percent": size(generator, 2.0, 12.0),
        "length_m": size(generator, 0.15, 0.5),
        "damping_per_s": size(generator, 0.1, 0.8),
        "below_m": float(generator.uniform(0.0, 0.02)),
    }


EFFECT = Effect(
    parameters={
        "percent": (7.0, "%"),
        "length_m": (0.3, "m"),
        "damping_per_s": (0.4, "1/s"),
        "below_m": (0.01, "m"),
    },
    apply=_apply,
    clear=zeroes("load_share"),
    present=_present,
    draw=_draw,
    limits={
        "percent": (0.0, 90.0),
        "length_m": (0.02, 10.0),
        "damping_per_s": (0.0, 100.0),
        "below_m": (-0.1, 0.1),
    },
)
