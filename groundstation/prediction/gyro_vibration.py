"""How much the rotors shake the gyro, which is noise to any model of rigid flight.

Motors settle within 30 to 90 ms, so torque does next to nothing above 50 Hz, and what a gyro shows
there is vibration: 0.2 to 1.3 deg/s on real crafts, where the sensor's own noise is 0.1. An
observer that takes it for motion spoils every prediction from there. Read off a flight without a
model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import filled

Mask = NDArray[np.bool_]

FROM_HZ = 50.0
ORDER = 4
BLOCK_S = 1.0
"""The median over blocks counts: a landing shakes for a moment."""
LEAST_BLOCKS = 3


def vibration_of(gyro: Array, used: Mask, period_s: float) -> tuple[float, float, float]:
    """RMS about the body's axes above ``FROM_HZ``, rad/s.

    gyro: (n, 3) rad/s, rows that were lost NaN. used: (n,) rows in the air. 0 where rows are too
    slow to show it, or fewer than three blocks are in the air; little where they are hardly faster
    than 100 a second, for what they fold below ``FROM_HZ`` is not told from motion.
    """
    from scipy.signal import butter, sosfilt

    nothing = (0.0, 0.0, 0.0)
    known = used & np.isfinite(gyro).all(axis=1)
    rows = np.flatnonzero(known)
    size = round(BLOCK_S / period_s)
    if 2.0 * FROM_HZ * period_s >= 1.0 or len(rows) < LEAST_BLOCKS * size:
        return nothing
    sections = butter(ORDER, 2.0 * FROM_HZ * period_s, "high", output="sos")
    fast = sosfilt(sections, filled(gyro), axis=0)[rows]
    whole = len(rows) // size * size
    power = np.square(fast[:whole]).reshape(-1, size, 3).mean(axis=1)
    x, y, z = np.sqrt(np.median(power, axis=0)).tolist()
    return x, y, z
