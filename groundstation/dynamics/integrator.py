"""The one integrator: classical Runge-Kutta, order 4."""

from __future__ import annotations

from typing import Any

from groundstation.compiled import spliced


def runge_kutta(slope: Any) -> Any:
    """A step of y' = slope(context, half, y, dy) with a compiled ``slope`` that fills dy.

    half: how many half steps from the start, 0, 1 or 2. The step is called as
    (context, h, size, y, dy, base, total): it advances y[:size] by h; the rest is room.
    """

    @spliced
    def step(context: Any, h: float, size: int, y: Any, dy: Any, base: Any, total: Any) -> None:
        for i in range(size):
            base[i] = y[i]
            total[i] = 0.0
        for stage in range(4):
            slope(context, (stage + 1) // 2, y, dy)
            weight = 2.0 if stage == 1 or stage == 2 else 1.0
            ahead = h if stage == 2 else 0.5 * h
            for i in range(size):
                total[i] += weight * dy[i]
                y[i] = base[i] + ahead * dy[i]
        for i in range(size):
            y[i] = base[i] + h / 6.0 * total[i]

    return step
