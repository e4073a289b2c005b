"""Compiled loops on linear models: PID on ARX polynomials, their stability and sensitivity.

Imported only where a loop is closed. One file, because the compiler's cache looks at the entry
point's own file only.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from groundstation.compiled import kernel

BAND = 0.05
TAIL = 0.1
"""The band of settling, and the share of the window over which the settled value is taken."""


@kernel
def measure(y: Any, period: float, band: float, out: Any) -> None:
    """Metrics (``metrics.py``) of a response to a unit step: fills rms, overshoot in percent,
    settling into a band (NaN: not settled), steady-state error."""
    rows = len(y)
    square, highest = 0.0, -math.inf
    for k in range(rows):
        square += (1.0 - y[k]) * (1.0 - y[k])
        highest = max(highest, y[k])
    tail = max(1, int(TAIL * rows + 0.5))
    settled = 0.0
    for k in range(rows - tail, rows):
        settled += y[k]
    settled /= tail
    last = rows - 1
    while last >= 0 and abs(y[last] - settled) <= band:
        last -= 1
    out[0] = math.sqrt(square / rows)
    out[1] = max(0.0, 100.0 * (highest - 1.0))
    out[2] = math.nan
    if math.isfinite(square) and last < rows - tail:
        out[2] = (last + 1) * period
    out[3] = 1.0 - settled


@kernel
def measure_many(y: Any, period: float, band: float, out: Any) -> None:
    """``measure`` of responses (m, k), into out (m, 4 or more)."""
    for m in range(len(y)):
        measure(y[m], period, band, out[m])


@kernel
def direct_run(
    a: Any,
    b: Any,
    delay: int,
    gains: Any,
    period: float,
    reference: Any,
    y: Any,
    u: Any,
) -> None:
    """PID on A(q) y = q^-delay B(q) u: fills outputs and inputs, as long as the reference.

    a: (na,) from a1. b: (nb,) from b0. gains: kp, ki, kd.
    """
    kp, ki, kd = gains[0], gains[1], gains[2] / period
    integral, before = 0.0, 0.0
    na, nb = len(a), len(b)
    for k in range(len(reference)):
        value = 0.0
        for i in range(min(na, k)):
            value -= a[i] * y[k - 1 - i]
        for i in range(nb):
            at = k - delay - i
            if at >= 0 and at < k:
                value += b[i] * u[at]
        y[k] = value
        error = reference[k] - value
        u[k] = kp * error + ki * integral + kd * (error - before)
        integral += period * error
        before = error


@kernel
def characteristic(a: Any, b: Any, delay: int, gains: Any, period: float, out: Any) -> int:
    """Fills the closed loop's characteristic polynomial in q^-1, lowest power first; its length.

    A (1 - q^-1) + q^-delay B C, the factor 1 - q^-1 only where there is an integral.
    """
    kp, ki, kd = gains[0], gains[1], gains[2] / period
    for i in range(len(out)):
        out[i] = 0.0
    na, nb = len(a), len(b)
    out[0] = 1.0
    for i in range(na):
        out[i + 1] += a[i]
    if ki != 0.0:
        for i in range(na + 1, 0, -1):
            out[i] -= out[i - 1]
        numerator = (kp + kd, period * ki - kp - 2.0 * kd, kd)
        size = na + 2
    else:
        numerator = (kp + kd, -kd, 0.0)
        size = na + 1
    for i in range(nb):
        for j in range(3):
            out[delay + i + j] += b[i] * numerator[j]
    return max(size, delay + nb + 2)


@kernel
def inside_unit_circle(polynomial: Any, size: int) -> bool:
    """Whether every root of a polynomial in q^-1 (lowest power first) has |z| < 1 (Jury).

    Destroys its argument.
    """
    top = size - 1
    while top > 0 and polynomial[top] == 0.0:
        top -= 1
    while top > 0:
        ratio = polynomial[top] / polynomial[0]
        if not abs(ratio) < 1.0:
            return False
        for i in range((top + 1) // 2):
            low, high = polynomial[i], polynomial[top - i]
            polynomial[i] = low - ratio * high
            polynomial[top - i] = high - ratio * low
        if top % 2 == 0:
            polynomial[top // 2] *= 1.0 - ratio
        top -= 1
    return True


@kernel
def sensitivity_peak(plant: Any, z: Any, gains: Any, period: float) -> float:
    """max |1 / (1 + P C)| over a grid: plant response and z = exp(i omega Ts), complex (n,)."""
    kp, ki, kd = gains[0], gains[1], gains[2] / period
    least = math.inf
    for i in range(len(z)):
        controller = kp + ki * period / (z[i] - 1.0) + kd * (1.0 - 1.0 / z[i])
        away = 1.0 + plant[i] * controller
        least = min(least, away.real * away.real + away.imag * away.imag)
    return 1.0 / math.sqrt(least)


@kernel
def judge_many(
    a: Any,
    b: Any,
    delay: int,
    spare: int,
    plant: Any,
    z: Any,
    candidates: Any,
    period: float,
    reference: Any,
    out: Any,
) -> None:
    """Judge gains (m, 3): fills (m, 6) with rms, overshoot, settling, steady-state error,
    maximum sensitivity and effort, the largest |u|. Unstable, or unstable with ``spare`` more
    samples of delay: all infinite."""
    rows = len(reference)
    y, u = np.empty(rows), np.empty(rows)
    polynomial = np.empty(delay + spare + len(a) + len(b) + 4)
    for m in range(len(candidates)):
        gains = candidates[m]
        stable = True
        for late in (delay, delay + spare):
            size = characteristic(a, b, late, gains, period, polynomial)
            stable = stable and inside_unit_circle(polynomial, size)
        if not stable:
            for i in range(6):
                out[m, i] = math.inf
            continue
        out[m, 4] = sensitivity_peak(plant, z, gains, period)
        direct_run(a, b, delay, gains, period, reference, y, u)
        measure(y, period, BAND, out[m])
        out[m, 5] = 0.0
        for k in range(rows):
            out[m, 5] = max(out[m, 5], abs(u[k]))
