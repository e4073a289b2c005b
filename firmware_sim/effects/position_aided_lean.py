"""An estimator that is told how fast it moves, and takes every push for a tilt.

It reckons its velocity from the force along its sensor's axis, which it takes for the rotors'. What
else pushes the craft, thrust across the axis of a turned sensor included, shows as a
difference from the velocity that it is told, and is answered by tilting the estimate until the two
agree: a regulator with two equal poles.
"""

from __future__ import annotations

from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.effects.effect import POSITIVE, Effect, G, Values, each, reads
from firmware_sim.layout import Record

FLOW_TIME_S = 0.81
"""That of the filter behind a Flow deck, 0.5 m above the ground, whose poles are 0.95 +- 0.78i a
second."""


@inner
def tilt_taken(p: Record, s: Record, forward: float, left: float, seconds: float) -> Any:
    """Tilt (rad) that pushes along the sensor's axes (m/s^2) are taken for, ``seconds`` on."""
    _answer(p, s, 0, forward, seconds)
    _answer(p, s, 2, left, seconds)
    return s.aided[0], s.aided[2]


@inner
def _answer(p: Record, s: Record, first: int, push: float, seconds: float) -> None:
    """One axis: s.aided[first] the tilt, the next the velocity that is not explained (m/s)."""
    tilt, slip = s.aided[first], s.aided[first + 1]
    forget, correct = 2.0 / p.aided_time, 1.0 / (G * p.aided_time * p.aided_time)
    pushed = p.aided_strength * push
    half_tilt = tilt + 0.5 * seconds * correct * slip
    half_slip = slip + 0.5 * seconds * (pushed - G * tilt - forget * slip)
    s.aided[first] = tilt + seconds * correct * half_slip
    s.aided[first + 1] = slip + seconds * (pushed - G * half_tilt - forget * half_slip)


def _apply(p: Any, values: Values) -> None:
    p["aided_strength"], p["aided_time"] = values["strength"], values["time_s"]
    if values["strength"] > 0.0:
        p["ideal_attitude"] = 1


def _present(p: Any) -> Values | None:
    if p["flow_aided"] and not p["ideal_attitude"]:
        return {"strength": 1.0, "time_s": FLOW_TIME_S}
    return reads(aided_strength="strength", aided_time="time_s")(p) if p["aided_strength"] else None


def _clear(p: Any) -> None:
    p["aided_strength"] = 0.0


EFFECT = Effect(
    parameters={"strength": (1.0, ""), "time_s": (0.4, "s")},
    apply=_apply,
    clear=_clear,
    present=_present,
    draw=each(strength=(0.6, 1.2), time_s=(0.25, 0.6)),
    limits={"strength": POSITIVE, "time_s": (0.05, 10.0)},
)
