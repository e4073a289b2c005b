"""A pure delay: all sensors and angles show the past; it adds to the sensor's own age."""

from __future__ import annotations

from typing import Any

from firmware_sim.effects.effect import Effect, Values, one
from firmware_sim.layout import PASS_NS

MOST_DELAY_S = 0.04
SAMPLE_STEP_NS = PASS_NS // 2
"""Sensors in step with the loop are read once or twice a pass."""


def measure_in_step(p: Any) -> None:
    """A sensor that shows everything as late as its own filter, which has a share in any delay that
    is added: sampled so that the loop need not wait."""
    p["pipeline_ns"] = -round(float(p["dlpf_s"][0]) * 1e9)
    p["sensor_period_ns"] = round(p["sensor_period_ns"] / SAMPLE_STEP_NS) * SAMPLE_STEP_NS
    p["in_step"] = 1


def _apply(p: Any, values: Values) -> None:
    p["pipeline_ns"] += round(values["delay_s"] * 1e9)
    if p["pipeline_ns"] < 0:  # less than the filter's lag: there is none
        p["pipeline_ns"] += round(float(p["dlpf_s"][0]) * 1e9)
        p["dlpf_s"] = 0.0
    if p["in_step"]:
        p["sensor_phase_ns"] = -int(p["pipeline_ns"]) % PASS_NS


def _present(p: Any) -> Values | None:
    """Of the faithful sensor its mean: DLPF lag, pure delay, bus, and half a sample of waiting."""
    age_s = float(p["pipeline_ns"]) * 1e-9 + float(p["dlpf_s"][0])
    age_s += 0.0 if p["in_step"] else 0.5e-9 * float(p["sensor_period_ns"])
    return {"delay_s": age_s} if age_s else None


EFFECT = Effect(
    parameters={"delay_s": (0.004, "s")},
    apply=_apply,
    clear=measure_in_step,
    present=_present,
    draw=one("delay_s", 1e-3, 12e-3),
    limits={"delay_s": (0.0, MOST_DELAY_S)},
)
