"""A load on a line: a pendulum tied 1 cm below the centre, small swings."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, Values, size
from firmware_sim.layout import ALL_STATES, LOAD, Record

ATTACHMENT_M = 0.01
"""The load's line is tied this far below the centre of gravity."""


@inner
def slung_load(p: Record, y: Any, dy: Any, lift: float) -> Any:
    """A load on a line, small swings; returns its pull (N, inertial x, y, z).

    ``lift`` is the vertical force (N) that carries craft and load. The swing's own equation,
    dy[LOAD], still lacks the craft's acceleration: the caller subtracts it.
    """
    taut = min(max(y[2] / p.load_length * 2.0 - 1.0, 0.0), 1.0)
    gravity = taut * max(lift, 0.0) / (p.mass + p.load_mass)
    for axis in range(2):
        swing, speed = y[LOAD + axis], y[LOAD + 2 + axis]
        dy[LOAD + axis] = speed
        dy[LOAD + 2 + axis] = -gravity / p.load_length * swing - 0.4 * speed
    pull = p.load_mass * gravity
    return (
        pull * y[LOAD] / p.load_length,
        pull * y[LOAD + 1] / p.load_length,
        -pull,
    )


def _apply(p: Any, values: Values) -> None:
    p["load_mass"], p["load_length"] = values["mass_kg"], values["length_m"]
    if values["mass_kg"] > 0:
        p["states"] = ALL_STATES


EFFECT = Effect(
    parameters={"mass_kg": (0.002, "kg"), "length_m": (0.3, "m")},
    apply=_apply,
    draw=lambda generator: {
        "mass_kg": size(generator, 0.5e-3, 3e-3),
        "length_m": size(generator, 0.15, 0.5),
    },
    limits={"mass_kg": (0.0, 0.02), "length_m": (0.02, 10.0)},
    listed=False,
)
