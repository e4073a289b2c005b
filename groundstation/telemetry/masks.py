"""Samples by a mask: blocks of consecutive ones, and values where samples are missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def spans(mask: ArrayLike) -> list[tuple[int, int]]:
    """(first, last) of each block of consecutive true samples; ``last`` is not in it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, np.int8), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def filled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """NaN samples on the straight line between their neighbours; all NaN stays NaN."""
    flat = values.reshape(len(values), -1)
    out = flat.copy()
    rows = np.arange(len(flat), dtype=np.float64)
    for column in range(flat.shape[1]):
        known = np.isfinite(flat[:, column])
        if known.any() and not known.all():
            out[:, column] = np.interp(rows, rows[known], flat[known, column])
    return out.reshape(values.shape)
