"""A flight made ready for the search: what is airborne, which rows are real, how fast the
craft moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import (
    attitude_of_matrix,
    quaternion_of_attitude,
    rotation_matrix,
)
from groundstation.errors import BadInputError
from groundstation.identification.runs import (
    RotorSquares,
    Run,
    measured_squares,
    require_known,
    without_gaps,
)
from groundstation.prediction.drive import (
    CLEAR_M,
    TURNING,
    changed_rows,
    heights_of,
    lifting,
    rhythm_of,
    rise_of,
    struck,
)
from groundstation.prediction.prediction import start_velocity
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import spans

# Which rows of a run are in the air, told from motors, accelerometer and attitude alone.
#
# A flight begins where its motors begin to turn and ends where they stop, or where the recording
# does. In between it is airborne from where the ground carries nothing to where it begins to: by
# height, where a rest on the ground tells it (``prediction.height``), otherwise by time.


Mask = NDArray[np.bool_]

TURNING_REV_S = 20.0
"""Measured speed from which a rotor turns; in flight it is ten times that."""
SETTLE_S = 0.5
"""A flight that is recorded from the air on loses this: the motors forget their unknown start."""
LANDING_CLEAR_M = 0.05
"""``CLEAR_M`` at a landing, where height is less well known."""
TAKE_OFF_S, CONTACT_S = 1.5, 1.0
"""Left out at the start and at the end where height cannot be told; the ground may carry part of
the torque."""
DRIVEN_ON_S, BEFORE_IMPACT_S = 1.0, 0.02
"""How long motors may turn on after the craft has struck the ground, and by how much earlier a
filtered or interpolated accelerometer shows it."""
SHAKEN = 1.5
"""An impact is beyond so many times the largest acceleration before: rotors shake an unfiltered
accelerometer by 1 g and more."""
REST_S = 0.2
TOUCH_DOWN_S = 0.6
"""From when the motors stop until the craft lies still: it may fall the last bit."""


@dataclass(frozen=True, slots=True)
class Air:
    """One flight within a run.

    start, stop: rows in which the motors turn. first, last: of these, the airborne ones. rests:
    whether it began and ended on the ground within the run. height_m: (n,) above the take-off
    point where it can be told, otherwise infinite. maybe_low: rows before ``last`` in which it may
    have landed where the recording breaks off (``prediction.height``): for whoever looks for what
    the ground does.
    """

    start: int
    stop: int
    first: int
    last: int
    rests: tuple[bool, bool]
    height_m: Array
    maybe_low: int


def turning(run: Run) -> Mask:
    """Rows (n,) in which all motors turn: by what drives them, or by their speed without that."""
    if np.isfinite(run.duty).any():
        return np.asarray((run.duty > TURNING).all(axis=1))
    return np.asarray((run.rotor_rev_s > TURNING_REV_S).all(axis=1))


def turning_parts(run: Run, least_s: float) -> list[Run]:
    """The stretches of a run in which all motors turn, those that last ``least_s``."""
    return [run[a:b] for a, b in spans(turning(run)) if (b - a) * run.period_s >= least_s]


def airborne(run: Run) -> Mask:
    """Rows (n,) in the air."""
    mask = np.zeros(len(run), np.bool_)
    for one in flights_in(run):
        mask[one.first : one.last] = True
    return mask


def flights_in(run: Run) -> list[Air]:
    """The flights of a run without missing rows, in order; those never in the air are left out."""
    period, has_accelerometer = run.period_s, bool(np.isfinite(run.accelerometer).any())
    driven = run.duty if np.isfinite(run.duty).any() else run.rotor_rev_s
    still = np.asarray((driven <= 0.0).all(axis=1))
    found = []
    for begun, ended in spans(turning(run)):
        start, stop = lifting(driven, begun, ended, period)
        still[begun:start] = True
        rests = (start * period > REST_S, (len(run) - stop) * period > TOUCH_DOWN_S)
        height, maybe_low = np.full(len(run), np.inf), 0
        if has_accelerometer:
            has_attitude = bool(np.isfinite(run.attitude).any())
            level = run.attitude if has_attitude else np.zeros((len(run), 3))
            rise = rise_of(level, run.accelerometer)
            height[start:stop], maybe_low = heights_of(rise, still, start, stop, period)
        first, last = _clear_of_ground(period, start, stop, rests, height)
        if has_accelerometer:
            late = max(first, stop - round(DRIVEN_ON_S / period))
            hit = struck(rise, late, stop, SHAKEN * float(rise[first:late].max(initial=0.0)))
            last = last if hit is None else min(last, hit - round(BEFORE_IMPACT_S / period))
        if rests[1]:
            last, maybe_low = min(last, stop - maybe_low), 0
        if last > first:
            low = min(maybe_low, last - first)
            found.append(Air(start, stop, first, last, rests, height, low))
    return found


def _clear_of_ground(
    period: float, start: int, stop: int, rests: tuple[bool, bool], height: Array
) -> tuple[int, int]:
    """From where the ground carries nothing to where it begins to.

    What is low after the take-off may be a low hover; it ends no flight.
    """
    first, last = start, stop
    if not rests[0]:
        first += round(SETTLE_S / period)
    else:
        clear = np.flatnonzero(height[start:stop] > CLEAR_M)
        known = np.isfinite(height[start])
        if known and not len(clear):
            return start, start
        first += int(clear[0]) if len(clear) and known else round(TAKE_OFF_S / period)
    if rests[1]:
        clear = np.flatnonzero(height[first:stop] > LANDING_CLEAR_M)
        known = np.isfinite(height[stop - 1])
        last = first + int(clear[-1]) + 1 if len(clear) and known else stop
        if not known:
            last -= round(CONTACT_S / period)
    return first, last


# Channels whose rows are means of readings half a row before and half a row after.
#
# A radio's log sends them in another block than the gyro, and a row has one time for all. Such a
# mean has nothing at half the row rate: not the noise either, so a model that is not averaged
# alike is judged there and nowhere else.


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


# The attitude of a flight on the rows on which it was new, and what the gyro says beside it.


FIRMWARE_GAIN = 0.4
"""1/s: half of the firmware's twoKp, which acts on a vector product with half of gravity."""
ACCELEROMETER_SHARE, FIRMWARE_PERIOD_S = 0.125, 0.002
"""The fusion's own filter of the accelerometer: 32/256 each 2 ms."""
LEAST_ROWS = 100


