"""Blocks of consecutive true rows in a mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def spans(mask: ArrayLike) -> list[tuple[int, int]]:
    """(first, last) of each block of consecutive true rows; ``last`` is not in it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, np.int8), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]
