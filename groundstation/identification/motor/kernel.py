"""Compiled motor simulation with sensitivities: what a Levenberg-Marquardt step needs."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.compiled import kernel, spliced


@kernel
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


@kernel
def flawed_sensitivities(
    constants: Any, voltage: Any, period: float, start: float, speed: Any, sensitivity: Any
) -> None:
    """The same with motor_dead_voltage, motor_coasting and motor_braking_asymmetry.

    constants: a0, a1, a2, dead voltage (mV), share, factor. sensitivity (k, 7): three more
    columns, by these.
    """
    a0, a1, a2 = constants[0], constants[1], constants[2]
    dead, share, factor = constants[3], constants[4], constants[5]
    n = start
    s = np.zeros(7)
    s[3] = 1.0
    speed[0] = n
    sensitivity[0] = s
    m, slope, gain, g, f = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    flows, push = np.zeros(4), np.zeros(4)
    h = period
    for k in range(1, len(voltage)):
        u = max(voltage[k] - dead, 0.0) if voltage[k] > 0.0 else 0.0
        for i in range(4):
            reach = 0.0 if i == 0 else (h if i == 3 else 0.5 * h)
            m[i] = n + reach * slope[i - 1] if i else n
            push[i] = a0 * u - a1 * m[i]
            flows[i] = 1.0 - share if push[i] < 0.0 else 1.0
            free = flows[i] * push[i] - a2 * m[i] * m[i]
            gain[i] = factor if free < 0.0 else 1.0
            slope[i] = gain[i] * free
            g[i] = gain[i] * (flows[i] * a1 + 2.0 * a2 * m[i])
        for j in range(7):
            for i in range(4):
                if j == 0:
                    f[i] = gain[i] * flows[i] * u
                elif j == 1:
                    f[i] = -gain[i] * flows[i] * m[i]
                elif j == 2:
                    f[i] = -gain[i] * m[i] * m[i]
                elif j == 3:
                    f[i] = 0.0
                elif j == 4:
                    f[i] = -gain[i] * flows[i] * a0 if u > 0.0 else 0.0
                elif j == 5:
                    f[i] = -gain[i] * min(push[i], 0.0)
                else:
                    f[i] = slope[i] / factor if slope[i] < 0.0 else 0.0
            s[j] = _step(s[j], h, g[0], g[1], g[2], g[3], f[0], f[1], f[2], f[3])
        n += h / 6.0 * (slope[0] + 2.0 * (slope[1] + slope[2]) + slope[3])
        speed[k] = n
        sensitivity[k] = s


@spliced
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


@kernel
def motor_normal_equations(
    speed: Any,
    sensitivity: Any,
    measured: Any,
    weight: Any,
    lag: Any,
    delay: float,
    places: Any,
    normal: Any,
    gradient: Any,
) -> float:
    """Add one run's J^T W J and J^T W e; returns its weighted sum of squared errors.

    places: (m + 1,) where among the parameters each of the m sensitivities belongs, then the
    common delay (rows). lag: (k,) rows by which each measurement is older than its row, before
    the delay.
    """
    total = 0.0
    last, count = len(speed) - 1, len(places)
    row, slope, sums = np.empty(count), np.zeros(count), np.zeros((count, count))
    for k in range(len(speed)):
        if weight[k] == 0.0:
            continue
        place = min(max(k - lag[k] - delay, 0.0), float(last))
        i = min(int(place), last - 1)
        share = place - i
        change = speed[i + 1] - speed[i]
        error = measured[k] - (speed[i] + share * change)
        for a in range(count - 1):
            one = sensitivity[i, a]
            row[a] = one + share * (sensitivity[i + 1, a] - one)
        row[count - 1] = -change
        w = weight[k]
        total += w * error * error
        for a in range(count):
            part = w * row[a]
            slope[a] += part * error
            for b in range(a + 1):
                sums[a, b] += part * row[b]
    for a in range(count):
        gradient[places[a]] += slope[a]
        for b in range(a + 1):
            normal[places[a], places[b]] += sums[a, b]
    for a in range(count):
        for b in range(a):
            normal[places[b], places[a]] = normal[places[a], places[b]]
    return total