class Gaps:
    """Rows that were not received, treated alike in data and model.

    Data between known rows lie on a straight line; ``spread`` and ``bridge`` do to a model's
    differences and values what that line does to the data's.
    """

    def __init__(self, lost: NDArray[np.bool_]) -> None:
        self.lost = lost if lost.any() else None
        if self.lost is not None:
            # A row starts a group unless the row before it was lost.
            self.starts = np.flatnonzero(~np.concatenate([[False], lost[:-1]]))
            self.counts = np.diff(np.concatenate([self.starts, [len(lost)]]))

    def spread(self, differences: Array) -> Array:
        """Differences over a gap, all replaced by their mean."""
        if self.lost is None:
            return differences
        sums = np.add.reduceat(differences, self.starts, axis=0)
        return np.repeat(sums / self.counts[:, None], self.counts, axis=0)

    def bridge(self, values: Array) -> Array:
        """Values within a gap, replaced by those on the line between its neighbours."""
        if self.lost is None:
            return values
        index = np.arange(len(values), dtype=np.float64)
        known = ~self.lost
        out = values.copy()
        for column in out.T:
            column[self.lost] = np.interp(index[self.lost], index[known], column[known])
        return out


@dataclass(frozen=True, slots=True)
class AttitudeRows:
    """Everything (m, 3) unless said otherwise, one row per new attitude after the first.

    stride: rows of the run between two of them; first: the run's row of the first. told: (m,)
    whether every row of the stride was received: over a gap the angles turn by what nobody knows of
    the gyro, and a jump of that would be a hundred times their own rounding. to_euler:
    (m, 3, 3) from body to Euler rates (thesis eq. 3.11). rate: measured Euler rates. gyro: mean
    of the gyro over the stride. timing: its last row less that mean. slope: its mean slope,
    rad/s^2. lean: the rate by which a Mahony filter would turn the estimate, over its
    gain, by the accelerometer behind the fusion's own filter; lean_as_read: by that as it reads,
    which today's firmware takes.

    between: rows hold means of angles that were read half a row before and half a row after, as
    those of a radio's log. ``timing`` and ``slope`` are then such means, too: otherwise what
    is faster than any of these angles is all that counts, for there they have no noise.
    """

    stride: int
    first: int
    told: NDArray[np.bool_]
    to_euler: Array
    rate: Array
    gyro: Array
    timing: Array
    slope: Array
    lean: Array
    lean_as_read: Array
    between: bool

    def euler_rates(self, rates: Array) -> Array:
        """Euler rates (m, 3) of rates in the body."""
        return np.einsum("nij,nj->ni", self.to_euler, rates)

    def where_told(self, rates: Array) -> Array:
        """Rates (m, ...) of data or model, nothing over a gap."""
        return np.where(self.told.reshape(-1, *(1,) * (rates.ndim - 1)), rates, 0.0)


