"""One switch cannot brake a motor: it slows down by itself."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, Values, one, sets
from firmware_sim.layout import Record


@inner
def braked(p: Record, acceleration: float) -> float:
    """dn/dt of a motor in rev/s^2."""
    if acceleration < 0.0 and p.braking != 1.0:
        acceleration *= p.braking
    return acceleration


def _present(p: Any) -> Values | None:
    return {"factor": float(p["braking"])} if p["braking"] != 1.0 else None


EFFECT = Effect(
    parameters={"factor": (0.6, "")},
    apply=sets(braking="factor"),
    present=_present,
    draw=one("factor", 0.4, 0.9),
    limits={"factor": (0.05, 5.0)},
    hidden=5,
)
