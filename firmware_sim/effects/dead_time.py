"""A pure delay: all sensors and angles show the past; it adds to the sensor's own age."""

from __future__ import annotations

from typing import Any

from firmware_sim.effects.effect import Effect, Values, one
from firmware_sim.layout import PASS_NS

MOST_DELAY_S = 0.04


def _apply(p: Any, values: Values) -> None:
    p["pipeline_ns"] += round(values["delay_s"] * 1e9)
    if p["dlpf_s"][0] == 0:  # the ideal sensor samples so that the loop need not wait
        p["sensor_phase_ns"] = -int(p["pipeline_ns"]) % PASS_NS


def _present(p: Any) -> Values | None:
    """Of the faithful sensor its mean: DLPF lag, pure delay, bus, and half a pass of waiting."""
    age_s = float(p["pipeline_ns"]) * 1e-9 + float(p["dlpf_s"][0])
    age_s += 0.5e-9 * PASS_NS if p["dlpf_s"][0] else 0.0
    return {"delay_s": age_s} if age_s else None


EFFECT = Effect(
    parameters={"delay_s": (0.004, "s")},
    apply=_apply,
    present=_present,
    draw=one("delay_s", 1e-3, 12e-3),
    limits={"delay_s": (0.0, MOST_DELAY_S)},
)
