"""What drives a model through a run: motors, battery, height, and which rows are new."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.craft import Crafts, craft_of_model
from groundstation.dynamics.effect import FAR_M
from groundstation.dynamics.model import Model
from groundstation.dynamics.sensors import sensors_of_model
from groundstation.dynamics.simulation import settled_rev_s
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import filled, spans

# Which rows hold a new attitude: firmware computes it every few rows and repeats it in between.


Mask = NDArray[np.bool_]

LONGEST = 20
"""Rows from one attitude to the next: 25 Hz at 500 rows a second."""
ON, OFF = 0.2, 0.25
"""A rhythm is one where the comb's rows are new in more than this share (a resting craft repeats
its angles), and the others in less than this share of that."""


@dataclass(frozen=True, slots=True)
class Rhythm:
    """New values come ``stride`` rows apart, the first in row ``phase``.

    regular: whether rows beside the comb hold none; otherwise the comb is the best there is.
    """

    stride: int
    phase: int
    regular: bool

    def rows(self, count: int) -> NDArray[np.int64]:
        """The comb's rows among ``count``."""
        return np.arange(self.phase, count, self.stride, dtype=np.int64)


EVERY_ROW = Rhythm(1, 0, regular=True)


def rhythm_of(changed: Mask) -> Rhythm:
    """The comb that most of the changed rows (n,) lie on."""
    rows = np.flatnonzero(changed)
    if len(rows) < 2:
        return EVERY_ROW
    stride = int(np.clip(np.rint(np.median(np.diff(rows))), 1, LONGEST))
    if stride == 1:
        return EVERY_ROW
    phase = int(np.bincount(rows % stride, minlength=stride).argmax())
    comb = np.zeros(len(changed), np.bool_)
    comb[phase::stride] = True
    on, off = float(changed[comb].mean()), float(changed[~comb].mean())
    return Rhythm(stride, phase, regular=on > ON and off < OFF * on)


def changed_rows(attitude: Array) -> Mask:
    """Rows whose angles (n, 3) differ from those of the row before; across a lost row (NaN) that
    tells nothing."""
    known = np.asarray(np.isfinite(attitude).all(axis=1))
    found = np.zeros(len(attitude), np.bool_)
    differs = (attitude[1:] != attitude[:-1]).any(axis=1)
    found[1:] = differs & known[1:] & known[:-1]
    return found


def fresh_rhythm(attitude: Array) -> Rhythm:
    """The rhythm of angles (n, 3) whose held values are repeated, or left out (NaN).

    Where they tell none, every row counts as new.
    """
    for told in (changed_rows(attitude), np.asarray(np.isfinite(attitude).all(axis=1))):
        rhythm = rhythm_of(told)
        if rhythm.stride > 1 and rhythm.regular:
            return rhythm
    return EVERY_ROW


def fresh_rows(attitude: Array) -> Mask:
    """Rows (n,) in which the attitude (n, 3) was computed anew."""
    fresh = np.zeros(len(attitude), np.bool_)
    fresh[fresh_rhythm(attitude).rows(len(attitude))] = True
    return fresh


# The rows in which a battery was read: firmware does so in every fifth row or tenth, passes it
# through a filter then, and repeats what it has in between.
#
# Taken as new in every row, such a report lags by half of that longer, and its slope, which a law
# needs that undoes the lag, is all in one row and nothing in the others.


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


