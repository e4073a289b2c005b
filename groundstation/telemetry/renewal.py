"""How often a channel really changes.

A logger that joins sources of several rates repeats the last value of the slower ones. Rows then
promise more than was measured: the motors of a log may be renewed in one row of five.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FIELDS = ("battery_v", "duty", "gyro", "accelerometer", "attitude", "rotor_rev_s")
PAUSE = 4.0
"""Times the usual distance between two changes from which a channel rests and is not slow."""
LEAST_CHANGES = 8
SETTINGS_HZ = 400.0
"""Below it a channel that is renewed more slowly than its rows lacks something: controllers set the
motors 500 times a second."""
TOGETHER = 16
"""Neighbouring distances of changes taken as one: a clock keeps their sum, whatever its ratio to
the rows; where values change by chance, those of quantised settings in quiet air, it scatters."""
EVEN, EVEN_SHARE = 0.25, 0.6
"""Share of a hold by which distances and their sums may differ, and share of them that do not."""
HELD = 1.5
"""Mean rows that a value stands from which the rows are faster than the channel."""


def renewals(values: NDArray[Any]) -> NDArray[np.intp]:
    """Rows at which a channel (n,) or (n, k) has another value than at the last row that has one,
    the first of them included."""
    known = np.isfinite(values)
    there = known if values.ndim == 1 else known.all(axis=1)
    if there.all():
        changed = values[1:] != values[:-1]
        rows = np.flatnonzero(changed if values.ndim == 1 else changed.any(axis=1)) + 1
        return np.concatenate([[0], rows]).astype(np.intp)
    place = np.flatnonzero(there)
    if not len(place):
        return place
    return place[renewals(values[place])]


def rows_held(rows: NDArray[np.intp]) -> float:
    """Mean distance of neighbouring ``renewals`` in rows, rests left out: 1 for a channel that is
    new in every row, NaN where too few tell."""
    apart = np.diff(rows)
    if len(apart) < LEAST_CHANGES:
        return float("nan")
    return float(apart[apart <= PAUSE * np.median(apart)].mean())


def slower_than_rows(rows: NDArray[np.intp]) -> float:
    """The same where a source is slower than the rows that repeat it, else 1: then its values stand
    for nearly equal numbers of rows; what changes now and then does not."""
    apart = np.diff(rows)
    hold = rows_held(rows)
    if not hold > HELD or np.median(apart) < 2.0:
        return 1.0  # in most places new in every row
    for count in (1, min(TOGETHER, len(apart) // 2)):
        together = np.convolve(apart, np.ones(count), "valid")
        even = np.abs(together - np.median(together)) <= max(1.0, EVEN * hold)
        if even.mean() <= EVEN_SHARE:
            return 1.0
    return hold