def attitude_rows(run: Run, known: NDArray[np.bool_], first: int, last: int) -> AttitudeRows | None:
    """The rows between ``first`` and ``last`` of a run without gaps; None where there are few.

    known: (n,) rows that were received.
    """
    rows = _fresh(run, known, first, last)
    if len(rows) < LEAST_ROWS:
        return None
    stride = int(rows[1] - rows[0])
    index = np.arange(len(rows), dtype=np.float64)
    there = known[rows]
    angles = np.column_stack(
        [np.interp(index, index[there], run.attitude[rows[there], i]) for i in range(3)]
    )
    ends = rows[1:]
    seconds = stride * run.period_s
    told = np.ones(len(ends), np.bool_)
    mean = np.zeros((len(ends), 3))
    for back in range(stride + 1):
        mean += (0.5 if back in (0, stride) else 1.0) / stride * run.gyro[ends - back]
        told &= known[ends - back]
    now, rate = run.gyro[ends], np.diff(angles, axis=0) / seconds
    timing, slope = now - mean, (now - run.gyro[ends - stride]) / seconds
    between = stride == 1 and angles_read_between(rate, now)
    if between:
        half = half_a_row_later(run.gyro)
        late, early, earlier = half[ends], half[ends - 1], half[np.maximum(ends - 2, 0)]
        timing, slope = 0.5 * (late + early) - mean, (late - earlier) / (2.0 * seconds)
    return AttitudeRows(
        stride,
        int(ends[0]),
        told,
        _to_euler(0.5 * (angles[1:] + angles[:-1])),
        rate,
        mean,
        timing,
        slope,
        *_leans(run, known, angles[:-1], ends),
        between,
    )


def _fresh(run: Run, known: NDArray[np.bool_], first: int, last: int) -> NDArray[np.int64]:
    """Rows with a new attitude: an even comb, its stride and phase as most changes have them."""
    received = known[first:last]
    changed = changed_rows(run.attitude[first:last])
    changed[1:] &= received[1:] & received[:-1]
    if np.count_nonzero(changed) < LEAST_ROWS:
        return np.empty(0, np.int64)
    return first + rhythm_of(changed).rows(last - first)


