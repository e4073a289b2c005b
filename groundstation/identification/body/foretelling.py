"""What past errors of a body model foretell of those to come: trim, air, noise of the sensor.

The sum of the next rows' errors is regressed on fading memories of the errors up to now. Flights
differ in what they foretell (air, speed, balance), so the weights start as those of the flights
that were fitted and are learnt on, every half a second, from the flight's own past; no row of
the future counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from groundstation.telemetry.arrays import Array

Learnt = tuple[Array, Array]
"""Normal matrix (m, m) and right-hand side (m,) of the regression, sums over rows."""

MEMORIES_S = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 2.0)
"""Fading times; the first is the last row alone."""
EVERY_S = 0.5
FITTED_S = 2.0
"""The flights that were fitted count as so much of the flight's own past."""
RIDGE = 1e-4
"""Memories of similar length are alike."""


def learnt(series: Sequence[Array], rows: int, period_s: float) -> Learnt:
    """What whole flights' errors (n,) show, as ``FITTED_S`` of one flight."""
    size = len(MEMORIES_S)
    normal, score, seen = np.zeros((size, size)), np.zeros(size), 0
    for errors in series:
        memories, sums = _memories(errors, rows, period_s), _sums(errors, rows)
        normal += memories.T @ memories
        score += memories.T @ sums
        seen += len(sums)
    share = FITTED_S / (max(seen, 1) * period_s)
    return share * normal, share * score


def foretold(errors: Array, rows: int, period_s: float, before: Learnt) -> Array:
    """Sums (n + 1 - rows,) of the next ``rows`` errors, as they are expected before each of them
    (n,), and after the last that has as many to come."""
    memories, sums = _memories(errors, rows, period_s), _sums(errors, rows)
    normal, score = before
    block = max(1, round(EVERY_S / period_s))
    made = np.zeros(len(sums))
    for first in range(0, len(sums), block):
        made[first : first + block] = memories[first : first + block] @ _solved(normal, score)
        # By the next block these sums are over.
        over = slice(max(0, first - rows), max(0, first + block - rows))
        normal = normal + memories[over].T @ memories[over]
        score = score + memories[over].T @ sums[over]
    return made


def _solved(normal: Array, score: Array) -> Array:
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    ridge = RIDGE * np.eye(len(score))
    return np.linalg.solve(normal / np.outer(scale, scale) + ridge, score / scale) / scale


def _sums(errors: Array, rows: int) -> Array:
    total = np.concatenate([[0.0], np.cumsum(errors)])
    return total[rows:] - total[:-rows]


def _memories(errors: Array, rows: int, period_s: float) -> Array:
    """Fading means (n + 1 - rows, m) of the errors before each row, for as many as have
    ``rows`` to come."""
    from scipy.signal import lfilter

    found = np.zeros((len(errors) + 1, len(MEMORIES_S)))
    for i, memory in enumerate(MEMORIES_S):
        keep = math.exp(-period_s / memory) if memory else 0.0
        found[1:, i] = lfilter([1.0 - keep], [1.0, -keep], errors)
    return found[: len(errors) + 1 - rows]
