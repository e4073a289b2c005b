"""A current that would brake a motor cannot flow through one switch, or not all of it."""

from __future__ import annotations

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, one, reads, sets, zeroes
from firmware_sim.layout import Record


@inner
def driven(p: Record, push: float) -> float:
    """What a motor's current gives, rev/s^2: push is a0 times the voltage above the back EMF."""
    if push < 0.0 and p.coasting != 0.0:
        push -= p.coasting * push
    return push


EFFECT = Effect(
    parameters={"share": (0.7, "")},
    apply=sets(coasting="share"),
    clear=zeroes("coasting"),
    present=reads(coasting="share"),
    draw=one("share", 0.3, 1.0),
    limits={"share": (-0.5, 1.0)},
)
