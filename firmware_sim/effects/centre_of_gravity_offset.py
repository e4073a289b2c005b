"""The thrust's lever about a centre of gravity off the rotors' centre."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, reads, sets, vector
from firmware_sim.layout import Record


@inner
def gravity_offset_torque(p: Record, thrust: float) -> Any:
    """Torque in N m on roll and pitch about a centre at (gravity_x, gravity_y)."""
    return -p.gravity_y * thrust, p.gravity_x * thrust


EFFECT = Effect(
    parameters={"x_m": (0.0, "m"), "y_m": (0.0, "m")},
    apply=sets(gravity_x="x_m", gravity_y="y_m"),
    present=reads(gravity_x="x_m", gravity_y="y_m"),
    draw=vector(0.2e-3, 2e-3, "x_m", "y_m"),
    hidden=0,
)
