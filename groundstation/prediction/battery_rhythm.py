"""The rows in which a battery was read: firmware does so in every fifth row or tenth, passes it
through a filter then, and repeats what it has in between.

Taken as new in every row, such a report lags by half of that longer, and its slope, which a law
needs that undoes the lag, is all in one row and nothing in the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST = 20
"""Rows from one reading to the next: 25 Hz at 500 rows a second."""
ON_COMB, LEAST_CHANGES = 0.98, 30
"""A rhythm is one on whose rows so many of the changes lie. They are few, for a report has steps of
1 mV; by chance not even thirty of them would all be in every other row."""


def reading_rows(report: Array) -> NDArray[np.int64]:
    """Rows of a report (n,) in which it was read; all of them where it shows no rhythm."""
    changed = np.flatnonzero(np.diff(report) != 0.0) + 1
    if len(changed) >= LEAST_CHANGES:
        for stride in range(LONGEST, 1, -1):
            on = np.bincount(changed % stride, minlength=stride)
            if on.max() >= ON_COMB * len(changed):
                return np.arange(int(on.argmax()), len(report), stride)
    return np.arange(len(report))


def held(values: Array, rows: NDArray[np.int64], count: int) -> Array:
    """Values (m, ...) of the rows (m,) in which there was a reading, repeated until the next one;
    (count, ...)."""
    at = np.searchsorted(rows, np.arange(count), side="right") - 1
    return np.asarray(values[np.maximum(at, 0)])


def between_readings(report: Array) -> Array:
    """A report (n,) on straight lines from one reading to the next, each of which is reached in the
    last row that repeats it: no row knows of a later reading."""
    rows = reading_rows(report)
    if len(rows) == len(report):
        return report
    reached = rows + int(rows[1] - rows[0]) - 1
    return np.interp(np.arange(len(report)), reached, report[rows])
