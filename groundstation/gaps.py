"""Rows that a recording lacks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def filled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Missing rows on the straight line between their neighbours; all NaN stays NaN."""
    flat = values.reshape(len(values), -1)
    out = flat.copy()
    rows = np.arange(len(flat), dtype=np.float64)
    for column in range(flat.shape[1]):
        known = np.isfinite(flat[:, column])
        if known.any() and not known.all():
            out[:, column] = np.interp(rows, rows[known], flat[known, column])
    return out.reshape(values.shape)
