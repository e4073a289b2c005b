"""Channels whose rows are means of readings half a row before and half a row after.

A radio's log sends them in another block than the gyro, and a row has one time for all. Such a mean
has nothing at half the row rate: not the noise either, so a model that is not averaged alike is
judged there and nowhere else.
"""

from __future__ import annotations

import numpy as np

from groundstation.telemetry.arrays import Array

BANDS = (0.94, 1.0), (0.6, 0.8)
"""Over half the row rate: where a mean of two readings leaves nothing, where it leaves a fifth."""
ANGLES, BESIDE_GYRO = 0.05, 0.1
"""Power of the angles' rates in the first band over that in the second, at most, and the same over
the gyro's: 0.005 and 0.01 for angles made of the gyro, 0.02 and 0.05 for angles with noise of their
own (stand-in); without a mean 0.3 and more, and 0.5 and more."""
SEGMENT_ROWS = 256
"""Of the power's segments, scipy's own; it warns on the terminal where rows are fewer."""
FORCE = 0.02
"""The same of the accelerometer, on each axis: 0.005 (stand-in's 2.1); without a mean 0.07 and more
(logs of real flights)."""


def angles_read_between(rate: Array, gyro: Array) -> bool:
    """Whether angles that turn with these rates (m, 3) beside a gyro's are such means."""
    found = float(_left(rate).max())
    return found < ANGLES and found < BESIDE_GYRO * float(_left(gyro).min())


def force_read_between(accelerometer: Array) -> bool:
    """Whether rows (n, 3) of an accelerometer are."""
    return bool((_left(accelerometer) < FORCE).all())


def mean_between(values: Array) -> Array:
    """Rows (n, 3) of a model as such means."""
    half = half_a_row_later(values)
    return 0.5 * (half + np.concatenate([half[:1], half[:-1]]))


def half_a_row_later(values: Array) -> Array:
    """Rows (n, 3) half a period later, cubic through two rows on either side."""
    before, now, after, next_but_one = (
        np.pad(values, ((1, 2), (0, 0)), mode="edge")[i : i + len(values)] for i in range(4)
    )
    return (9.0 * (now + after) - before - next_but_one) / 16.0


def _left(rows: Array) -> Array:
    """Power (3,) in the first band over that in the second; 1 where there is none."""
    from scipy.signal import welch

    power = welch(rows, axis=0, nperseg=min(SEGMENT_ROWS, len(rows)))[1]
    place = np.linspace(0.0, 1.0, len(power))
    top, middle = (power[(low <= place) & (place <= high)].mean(axis=0) for low, high in BANDS)
    return np.divide(top, middle, out=np.ones(3), where=middle > 0.0)
