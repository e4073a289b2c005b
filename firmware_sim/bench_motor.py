"""The motor bench (thesis 5.2 and 7.2): an optical gate on M1 times its propeller's blades.

Two blades: one passage each half revolution. The debug field of a row holds the last time
between two passages in ticks. The gate's pin is polled, too slowly: a passage is missed now
and then (a period twice as long) or a bounce is taken for one (a period cut in two).
"""

from __future__ import annotations

import math

from firmware_sim.compiled import inner
from firmware_sim.layout import PASS_NS, PHASE, ROTOR, SENSOR_STREAM, Record
from firmware_sim.random_numbers import uniform

TICK_NS = 73_000.0 / 72.0
MISSED, BOUNCED = 0.04, 0.02
"""Probabilities per passage at ``gate_glitches`` 1."""


@inner
def watch_gate(p: Record, s: Record, phase_before: float, speed_before: float) -> None:
    """Time the blade passages of the pass that has just been flown."""
    span = PASS_NS * 1e-9
    phase, speed = s.y[PHASE], s.y[ROTOR]
    passages = math.floor(2.0 * phase) - math.floor(2.0 * phase_before)
    for k in range(passages):
        turned = 0.5 * (math.floor(2.0 * phase_before) + 1.0 + k) - phase_before
        # phase(t) = n0 t + (n1 - n0) t^2 / 2T over the pass
        mean = 0.5 * (speed_before + speed)
        t = turned / mean if mean > 0.0 else span
        for _ in range(3):
            value = speed_before * t + 0.5 * (speed - speed_before) * t * t / span - turned
            slope = speed_before + (speed - speed_before) * t / span
            if slope > 0.0:
                t -= value / slope
        _passage(p, s, s.now_ns - PASS_NS + t * 1e9)


@inner
def _passage(p: Record, s: Record, time_ns: float) -> None:
    chance = uniform(s.rng, SENSOR_STREAM)
    where = uniform(s.rng, SENSOR_STREAM)
    if chance < MISSED * p.gate_glitches:
        return
    before = s.gate_ns
    if chance > 1.0 - BOUNCED * p.gate_glitches:
        time_ns = before + where * (time_ns - before)
    s.gate_ticks = math.floor(time_ns / TICK_NS) - math.floor(before / TICK_NS)
    s.gate_ns = time_ns
