"""Height above the ground, which no sensor measures, where a recording can tell it all the same.

The accelerometer, less what it shows beyond 1 g at rest, is integrated twice from the motors'
start. Where the flight ends at rest again, the craft has come down to where it took off: a
constant error of the acceleration is reckoned from that. Integrating back from the rest instead
would go through the impact, which no sample shows as it was.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import filled

KNOWN_S = 6.0
"""Height is known for so long after the motors' start and at most so long before they stop: to some
cm near either end, to a tenth of a metre where the ground does little any more."""
CLEAR_M = 0.02
"""Height from which the ground carries nothing any more."""
REST_S, LEAST_REST_S = 3.0, 0.2
"""The accelerometer's offset is judged by so much of the rest before the start."""
MAYBE_LOW_M, LONGEST_LOW_S = 0.35, 10.0
"""Where a recording breaks off below this height it may have landed; not if it was so low for
longer: that is drift."""
HOP = 0.8
"""Share of its greatest height from which a flight that never came so high was not low."""
SPEED_WALK = 0.004
"""Before a landing height is known where the speed at the touch-down is: to so many m/s per root
second of the flight (white noise of 0.18 m/s^2 in 500 rows a second makes the speed walk twice as
far; the height at the touch-down tells half of it), or as well as the drift says."""
REACH_M, LANDING_DOUBT_M = 0.08, 0.01
"""How high a small craft's ground effect reaches, and what the height may be off by, times what is
left of the effect there: a craft that comes down in a second is low for too short to be misjudged,
one that hovers low for two is not."""
IDLE_SHARE, IDLE_S = 0.4, 1.0
"""Motors that are driven by less than this share of what they are in flight, for so long at the
start, idle on the ground: a sixth of the thrust (an armed Brushless idles at 7000 of 65535). At the
end they do however short it is: what they carry no more stands already, or falls."""
FALL_S, FALLING, IMPACT = 0.6, 0.5, 1.0
"""How long a craft may fall once its motors have stopped, feeling less than this share of 1 g, and
by how many g more than 1 the ground then stops it: rotors that run down are felt by less than 1."""


def rise_of(attitude: Array, accelerometer: Array) -> Array:
    """Vertical acceleration (n,) in m/s^2 from attitude (n, 3) and specific force (n, 3), FLU.

    Rows that lack either are bridged, for the craft rises in them as well: attitude is new in every
    second row or third. 0 where either is unknown throughout.
    """
    roll, pitch = filled(attitude[:, :2]).T
    x, y, z = filled(accelerometer).T
    up = -np.sin(pitch) * x + np.cos(pitch) * (np.sin(roll) * y + np.cos(roll) * z)
    return np.where(np.isfinite(up), up - STANDARD_GRAVITY, 0.0)


def lifting(driven: Array, begun: int, ended: int, period_s: float) -> tuple[int, int]:
    """Rows ``begun`` to ``ended`` of turning motors less those in which they idle before and after,
    by what drives each of them (n, 4)."""
    mean = driven[begun:ended].mean(axis=1)
    up = begun + np.flatnonzero(mean > IDLE_SHARE * np.percentile(mean, 95.0))
    first, last, idle = int(up[0]), int(up[-1]) + 1, round(IDLE_S / period_s)
    return first if first - begun > idle else begun, last


def heights_of(
    rise: Array, still: NDArray[np.bool_], start: int, stop: int, period_s: float
) -> tuple[Array, int]:
    """Height in m at the rows (stop - start,) while the motors turn, infinite where unknown, and
    the number of the last of them in which a craft may be low, or stand, at an unknown height.

    rise: (n,) vertical acceleration of the whole recording; still: (n,) rows in which no motor
    is driven, or all idle (``lifting``). Nothing is known of a flight that was in the air when the
    recording began. Half a minute's drift leaves some 10 cm: enough to tell where a recording
    breaks off that it may have landed, too much for what the ground does in a slow landing.
    """
    height = np.full(stop - start, np.inf)
    down = _touch_down(rise, stop, period_s)
    climbed = _climbed(rise, still, start, stop if down is None else down, period_s)
    if climbed is None:
        return height, 0
    rows = round(KNOWN_S / period_s)
    if down is None:
        height[:rows] = climbed[:rows]
        high = np.flatnonzero(climbed > MAYBE_LOW_M)
        low = len(climbed) - 1 - int(high[-1]) if len(high) else 0
        return height, low if low * period_s < LONGEST_LOW_S else 0
    drift, doubt = float(climbed[-1]), _speed_doubt(climbed, period_s)
    climbed -= drift * (np.arange(1, len(climbed) + 1) / len(climbed)) ** 2
    height[:rows] = climbed[: stop - start][:rows]
    before_s = np.arange(len(climbed) - 1, -1, -1) * period_s
    off = doubt * before_s * np.exp(-np.maximum(climbed, 0.0) / REACH_M)
    if float(np.max(off[before_s < KNOWN_S])) > LANDING_DOUBT_M:
        level = min(MAYBE_LOW_M, HOP * float(climbed.max()))
        surely_high = (climbed > level + doubt * before_s) & (before_s < KNOWN_S)
        low_s = float(np.min(before_s[surely_high], initial=KNOWN_S))
        return height, max(round(low_s / period_s) - (down - stop), 0)
    height[-rows:] = climbed[: stop - start][-rows:]
    return height, 0


def struck(rise: Array, first: int, last: int, shaken: float = 0.0) -> int | None:
    """The first row from ``first`` to ``last`` in which the ground stops the craft: vertical
    acceleration ``rise`` (n,) in m/s^2 beyond what rotors make at the end of a flight, and beyond
    ``shaken``, as their vibration goes."""
    found = np.flatnonzero(rise[first:last] > max(IMPACT * STANDARD_GRAVITY, shaken))
    return first + int(found[0]) if len(found) else None


def _speed_doubt(climbed: Array, period_s: float) -> float:
    """Standard error in m/s of the vertical speed at a touch-down at which the height (n,) should
    have been 0: of noise that walks as ever, and of one that drifts so far (sqrt(3)/2 of the drift
    over the time)."""
    seconds = len(climbed) * period_s
    told = 0.5 * 3.0**0.5 * abs(float(climbed[-1])) / seconds
    return float(np.hypot(SPEED_WALK * seconds**0.5, told)) / 2.0**0.5


def _climbed(
    rise: Array, still: NDArray[np.bool_], start: int, stop: int, period_s: float
) -> Array | None:
    """Height (stop - start,) from the rest before ``start`` on, with its drift; None without."""
    before = slice(max(0, start - round(REST_S / period_s)), start)
    rest = rise[before][still[before]]
    if len(rest) * period_s < LEAST_REST_S:
        return None
    return np.cumsum(np.cumsum(rise[start:stop] - rest.mean())) * period_s**2


def _touch_down(rise: Array, stop: int, period_s: float) -> int | None:
    """The row of the impact, or of the motors' stop where the craft stood already; None where the
    recording does not show it."""
    rows = round(FALL_S / period_s)
    after = rise[stop : stop + rows]
    if len(after) < rows:
        return None
    hit = struck(rise, stop, stop + rows)
    if hit is not None:  # it may bounce, and fall again
        return hit
    falling = np.flatnonzero(after < (FALLING - 1.0) * STANDARD_GRAVITY)
    return stop + int(falling[-1]) + 1 if len(falling) else stop
