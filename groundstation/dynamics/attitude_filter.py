"""The on-board attitude filter: Mahony, Hamel and Pflimlin, 2008, as the Crazyflie firmware has it.

A filter is ten numbers: quaternion 0-3, accelerometer as the filter has it 4-6, integral of the
error 7-9. Release 2014.01.0 smooths the accelerometer for the filter alone (``imu_acc_lpf.factor``
32 of 256); today's complementary estimator takes what its sensors' own low-pass leaves
(``estimator_complementary.c``).
"""

from __future__ import annotations

import math
from typing import Any

from groundstation.compiled import inner
from groundstation.dynamics import quaternion

SMOOTHING, SMOOTHING_S = 0.125, 0.002
"""The accelerometer filter of 2014's firmware: share of each new sample, at this period."""
UNSMOOTHED = 1.0
"""Such a share of today's."""


@inner
def smoothed(before: Any, accelerometer: Any, period: float, share: float) -> Any:
    """The accelerometer as the filter has it, one sample later. share: ``SMOOTHING`` or
    ``UNSMOOTHED``."""
    if period != SMOOTHING_S:
        share = 1.0 - (1.0 - share) ** (period / SMOOTHING_S)
    return (
        before[0] + share * (accelerometer[0] - before[0]),
        before[1] + share * (accelerometer[1] - before[1]),
        before[2] + share * (accelerometer[2] - before[2]),
    )


@inner
def fuse(q: Any, integral: Any, gyro: Any, felt: Any, gains: Any, period: float) -> Any:
    """One pass: (quaternion, integral) from the gyro (rad/s) and what the accelerometer feels.

    gains: proportional (1/s) and integral (1/s^2); a first-order step over ``period``.
    """
    w, x, y, z = q
    ex, ey, ez = 0.0, 0.0, 0.0
    size = math.sqrt(felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2])
    if size > 0.0:
        ax, ay, az = felt[0] / size, felt[1] / size, felt[2] / size
        # Up in sensor axes as the filter has it, and how far the accelerometer is from it.
        ux, uy, uz = 2.0 * (x * z - w * y), 2.0 * (w * x + y * z), w * w - x * x - y * y + z * z
        ex, ey, ez = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    step = gains[1] * period
    kept = (integral[0] + step * ex, integral[1] + step * ey, integral[2] + step * ez)
    rate = (
        gyro[0] + kept[0] + gains[0] * ex,
        gyro[1] + kept[1] + gains[0] * ey,
        gyro[2] + kept[2] + gains[0] * ez,
    )
    turn = quaternion.slope(q, rate)
    moved = (
        w + period * turn[0],
        x + period * turn[1],
        y + period * turn[2],
        z + period * turn[3],
    )
    return quaternion.normalised(moved), kept
