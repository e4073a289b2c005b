"""Thrust lost with the climb speed along the body's z."""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import Effect, G, Values, one
from firmware_sim.layout import Record


@inner
def inflow_loss(p: Record, climb: float) -> float:
    """Specific force in m/s^2 at a climb speed in m/s."""
    loss: float = -p.inflow * climb
    return loss


def _apply(p: Any, values: Values) -> None:
    p["inflow"] = values["loss_g_per_m_s"] * G


def _present(p: Any) -> Values | None:
    return {"loss_g_per_m_s": float(p["inflow"] / G)} if p["inflow"] else None


EFFECT = Effect(
    parameters={"loss_g_per_m_s": (0.03, "g per m/s")},
    apply=_apply,
    present=_present,
    draw=one("loss_g_per_m_s", 0.01, 0.05),
)
