"""Compiled free runs of many ARX structures over the same data."""

from __future__ import annotations

from typing import Any

from groundstation.compiled import kernel


@kernel
def free_run_errors(
    orders: Any, a: Any, b: Any, inputs: Any, outputs: Any, window: int, first: int, sums: Any
) -> None:
    """Add each structure's sum of squared free-run errors over one run to ``sums`` (s,).

    orders: (s, 3) na, nb, nk. a: (s, 4) and b: (s, 4), zero beyond the order. Every ``window``
    rows from row ``first`` on, a run starts afresh from the measured outputs before it.
    """
    rows = len(inputs)
    for s in range(len(orders)):
        nb, nk = orders[s, 1], orders[s, 2]
        a1, a2, a3, a4 = a[s, 0], a[s, 1], a[s, 2], a[s, 3]
        total = 0.0
        t = first
        while t < rows:
            y1, y2, y3, y4 = outputs[t - 1], outputs[t - 2], outputs[t - 3], outputs[t - 4]
            for k in range(t, min(t + window, rows)):
                y = -(a1 * y1 + a2 * y2 + a3 * y3 + a4 * y4)
                for j in range(nb):
                    y += b[s, j] * inputs[k - nk - j]
                error = outputs[k] - y
                total += error * error
                y4, y3, y2, y1 = y3, y2, y1, y
            t += window
        sums[s] += total


@kernel
def steps_ahead(
    a: Any, b: Any, nk: int, inputs: Any, outputs: Any, steps: int, first: int, predicted: Any
) -> None:
    """Fill predicted[t] with the prediction of outputs[t] from outputs up to t - ``steps``.

    a: (4,), b: (nb,). Inputs are known up to t, as in any simulation.
    """
    a1, a2, a3, a4 = a[0], a[1], a[2], a[3]
    for t in range(first + steps - 1, len(outputs)):
        start = t - steps + 1
        y1, y2 = outputs[start - 1], outputs[start - 2]
        y3, y4 = outputs[start - 3], outputs[start - 4]
        y = 0.0
        for k in range(start, t + 1):
            y = -(a1 * y1 + a2 * y2 + a3 * y3 + a4 * y4)
            for j in range(len(b)):
                y += b[j] * inputs[k - nk - j]
            y4, y3, y2, y1 = y3, y2, y1, y
        predicted[t] = y


@kernel
def step_turns_one_way(a: Any, b: Any, nk: int, settled: int, rows: int) -> bool:
    """Whether the response to a unit step stays positive and never falls, from row ``nk`` +
    ``settled`` on for ``rows`` rows after the delay. a: (4,), b: (nb,)."""
    y1, y2, y3, y4 = 0.0, 0.0, 0.0, 0.0
    drive = 0.0
    for k in range(rows):
        if k < len(b):
            drive += b[k]
        y = drive - (a[0] * y1 + a[1] * y2 + a[2] * y3 + a[3] * y4)
        if k >= settled and (y <= 0.0 or (k > settled and y < y1)):
            return False
        y4, y3, y2, y1 = y3, y2, y1, y
    return True
