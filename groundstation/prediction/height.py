"""Height above the ground, which no sensor measures, where a recording can tell it all the same.

The accelerometer, less what it shows beyond 1 g at rest, is integrated twice from the motors'
start. Where the flight ends at rest again, the craft has come down to where it took off: a
constant error of the acceleration is reckoned from that. Integrating back from the rest instead
would go through the impact, which no sample shows as it was.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.gaps import filled
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

KNOWN_S = 6.0
"""Height is known for so long after the motors' start and before they stop: to some cm near either
end, to a tenth of a metre where the ground does little any more."""
REST_S, LEAST_REST_S = 3.0, 0.2
"""The accelerometer's offset is judged by so much of the rest before the start."""
MAYBE_LOW_M, LONGEST_LOW_S = 0.35, 10.0
"""Where a recording breaks off below this height it may have landed; not if it was so low for
longer: that is drift."""
FALL_S, FALLING = 0.6, 0.5
"""How long a craft may fall once its motors have stopped, feeling less than this share of 1 g."""


def rise_of(attitude: Array, accelerometer: Array) -> Array:
    """Vertical acceleration (n,) in m/s^2 from attitude (n, 3) and specific force (n, 3), FLU.

    Rows that lack either are bridged, for the craft rises in them as well: attitude is new in every
    second row or third. 0 where either is unknown throughout.
    """
    roll, pitch = filled(attitude[:, :2]).T
    x, y, z = filled(accelerometer).T
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
    down = _touch_down(rise, stop, period_s)
    climbed = _climbed(rise, still, start, stop if down is None else down, period_s)
    if climbed is None:
        return height
    if down is not None:
        climbed -= climbed[-1] * (np.arange(1, len(climbed) + 1) / len(climbed)) ** 2
    climbed = climbed[: stop - start]
    rows = round(KNOWN_S / period_s)
    height[:rows] = climbed[:rows]
    if down is not None:
        height[-rows:] = climbed[-rows:]
    return height


def low_at_the_end(
    rise: Array, still: NDArray[np.bool_], start: int, stop: int, period_s: float
) -> int:
    """Rows before ``stop`` in which a craft may have been in ground effect, or stood, where the
    recording breaks off: drift leaves half a minute's height good to some 10 cm."""
    climbed = _climbed(rise, still, start, stop, period_s)
    if climbed is None:
        return 0
    high = np.flatnonzero(climbed > MAYBE_LOW_M)
    low = len(climbed) - 1 - int(high[-1]) if len(high) else 0
    return low if low * period_s < LONGEST_LOW_S else 0


def _climbed(
    rise: Array, still: NDArray[np.bool_], start: int, stop: int, period_s: float
) -> Array | None:
    """Height (stop - start,) from the rest before ``start`` on, with its drift; None without."""
    before = slice(max(0, start - round(REST_S / period_s)), start)
    rest = rise[before][still[before]]
    if len(rest) * period_s < LEAST_REST_S:
        return None
    return np.asarray(np.cumsum(np.cumsum(rise[start:stop] - rest.mean())) * period_s**2)


def _touch_down(rise: Array, stop: int, period_s: float) -> int | None:
    """The row of the impact, or of the motors' stop where the craft stood already; None where the
    recording does not show it."""
    rows = round(FALL_S / period_s)
    fall = rise[stop : stop + rows]
    if len(fall) < rows:
        return None
    falling = np.flatnonzero(fall < (FALLING - 1.0) * STANDARD_GRAVITY)
    return stop + int(falling[-1]) + 1 if len(falling) else stop
