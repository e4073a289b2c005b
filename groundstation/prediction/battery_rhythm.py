"""The rows in which a battery was read: firmware does so in every fifth row or tenth, passes it
through a filter then, and repeats what it has in between.

Taken as new in every row, such a report lags by half of that longer, and its slope, which a law
needs that undoes the lag, is all in one row and nothing in the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.prediction.attitude_rhythm import EVERY_ROW, LONGEST, Rhythm
from groundstation.telemetry.arrays import Array

ON_COMB, LEAST_CHANGES = 0.98, 30
"""A rhythm is one on whose rows so many of the changes lie. They are few, for a report has steps of
1 mV; by chance not even thirty of them would all be in every other row."""


def reading_rhythm(report: Array) -> Rhythm:
    """The rhythm in which a report (n,) was read; every row where it shows none."""
    changed = np.flatnonzero(np.diff(report) != 0.0) + 1
    if len(changed) >= LEAST_CHANGES:
        for stride in range(LONGEST, 1, -1):
            on = np.bincount(changed % stride, minlength=stride)
            if on.max() >= ON_COMB * len(changed):
                return Rhythm(stride, int(on.argmax()), regular=True)
    return EVERY_ROW


def held(values: Array, rows: NDArray[np.int64], count: int) -> Array:
    """Values (m, ...) of the rows (m,) in which there was a reading, repeated until the next one;
    (count, ...)."""
    at = np.searchsorted(rows, np.arange(count), side="right") - 1
    return values[np.maximum(at, 0)]


def between_readings(report: Array) -> Array:
    """A report (n,) on straight lines from one reading to the next, each of which is reached in the
    last row that repeats it: no row knows of a later reading."""
    rhythm = reading_rhythm(report)
    if rhythm.stride == 1:
        return report
    rows = rhythm.rows(len(report))
    return np.interp(np.arange(len(report)), rows + rhythm.stride - 1, report[rows])