def _leans(
    run: Run, known: NDArray[np.bool_], before: Array, ends: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Specific force x estimated up, both of unit length: by the smoothed force, and as it is."""
    if not np.isfinite(run.accelerometer).all():
        return np.zeros((len(ends), 3)), np.zeros((len(ends), 3))
    from groundstation.identification.likelihood.kernels import first_order

    force = _shaken_across(run.accelerometer, known)
    smooth = np.empty_like(force)
    keep = (1.0 - ACCELEROMETER_SHARE) ** (run.period_s / FIRMWARE_PERIOD_S)
    first_order(force, keep, smooth)
    up = np.column_stack(
        [
            -np.sin(before[:, 1]),
            np.cos(before[:, 1]) * np.sin(before[:, 0]),
            np.cos(before[:, 1]) * np.cos(before[:, 0]),
        ]
    )

    def lean(felt: Array) -> Array:
        length = np.linalg.norm(felt, axis=1, keepdims=True)
        return np.cross(felt / np.maximum(length, 1e-9), up)

    return lean(smooth[ends]), lean(force[ends])


def _shaken_across(values: Array, known: NDArray[np.bool_]) -> Array:
    """Rows (n, 3) with lost ones between the values two rows before and two rows after.

    Rotors shake the sensor at a frequency that folds near half the row rate: a straight line
    between neighbours has the other phase.
    """
    out = np.array(values, np.float64)
    for phase in (0, 1):
        rows = np.arange(phase, len(out), 2)
        lost, there = rows[~known[rows]], rows[known[rows]]
        if len(lost) and len(there):
            for column in out.T:
                column[lost] = np.interp(lost, there, column[there])
    return out


def _to_euler(attitude: Array) -> Array:
    roll, pitch = attitude[:, 0], attitude[:, 1]
    cr, sr, cp = np.cos(roll), np.sin(roll), np.cos(pitch)
    tp = np.tan(pitch)
    out = np.zeros((len(attitude), 3, 3))
    out[:, 0, 0] = 1.0
    out[:, 0, 1], out[:, 0, 2] = sr * tp, cr * tp
    out[:, 1, 1], out[:, 1, 2] = cr, -sr
    out[:, 2, 1], out[:, 2, 2] = sr / cp, cr / cp
    return out


# A flight made ready for the search: what is airborne, which rows are real, where it rested.


LEAST_AIR_S = 4.0
FOLLOW_S = 40.0
"""How slowly the attitude that the gyro carries follows the one reported."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One uninterrupted airborne stretch with everything around it.

    run: all rows, missing ones filled in. known: (n,) rows that were received. first, last: the
    airborne rows. attitude: on the rows on which it was new, within the stretch. height_m: (n,)
    above the take-off point where it can be told, otherwise infinite. whole: the airborne rows,
    from rest and to rest where the flight began or ended on the ground; rests says whether it
    did. rotor_measured: speeds of all rotors were recorded throughout. gaps: rows of the stretch
    that were lost. up: mean over ``whole`` of the vertical in sensor axes (3,) and of the specific
    force along it, None without accelerometer or attitude. carried: (n, 3) attitude that owes
    little to the accelerometer, None without attitude. force_between: rows of the accelerometer are
    means of readings half a row before and half a row after. orientation, carried_orientation:
    (4, n) quaternions of the reported attitude and of ``carried`` (or else of the reported one),
    and upward: (last - first, 3) the vertical in sensor axes; level without attitude. rotors:
    measured speeds, squared, None where they are not.
    """

    run: Run
    known: Mask
    first: int
    last: int
    attitude: AttitudeRows | None
    height_m: Array
    whole: slice
    rests: tuple[bool, bool]
    has_accelerometer: bool
    rotor_measured: bool
    gaps: Gaps
    up: tuple[Array, float] | None
    carried: Array | None
    force_between: bool
    orientation: Array = field(init=False)
    carried_orientation: Array = field(init=False)
    upward: Array = field(init=False)
    rotors: RotorSquares | None = field(init=False)

    def __post_init__(self) -> None:
        angles = np.zeros_like(self.run.gyro) if self.attitude is None else self.run.attitude
        reported = quaternion_rows(angles)
        carried = reported if self.carried is None else quaternion_rows(self.carried)
        object.__setattr__(self, "orientation", reported)
        object.__setattr__(self, "carried_orientation", carried)
        object.__setattr__(self, "upward", rotation_matrix(angles[self.rows])[:, 2])
        told = measured_squares(self.run) if self.rotor_measured else None
        object.__setattr__(self, "rotors", told)

    @property
    def period_s(self) -> float:
        return self.run.period_s

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)


def quaternion_rows(attitude: Array) -> Array:
    """Quaternions (4, n) of angles (n, 3) in rad."""
    return np.ascontiguousarray(quaternion_of_attitude(attitude).T)


def prepare(runs: Sequence[Run], least_s: float = LEAST_AIR_S) -> list[Flight]:
    """The airborne stretches of runs, at least ``least_s`` long each.

    Raises BadInputError where the gyro is missing or nothing is left.
    """
    found = [flight for run in runs for flight in _flights(run, least_s)]
    if not found:
        names = ", ".join(sorted({run.name for run in runs})) or "recordings"
        raise BadInputError(
            f"{names}: no {least_s:.0f} s of uninterrupted flight after take-off;"
            " fly and record longer"
        )
    return found


def _flights(raw: Run, least_s: float) -> list[Flight]:
    known: Mask = np.asarray(np.isfinite(raw.gyro).all(axis=1), np.bool_)
    if not known.any():
        raise BadInputError(
            f"{raw.name}: the gyro is missing; without body rates no effect can be told"
        )
    run = without_gaps(raw)
    measured = bool(np.isfinite(run.rotor_rev_s).all())
    for name in () if measured else ("duty", "supply_v"):
        if not np.isfinite(getattr(raw, name)).any():
            require_known(raw, (name,), "the motors need it")
    has_accelerometer = bool(np.isfinite(raw.accelerometer).any())
    has_attitude = bool(np.isfinite(raw.attitude).any())
    period, flights = run.period_s, []
    for air in flights_in(run):
        first, last, rests = air.first, air.last - air.maybe_low, air.rests
        if (last - first) * period < least_s:
            continue
        attitude = attitude_rows(run, known, first, last) if has_attitude else None
        settled = min(air.stop + round(TOUCH_DOWN_S / period), len(run))
        whole = slice(air.start if rests[0] else first, settled if rests[1] else last)
        flights.append(
            Flight(
                run,
                known,
                first,
                last,
                attitude,
                air.height_m,
                whole,
                rests,
                has_accelerometer,
                measured,
                Gaps(~known[first:last]),
                _mean_up(run, whole) if has_accelerometer and attitude is not None else None,
                None if attitude is None else _carried(run, attitude, air.start),
                is_force_between(run, attitude, first, last),
            )
        )
    return flights


def is_force_between(run: Run, attitude: AttitudeRows | None, first: int, last: int) -> bool:
    """Whether rows of the accelerometer are means of two readings. Only where the angles are: what
    shakes a craft can look like that."""
    there = attitude is not None and attitude.between
    return there and force_read_between(run.accelerometer[first:last])


def _mean_up(run: Run, rows: slice) -> tuple[Array, float]:
    up = rotation_matrix(run.attitude[rows])[:, 2]
    return up.mean(axis=0), float(np.einsum("ni,ni->n", up, run.accelerometer[rows]).mean())


def _carried(run: Run, rows: AttitudeRows, start: int) -> Array:
    """The attitude as the gyro carries it, less the gyro's bias.

    The bias is what the gyro shows at rest before row ``start``, or else beyond the mean rate by
    which the attitude turned.
    """
    from groundstation.identification.likelihood.kernels import carried_rotation

    if start * run.period_s > 1.0 + REST_S:
        bias = run.gyro[: start - round(REST_S / run.period_s)].mean(axis=0)
    else:
        turned = np.linalg.solve(rows.to_euler, rows.rate[..., None])[..., 0]
        bias = (rows.gyro - turned).mean(axis=0)
    reported = rotation_matrix(run.attitude)
    carried = np.empty_like(reported)
    gyro = np.ascontiguousarray(run.gyro - bias)
    carried_rotation(reported, gyro, run.period_s, FOLLOW_S, carried)
    return attitude_of_matrix(carried)


# Body velocity, which no sensor measures, from specific force and attitude: a leaky integral.


LEAK_S, LEANING_LEAK_S = 16.0, 4.0
"""Velocity is known over times shorter than this, with an attitude that is right; with one that
leans towards the accelerometer, as on-board estimates do, or is carried by the gyro instead."""


def velocity_in(
    flight: Flight, attitude: Array, orientation: Array, force: Array, leak_s: float
) -> Array:
    """Velocity (n, 3) m/s in a flight: from rest where it began on the ground, or else with what
    its first seconds tell. orientation: (4, n), the quaternions of ``attitude`` (n, 3)."""
    moving = slice(0) if flight.rests[0] else flight.rows
    start = start_velocity(attitude[moving], force[moving], flight.period_s)
    return _velocity(orientation, force, flight.period_s, leak_s, flight.whole.start, start)


def velocity_of(run: Run, leak_s: float = LEANING_LEAK_S) -> Array:
    """Velocity (n, 3) m/s of a run as recorded; zero without accelerometer or attitude."""
    attitude, force = run.attitude, run.accelerometer
    if not (np.isfinite(force).all() and np.isfinite(attitude).all()):
        return np.zeros((len(run), 3))
    flights = flights_in(run)
    moving = slice(flights[0].stop if flights and flights[0].start == 0 else 0)
    start = start_velocity(attitude[moving], force[moving], run.period_s)
    return _velocity(quaternion_rows(attitude), force, run.period_s, leak_s, 0, start)


def _velocity(
    orientation: Array, force: Array, period_s: float, leak_s: float, first: int, start: Array
) -> Array:
    """Velocity (n, 3) in m/s, forward, left, up, from quaternions (4, n) and specific force (n, 3).

    At each row what the rows before tell, from row ``first`` on. start: inertial velocity (3,)
    there (``prediction/start_velocity.py``). Steady speed, and what an offset of the sensors would
    add, are forgotten (two leaks of time constant ``leak_s``).
    """
    from groundstation.identification.likelihood.kernels import body_velocity

    force = np.ascontiguousarray(force, np.float64)
    velocity = np.zeros_like(force)
    body_velocity(orientation, force, STANDARD_GRAVITY, period_s, leak_s, first, start, velocity)
    return velocity


# The noise of recorded rotor speeds beside their motion.


NOISE_FROM = 0.6
"""Share of half the rate of fresh readings from which a motor does nothing that is seen: what is
left there is noise, if that is beyond ``NO_MOTOR_HZ``."""
NO_MOTOR_HZ = 60.0
"""A motor of 30 ms shows a hundredth of the power that it is given there."""


@dataclass(frozen=True, slots=True)
class SpeedSpectrum:
    """Of a flight's recorded speeds, all rotors together.

    hz, power: (m,), the power up to a factor. noise: of the sensor, in each bin, None where its
    readings are so rare that it cannot be told from motion.
    """

    hz: Array
    power: Array
    noise: float | None


def speed_spectrum(flight: Flight) -> SpeedSpectrum:
    """The noise is read near half the rate of fresh readings; readings that were joined by straight
    lines hide it."""
    speeds = flight.run.rotor_rev_s[flight.rows]
    fresh = float(np.mean(np.diff(speeds, axis=0) != 0.0))
    top = fresh * 0.5 / flight.period_s
    hz = np.asarray(np.fft.rfftfreq(len(speeds), flight.period_s), np.float64)
    window = np.hanning(len(speeds))[:, None]
    power = np.abs(np.fft.rfft((speeds - speeds.mean(axis=0)) * window, axis=0)) ** 2
    noise = None
    if NOISE_FROM * top >= NO_MOTOR_HZ:
        floor = (hz > NOISE_FROM * top) & (hz < top)
        noise = float(np.median(power[floor], axis=0).sum() / np.log(2.0))
    return SpeedSpectrum(hz, power.sum(axis=1), noise)
