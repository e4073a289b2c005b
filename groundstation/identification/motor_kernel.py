"""Compiled motor simulation with sensitivities: what a Levenberg-Marquardt step needs."""

from __future__ import annotations

from typing import Any

from numba import njit


@njit(nogil=True, cache=True, error_model="numpy")
def motor_sensitivities(
    constants: Any, voltage: Any, period: float, start: float, speed: Any, sensitivity: Any
) -> None:
    """Runge-Kutta (order 4) on n' = a0 u - a1 n - a2 n^2 and on its derivatives.

    voltage: (k,) mV; row i acts from row i - 1 to row i. Fills speed (k,) and sensitivity (k, 4):
    dn/da0, dn/da1, dn/da2, dn/dn(0).
    """
    a0, a1, a2 = constants[0], constants[1], constants[2]
    n = start
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 1.0
    speed[0] = n
    sensitivity[0, 0], sensitivity[0, 1], sensitivity[0, 2], sensitivity[0, 3] = s0, s1, s2, s3
    h = period
    for k in range(1, len(voltage)):
        u = voltage[k]
        push = a0 * u
        k1 = push - (a1 + a2 * n) * n
        m2 = n + 0.5 * h * k1
        k2 = push - (a1 + a2 * m2) * m2
        m3 = n + 0.5 * h * k2
        k3 = push - (a1 + a2 * m3) * m3
        m4 = n + h * k3
        k4 = push - (a1 + a2 * m4) * m4
        # The sensitivities are linear: s' = f - g s with g = a1 + 2 a2 n along the same stages.
        g1, g2 = a1 + 2.0 * a2 * n, a1 + 2.0 * a2 * m2
        g3, g4 = a1 + 2.0 * a2 * m3, a1 + 2.0 * a2 * m4
        s0 = _step(s0, h, g1, g2, g3, g4, u, u, u, u)
        s1 = _step(s1, h, g1, g2, g3, g4, -n, -m2, -m3, -m4)
        s2 = _step(s2, h, g1, g2, g3, g4, -n * n, -m2 * m2, -m3 * m3, -m4 * m4)
        s3 = _step(s3, h, g1, g2, g3, g4, 0.0, 0.0, 0.0, 0.0)
        n += h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        speed[k] = n
        sensitivity[k, 0], sensitivity[k, 1] = s0, s1
        sensitivity[k, 2], sensitivity[k, 3] = s2, s3


@njit(nogil=True, error_model="numpy", inline="always")
def _step(
    s: float,
    h: float,
    g1: float,
    g2: float,
    g3: float,
    g4: float,
    f1: float,
    f2: float,
    f3: float,
    f4: float,
) -> float:
    k1 = f1 - g1 * s
    k2 = f2 - g2 * (s + 0.5 * h * k1)
    k3 = f3 - g3 * (s + 0.5 * h * k2)
    k4 = f4 - g4 * (s + h * k3)
    return s + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


@njit(nogil=True, cache=True, error_model="numpy")
def motor_normal_equations(
    speed: Any,
    sensitivity: Any,
    measured: Any,
    weight: Any,
    lag: Any,
    delay: float,
    offset: int,
    normal: Any,
    gradient: Any,
) -> float:
    """Add one run's J^T W J and J^T W e; returns its weighted sum of squared errors.

    Parameters: a0, a1, a2, the common delay (rows), and at index ``offset`` the run's initial
    speed. lag: (k,) rows by which each measurement is older than its row, before the delay.
    """
    total = 0.0
    last = len(speed) - 1
    for k in range(len(speed)):
        if weight[k] == 0.0:
            continue
        place = min(max(k - lag[k] - delay, 0.0), float(last))
        i = min(int(place), last - 1)
        share = place - i
        change = speed[i + 1] - speed[i]
        error = measured[k] - (speed[i] + share * change)
        row = (
            sensitivity[i, 0] + share * (sensitivity[i + 1, 0] - sensitivity[i, 0]),
            sensitivity[i, 1] + share * (sensitivity[i + 1, 1] - sensitivity[i, 1]),
            sensitivity[i, 2] + share * (sensitivity[i + 1, 2] - sensitivity[i, 2]),
            -change,
            sensitivity[i, 3] + share * (sensitivity[i + 1, 3] - sensitivity[i, 3]),
        )
        w = weight[k]
        total += w * error * error
        for a in range(5):
            at = a if a < 4 else offset
            gradient[at] += w * row[a] * error
            for b in range(5):
                normal[at, b if b < 4 else offset] += w * row[a] * row[b]
    return total
