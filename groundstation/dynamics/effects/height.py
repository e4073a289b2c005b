"""Height above the ground, which no sensor measures, where a recording can tell it all the same.

The accelerometer, less what it shows beyond 1 g at rest, is integrated twice from the motors'
start. Where the flight ends at rest again, the craft has come down to where it took off: a
constant error of the acceleration is reckoned from that. Integrating back from the rest instead
would go through the impact, which no sample shows as it was.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

CLIMB_S, LANDING_S = 6.0, 2.0
"""Height is known for so long after the motors' start and before they stop: to some cm."""
REST_S, LEAST_REST_S = 3.0, 0.2
"""The accelerometer's offset is judged by so much of the rest before the start."""
FALL_S, FALLING = 0.6, 0.5
"""How long a craft may fall once its motors have stopped, feeling less than this share of 1 g."""


def rise_of(attitude: Array, accelerometer: Array) -> Array:
    """Vertical acceleration (n,) in m/s^2 from attitude (n, 3) and specific force (n, 3), FLU;
    0 where either is unknown."""
    roll, pitch = attitude[:, 0], attitude[:, 1]
    x, y, z = accelerometer.T
    up = -np.sin(pitch) * x + np.cos(pitch) * (np.sin(roll) * y + np.cos(roll) * z)
    return np.asarray(np.where(np.isfinite(up), up - STANDARD_GRAVITY, 0.0))


def heights_of(
    rise: Array, still: NDArray[np.bool_], start: int, stop: int, period_s: float
) -> Array:
    """Height in m at the rows (stop - start,) while the motors turn, infinite where unknown.

    rise: (n,) vertical acceleration of the whole recording; still: (n,) rows in which no motor
    is driven. Nothing is known of a flight that was in the air when the recording began.
    """
    height = np.full(stop - start, np.inf)
    before = slice(max(0, start - round(REST_S / period_s)), start)
    rest = rise[before][still[before]]
    if len(rest) * period_s < LEAST_REST_S:
        return height
    down = _touch_down(rise, stop, period_s)
    last = stop if down is None else down
    climbed = np.cumsum(np.cumsum(rise[start:last] - rest.mean())) * period_s**2
    if down is not None:
        climbed -= climbed[-1] * (np.arange(1, len(climbed) + 1) / len(climbed)) ** 2
    climbed = climbed[: stop - start]
    rows, landing = round(CLIMB_S / period_s), round(LANDING_S / period_s)
    height[:rows] = climbed[:rows]
    if down is not None:
        height[-landing:] = climbed[-landing:]
    return height


def _touch_down(rise: Array, stop: int, period_s: float) -> int | None:
    """The row of the impact, or of the motors' stop where the craft stood already; None where the
    recording does not show it."""
    rows = round(FALL_S / period_s)
    fall = rise[stop : stop + rows]
    if len(fall) < rows:
        return None
    falling = np.flatnonzero(fall < (FALLING - 1.0) * STANDARD_GRAVITY)
    return stop + int(falling[-1]) + 1 if len(falling) else stop