# Height above the ground, which no sensor measures, where a recording can tell it all the same.
#
# The accelerometer, less what it shows beyond 1 g at rest, is integrated twice from the motors'
# start. Where the flight ends at rest again, the craft has come down to where it took off: a
# constant error of the acceleration is reckoned from that. Integrating back from the rest instead
# would go through the impact, which no sample shows as it was.


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
second of the flight (half the walk of white noise of 0.18 m/s^2 in 500 rows a second)."""
REACH_M, LANDING_DOUBT_M = 0.08, 0.01
"""How high a small craft's ground effect reaches, and what the height may be off by, times what is
left of the effect there."""
IDLE_SHARE, IDLE_S = 0.4, 1.0
"""Motors that are driven by less than this share of what they are in flight, for so long at the
start, idle on the ground (an armed Brushless idles at 7000 of 65535); at the end however short."""
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
    recording began.
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


# What a model's motors make of a run's inputs, and when the craft flies by that.
#
# Nothing here was corrected by what the sensors showed: a model's motors are driven by the recorded
# PWM and battery voltage alone.


TURNING = 0.1
"""Duty above which a motor turns."""
LANDED = 0.85
"""Thrust over weight at which a craft has come back to the ground."""


class Flown(Protocol):
    """The channels of a run (``identification.runs.Run`` is one); see there for units."""

    @property
    def period_s(self) -> float: ...
    @property
    def duty(self) -> Array: ...
    @property
    def settings(self) -> Array: ...
    @property
    def supply_v(self) -> Array: ...
    @property
    def gyro(self) -> Array: ...
    @property
    def accelerometer(self) -> Array: ...
    @property
    def attitude(self) -> Array: ...


@dataclass(frozen=True, slots=True)
class Drive:
    """A model on a run's inputs: all that does not depend on what was measured.

    speed: (2 n - 1, 4) rev/s at every row less the dead time and half-way between. push: (2 n - 1,
    5) what they do to the craft at rest at these points: specific force along z far from the
    ground and on it, m/s^2, and angular acceleration, rad/s^2.
    """

    craft: Crafts
    sensor: NDArray[np.void]
    period_s: float
    speed: Array
    push: Array

    @property
    def rotor_rev_s(self) -> Array:
        """Rotor speeds (n, 4) behind each row."""
        return np.ascontiguousarray(self.speed[::2])

    def coast(
        self, fresh: Mask, rows: NDArray[np.int64], ahead: NDArray[np.int64], *at: Array
    ) -> None:
        """Fly on the inputs from rows (m,) as the kernel of that name, with its states ``at``."""
        from groundstation.prediction.kernels import coast

        driven = self.craft[0], self.sensor[0], self.speed, self.period_s
        coast(*driven, fresh, rows, ahead, *at)

    def since(self, row: int) -> Drive:
        """The same from a row on."""
        return replace(self, speed=self.speed[2 * row :], push=self.push[2 * row :])


def drive_run(model: Model, run: Flown) -> Drive:
    """The motors of a model on a run's inputs.

    They start settled at the first row's voltage, which is forgotten after half a second.

    Raises BadInputError where PWM or battery voltage are missing.
    """
    from groundstation.prediction.kernels import drives, spin

    for name in ("duty", "supply_v"):
        if not np.isfinite(getattr(run, name)).all():
            raise BadInputError(f"{name} is missing in some rows; a model cannot fly on them")
    if len(run.duty) < 2:
        raise BadInputError("a run of one row cannot be flown; give at least two")
    craft, sensor = craft_of_model(model), sensors_of_model(model)
    supply = np.ascontiguousarray(1000.0 * between_readings(run.supply_v), np.float64)
    duty = np.ascontiguousarray(run.settings, np.float64)
    start = settled_rev_s(craft, run.duty[0], float(supply[0]))
    speed = np.empty((2 * len(supply) - 1, 4))
    spin(craft[0], duty, supply, run.period_s, float(sensor[0]["delay"]), start, speed)
    push = np.empty((len(speed), 5))
    drives(craft[0], speed, run.period_s, push)
    return Drive(craft, sensor, run.period_s, speed, push)


def flying_rows(run: Flown, drive: Drive, height: Array) -> Mask:
    """Rows (n,) in the air: from the first thrust above the weight, or from where the recording
    tells a height (a model without what the ground does has too little thrust there), until it has
    gone for good. height: (n,) as ``reckoned_height`` has it."""
    turning = turning_rows(run)
    one = drive.craft[0]
    clear = np.isfinite(height) & (height > CLEAR_M)
    lift, low_lift = drive.push[::2, 0] / one["gravity"], drive.push[::2, 1] / one["gravity"]
    flying = np.zeros(len(turning), np.bool_)
    for first, last in spans(turning):
        if first > 0:
            near = np.where(clear[first:last], LANDED, 1.0)
            up = np.flatnonzero(low_lift[first:last] > near)
            if len(up) == 0:
                continue
            first += up[0]
        if last < len(turning):
            low = np.flatnonzero(lift[first:last] < LANDED)
            high = np.flatnonzero(lift[first:last] > LANDED)
            if len(low) and len(high):
                last = first + high[-1] + 1
        flying[first:last] = True
    return flying


def turning_rows(run: Flown) -> Mask:
    """Rows (n,) in which every motor turns."""
    return np.asarray((run.duty > TURNING).all(axis=1))


def reckoned_height(run: Flown) -> Array:
    """Height (n,) in m while motors lift, infinite where a recording cannot tell it."""
    height = np.full(len(run.duty), np.inf)
    rise = rise_of(run.attitude, run.accelerometer)
    still = ~np.asarray((run.duty > 0.0).any(axis=1))
    for begun, ended in spans(turning_rows(run)):
        start, stop = lifting(run.duty, begun, ended, run.period_s)
        still[begun:start] = True
        height[start:stop], _ = heights_of(rise, still, start, stop, run.period_s)
    return height


def height_of(height: Array, flying: Mask) -> Array:
    """What was reckoned as height above ground (n,) in m: ``FAR_M`` in flight where it is not
    known, 0 elsewhere."""
    return np.where(flying, np.clip(height, 0.0, FAR_M), 0.0)
