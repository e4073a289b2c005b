"""Compiled motor simulation with its sensitivities."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.compiled import kernel, spliced


@kernel
def motor_sensitivities(
    constants: Any, voltage: Any, period: float, start: float, speed: Any, sensitivity: Any
) -> None:
    """Runge-Kutta (order 4) on n' = a0 u - a1 n - a2 n^2 and on its derivatives, with
    motor_dead_voltage, motor_coasting and motor_braking_asymmetry.

    constants: a0, a1, a2, dead voltage (mV), share, factor. voltage: (k,) mV; row i acts from row
    i - 1 to row i. Fills speed (k,) and sensitivity (k, 4 or 7): dn/da0, dn/da1, dn/da2, dn/dn(0)
    and, where there is room, by the three effects.
    """
    a0, a1, a2 = constants[0], constants[1], constants[2]
    dead, share, factor = constants[3], constants[4], constants[5]
    n = start
    columns = sensitivity.shape[1]
    s = np.zeros(columns)
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
        for j in range(columns):
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
