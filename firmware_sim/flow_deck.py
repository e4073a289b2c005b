"""The sensors of a Flow deck: how the ground moves in its camera, and how far away it is."""

from __future__ import annotations

import math
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import RATE, SENSOR_STREAM, Record
from firmware_sim.random_numbers import normal

PIXELS_PER_RAD = 35.0 / 0.71674
"""Of the camera: pixels over its field of view of 42 degrees, as the firmware counts them."""
COUNTS_PER_PIXEL = 10.0
MOST_COUNTS = 100
"""What moves faster between two looks is not seen."""
SHARP_M, BLIND_M = 0.08, 0.03
"""Nearer ground is a blur, which moves as if it were there, and then nothing: on the floor the
estimated speed runs away."""
CONE_RAD = math.radians(7.5)
"""The range sensor sees a cone: a tilt below its half angle does not lengthen the range."""
RANGE_NOISE_M, MOST_RANGE_M = 0.003, 4.0


@inner
def measure_flow(p: Record, s: Record, seconds: float) -> Any:
    """Whether anything was seen in the last ``seconds``, and the pixels that the craft went by:
    ahead and to the left, in tenths."""
    y = s.y
    w, a, b, c = y[6], y[7], y[8], y[9]
    upright = 1 - 2 * (a * a + b * b)
    if upright < 0.1 or y[2] < BLIND_M:
        return False, 0.0, 0.0
    ahead = (
        (1 - 2 * (b * b + c * c)) * y[3] + 2 * (a * b + w * c) * y[4] + 2 * (a * c - w * b) * y[5]
    )
    aside = (
        2 * (a * b - w * c) * y[3] + (1 - 2 * (a * a + c * c)) * y[4] + 2 * (b * c + w * a) * y[5]
    )
    per_m = upright / max(y[2], SHARP_M)
    forward = _counted(p, s, seconds * (ahead * per_m - y[RATE + 1]))
    leftward = _counted(p, s, seconds * (aside * per_m + y[RATE]))
    seen = abs(forward) < MOST_COUNTS and abs(leftward) < MOST_COUNTS
    return seen, forward / COUNTS_PER_PIXEL, leftward / COUNTS_PER_PIXEL


@inner
def _counted(p: Record, s: Record, angle: float) -> float:
    counts = COUNTS_PER_PIXEL * PIXELS_PER_RAD * angle
    return math.floor(counts + p.flow_noise * normal(s.rng, SENSOR_STREAM) + 0.5)


@inner
def measure_range(p: Record, fw: Record, s: Record, cone: bool) -> None:
    """``fw.range_m``: what the sensor says, which may have stuck. cone: it sees the nearest point
    of one."""
    noise = RANGE_NOISE_M * normal(s.rng, SENSOR_STREAM)
    if p.range_sticks_ns >= 0 and s.now_ns - s.boot_ns >= p.range_sticks_ns:
        if p.range_stuck_m >= 0.0:
            fw.range_m = p.range_stuck_m
        return
    upright = 1.0 - 2.0 * (s.y[7] * s.y[7] + s.y[8] * s.y[8])
    longer = widened(upright) if cone else 1.0 / max(upright, 0.5)
    fw.range_m = max(max(s.y[2], 0.0) * longer + noise, 0.0)


@inner
def widened(upright: float) -> float:
    """Range over height of a sensor that sees a cone; ``upright`` is the cosine of its tilt."""
    tilt = math.acos(min(max(upright, 0.1), 1.0))
    return 1.0 / math.cos(max(tilt - CONE_RAD, 0.0))
