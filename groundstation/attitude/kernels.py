"""Compiled sample-by-sample filters; imported only where they run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import kernel, spliced

HALF_TURN = math.pi
SMALLEST_COSINE = 1e-3
"""Keeps Euler rates finite within 0.06 deg of a vertical nose."""


@kernel
def integrate(time: Any, rates: Any, start: Any, angles: Any) -> None:
    """Eq. 6.3-6.6 with the midpoint attitude of each step (second order)."""
    for i in range(3):
        angles[0, i] = start[i]
    for k in range(1, len(time)):
        dt = time[k] - time[k - 1]
        roll, pitch = angles[k - 1, 0], angles[k - 1, 1]
        d0, d1, _ = _euler_rates(roll, pitch, rates[k])
        e0, e1, e2 = _euler_rates(roll + 0.5 * dt * d0, pitch + 0.5 * dt * d1, rates[k])
        angles[k, 0] = roll + dt * e0
        angles[k, 1] = pitch + dt * e1
        angles[k, 2] = angles[k - 1, 2] + dt * e2


@kernel
def complement(time: Any, rates: Any, tilt: Any, start: Any, weight: float, angles: Any) -> None:
    """Eq. 6.7-6.10."""
    for i in range(3):
        angles[0, i] = start[i]
    for k in range(1, len(time)):
        dt = time[k] - time[k - 1]
        slopes = _euler_rates(angles[k - 1, 0], angles[k - 1, 1], rates[k])
        for i in range(3):
            predicted = angles[k - 1, i] + dt * slopes[i]
            angles[k, i] = predicted
            if i < 2:
                angles[k, i] += (1.0 - weight) * _wrap(tilt[k, i] - predicted)


@kernel
def kalman_axes(
    time: Any,
    rates: Any,
    tilt: Any,
    start: Any,
    q_angle: float,
    q_bias: float,
    r: float,
    attitude: Any,
    bias: Any,
) -> None:
    """Eq. 6.12-6.16 with 6.17-6.20, all three axes in step."""
    angle, offset = start.copy(), np.zeros(3)
    p00, p01, p11 = r, 0.0, 0.0  # the same for roll and pitch: they share Q, R and times
    for i in range(3):
        attitude[0, i], bias[0, i] = angle[i], offset[i]
    for k in range(1, len(time)):
        dt = time[k] - time[k - 1]
        slopes = _euler_rates(angle[0], angle[1], rates[k])
        for i in range(3):
            angle[i] += dt * (slopes[i] - offset[i])
        p00 += dt * (dt * p11 - 2.0 * p01) + q_angle
        p01 -= dt * p11
        p11 += q_bias
        gain_angle, gain_bias = p00 / (p00 + r), p01 / (p00 + r)
        for i in range(2):
            error = _wrap(tilt[k, i] - angle[i])
            angle[i] += gain_angle * error
            offset[i] += gain_bias * error
        p11 -= gain_bias * p01
        p01 -= gain_angle * p01
        p00 -= gain_angle * p00
        for i in range(3):
            attitude[k, i], bias[k, i] = angle[i], offset[i]


@spliced
def _euler_rates(roll: float, pitch: float, rate: Any) -> Any:
    """Eq. 6.3."""
    cr, sr, cp = math.cos(roll), math.sin(roll), math.cos(pitch)
    if abs(cp) < SMALLEST_COSINE:
        cp = math.copysign(SMALLEST_COSINE, cp)
    across = rate[1] * sr + rate[2] * cr
    return rate[0] + math.sin(pitch) / cp * across, rate[1] * cr - rate[2] * sr, across / cp


@spliced
def _wrap(angle: float) -> float:
    """Into -pi..pi: a craft upside down has a roll error of degrees, not of a turn."""
    return angle - 2.0 * HALF_TURN * math.floor((angle + HALF_TURN) / (2.0 * HALF_TURN))
