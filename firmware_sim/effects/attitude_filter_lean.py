"""The firmware's Mahony filter (``fusion.py``) instead of the true angles."""

from __future__ import annotations

from typing import Any

from firmware_sim.effects.effect import Effect, Values, fixed


def _apply(p: Any, values: Values) -> None:
    if values["strength"] > 0:
        p["ideal_attitude"] = 0


def _clear(p: Any) -> None:
    p["ideal_attitude"] = 1


def _present(p: Any) -> Values | None:
    return None if p["ideal_attitude"] or p["flow_aided"] else {"strength": 1.0}


EFFECT = Effect(
    parameters={"strength": (1.0, "")},
    apply=_apply,
    clear=_clear,
    present=_present,
    draw=fixed(strength=1.0),
    limits={"strength": (0.0, 1.0)},
    hidden=7,
)
