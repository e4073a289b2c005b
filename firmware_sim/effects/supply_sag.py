"""What a source's voltage leaves for the motors."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import POSITIVE, Effect, Values, one, reads, zeroes
from firmware_sim.layout import Record


@inner
def motor_supply_mv(
    p: Record, duty: Any, speed: Any, source_mv: float, wire_ohm: float, cell_ohm: float
) -> float:
    """The voltage at the motors, mV.

    Each motor draws duty (u - k n)/R_w with u = duty V, so V = V_s - R I is linear in V. The
    wires' current is reckoned with the bound of the back-EMF constant k, the cell's with the
    true one.
    """
    squares = 0.0
    emf = 0.0
    for i in range(4):
        squares += duty[i] * duty[i]
        emf += duty[i] * speed[i]
    emf_mv = p.back_emf * emf * (wire_ohm + p.emf_share * cell_ohm) / p.winding_ohm
    return (source_mv + emf_mv) / (1.0 + (wire_ohm + cell_ohm) / p.winding_ohm * squares)


@inner
def supply_current(p: Record, duty: Any, speed: Any, motor_mv: float, emf_share: float) -> float:
    """The motors' summed supply current in A at a motor supply voltage in mV."""
    current = 0.0
    for i in range(4):
        current += duty[i] * (duty[i] * motor_mv - emf_share * p.back_emf * speed[i])
    return current / (1000.0 * p.winding_ohm)


def _apply(p: Any, values: Values) -> None:
    p["supply_ohm"] += values["resistance_ohm"]


EFFECT = Effect(
    parameters={"resistance_ohm": (0.15, "ohm")},
    apply=_apply,
    clear=zeroes("supply_ohm"),
    present=reads(supply_ohm="resistance_ohm"),
    draw=one("resistance_ohm", 0.05, 0.35),
    limits={"resistance_ohm": POSITIVE},
    hidden=8,
)
