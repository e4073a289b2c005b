"""Friction and driver take their share before a motor turns."""

from __future__ import annotations

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import POSITIVE, Effect, one, reads, sets, zeroes
from firmware_sim.layout import Record


@inner
def armature_mv(p: Record, commanded_mv: float) -> float:
    """Voltage that drives a motor."""
    if p.dead_mv == 0.0:
        return commanded_mv
    return max(commanded_mv - p.dead_mv, 0.0)


EFFECT = Effect(
    parameters={"voltage_mv": (200.0, "mV")},
    apply=sets(dead_mv="voltage_mv"),
    clear=zeroes("start_mv"),
    present=reads(dead_mv="voltage_mv"),
    draw=one("voltage_mv", 100.0, 350.0),
    limits={"voltage_mv": POSITIVE},
    hidden=2,
)
