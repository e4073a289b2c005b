"""What the real log excerpt of the thesis (figure 5.7) proves, as numbers of any recording.

Each function takes the packet's integers (``packet_counts`` of a sample batch) so that the
same regressions run over the real flight and over a stand-in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Counts = dict[str, NDArray[np.int64]]

AXES = ("roll", "pitch", "yaw")
STOCK_SLOPES = {"roll": -4.27, "pitch": 4.27, "yaw": 3.05}
"""Stock rate gains (70, 70, 50) over 16.384 counts per deg/s, signs as in the plus mixer."""


class Slope(NamedTuple):
    value: float
    correlation: float


def mean_timestamp_step(counts: Counts) -> float:
    """Mean step of the timestamp in ticks."""
    return float(np.diff(counts["timestamp"]).mean())


def mixer_commands(counts: Counts) -> dict[str, NDArray[np.float64]]:
    """What the rate loops asked for, from the motors (plus mixer), 16-bit PWM, shape (n,)."""
    m1, m2, m3, m4 = 16.0 * counts["motors"].T
    return {
        "roll": (m4 - m2) / 2,
        "pitch": (m1 - m3) / 2,
        "yaw": (m1 - m2 + m3 - m4) / 4,
    }


def rate_gain(counts: Counts, axis: str, lag_rows: int = 1) -> Slope:
    """Slope of the command's first differences over those of the gyro ``lag_rows`` earlier.

    Differences keep the rate loop's proportional part and drop the slow attitude loop. For
    the stock firmware the motors of a row answer the gyro of the row before: lag 1.
    """
    gyro = np.diff(counts["gyro"][:, AXES.index(axis)].astype(np.float64))
    command = np.diff(mixer_commands(counts)[axis])
    if lag_rows:
        gyro, command = gyro[:-lag_rows], command[lag_rows:]
    value = np.polyfit(gyro, command, 1)[0]
    return Slope(float(value), float(np.corrcoef(gyro, command)[0, 1]))


def mean_accelerometer_counts(counts: Counts) -> float:
    """Length of the mean accelerometer vector: about 4096 x the mean thrust over weight."""
    return float(np.linalg.norm(counts["accelerometer"].mean(axis=0)))


def rows_between_angle_changes(counts: Counts, angle: str) -> NDArray[np.int64]:
    """Rows from one change of an angle to the next, shape (changes - 1,)."""
    changed = np.flatnonzero(np.diff(counts["angles"][:, AXES.index(angle)]))
    return np.diff(changed)


def angle_per_gyro(counts: Counts, angle: str) -> Slope:
    """Change of an angle at each fusion update over the gyro of the update's row.

    Exact integration over 4 ms at 100 counts per degree gives 0.0244 in magnitude. Positive
    for roll; negative for the packet's pitch, which is nose up positive.
    """
    place = AXES.index(angle)
    change = np.diff(counts["angles"][:, place])
    updates = np.flatnonzero(change)
    gyro = counts["gyro"][updates + 1, place].astype(np.float64)
    value = np.polyfit(gyro, change[updates], 1)[0]
    return Slope(float(value), float(np.corrcoef(gyro, change[updates])[0, 1]))
