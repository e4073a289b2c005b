"""One rotor's thrust and drag times 1 + excess."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_sim.effects.effect import ROTOR, Effect, Values, size


def _apply(p: Any, values: Values) -> None:
    p["strength"][int(values["rotor"]) - 1] = 1.0 + values["excess"]


def _present(p: Any) -> Values | None:
    for rotor in np.flatnonzero(p["strength"] != 1.0):
        return {"rotor": float(rotor + 1), "excess": float(p["strength"][rotor] - 1.0)}
    return None


def _draw(generator: np.random.Generator) -> Values:
    sign = generator.choice((-1.0, 1.0))
    rotor = float(generator.integers(1, 5))
    return {"rotor": rotor, "excess": float(sign * size(generator, 0.01, 0.1))}


EFFECT = Effect(
    parameters={"rotor": (1.0, ""), "excess": (0.05, "")},
    apply=_apply,
    present=_present,
    draw=_draw,
    limits={"rotor": ROTOR, "excess": (-1.0, 1.0)},
    hidden=6,
)
