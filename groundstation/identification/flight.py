"""Parts of runs: what is airborne, which rows are real, what is fitted and what is held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import (
    attitude_of_matrix,
    quaternion_of_attitude,
    rotation_matrix,
)
from groundstation.dynamics.simulation import each_motor
from groundstation.dynamics.vehicle import MIXERS, MotorConstants, Motors
from groundstation.errors import BadInputError
from groundstation.identification.runs import (
    EVERYTHING,
    RotorSquares,
    Run,
    Selection,
    measured_squares,
    require_known,
    rotor_squares,
    selected,
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

# A flight begins where its motors begin to turn and ends where they stop, or where the recording
# does. In between it is airborne from where the ground carries nothing to where it begins to: by
# height, where a rest on the ground tells it (``heights_of``), otherwise by time.


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
BESIDE_S = 5.0
"""Rows of a recording that are looked at before and behind a flight: of its rest, for the gyro's
bias; of several hops, each would else be reckoned over all of them."""


@dataclass(frozen=True, slots=True)
class Air:
    """One flight within a run.

    start, stop: rows in which the motors turn. first, last: of these, the airborne ones. rests:
    whether it began and ended on the ground within the run. height_m: (n,) above the take-off
    point where it can be told, otherwise infinite. maybe_low: rows before ``last`` in which it may
    have landed where the recording breaks off.
    """

    start: int
    stop: int
    first: int
    last: int
    rests: tuple[bool, bool]
    height_m: Array
    maybe_low: int

    def within(self, rows: slice) -> Air:
        """The same of these rows of the run alone."""
        start, stop, first, last = (
            one - rows.start for one in (self.start, self.stop, self.first, self.last)
        )
        return replace(
            self, start=start, stop=stop, first=first, last=last, height_m=self.height_m[rows]
        )


def turning(run: Run) -> Mask:
    """Rows (n,) in which all motors turn: by what drives them, or by their speed without that."""
    if np.isfinite(run.duty).any():
        return np.asarray((run.duty > TURNING).all(axis=1))
    return np.asarray((run.rotor_rev_s > TURNING_REV_S).all(axis=1))


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
the gyro's: of means up to 0.02 and 0.05, of others from 0.3 and 0.5 on."""
SEGMENT_ROWS = 256
"""Of the power's segments, scipy's own; it warns on the terminal where rows are fewer."""
FORCE = 0.02
"""The same of the accelerometer, on each axis: of means 0.005, of others from 0.07 on."""


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


def attitude_rows(run: Run, known: Mask, first: int, last: int) -> AttitudeRows | None:
    """The rows between ``first`` and ``last`` of a run without gaps; None where there are few.

    known: (n,) rows that were received.
    """
    # Rows with a new attitude: an even comb, its stride and phase as most changes have them.
    received = known[first:last]
    changed = changed_rows(run.attitude[first:last])
    changed[1:] &= received[1:] & received[:-1]
    if np.count_nonzero(changed) < LEAST_ROWS:
        return None
    rows = first + rhythm_of(changed).rows(last - first)
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
    lean, lean_as_read = _leans(run, known, angles[:-1], ends)
    return AttitudeRows(
        stride=stride,
        first=int(ends[0]),
        told=told,
        to_euler=_to_euler(0.5 * (angles[1:] + angles[:-1])),
        rate=rate,
        gyro=mean,
        timing=timing,
        slope=slope,
        lean=lean,
        lean_as_read=lean_as_read,
        between=between,
    )


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

    Rotors shake the sensor near half the row rate, where neighbours have the other phase.
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


LEAST_AIR_S = 4.0
FOLLOW_S = 40.0
"""How slowly the attitude that the gyro carries follows the one reported."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One uninterrupted airborne stretch with everything around it.

    run: its rows and some beside them, missing ones filled in. known: (n,) rows that were received.
    first, last: the airborne rows. attitude: on the rows on which it was new, within the stretch.
    height_m: (n,) above the take-off point where it can be told, otherwise infinite. whole: the
    airborne rows, from rest and to rest where the flight began or ended on the ground; rests says
    whether it did. rotor_measured: speeds of all rotors were recorded throughout. gaps: rows of the
    stretch that were lost. up: mean over ``whole`` of the vertical in sensor axes (3,) and of the
    specific force along it, None without accelerometer or attitude. carried: (n, 3) attitude that
    owes little to the accelerometer, None without attitude. force_between: rows of the
    accelerometer are means of readings half a row before and half a row after. orientation,
    carried_orientation: (4, n) quaternions of the reported attitude and of ``carried`` (or else of
    the reported one), and upward: (last - first, 3) the vertical in sensor axes; level without
    attitude. rotors: measured speeds, squared, None where they are not.
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
    up: tuple[Array, float] | None
    carried: Array | None
    gaps: Gaps = field(init=False)
    force_between: bool = field(init=False)
    orientation: Array = field(init=False)
    carried_orientation: Array = field(init=False)
    upward: Array = field(init=False)
    rotors: RotorSquares | None = field(init=False)

    def __post_init__(self) -> None:
        angles = np.zeros_like(self.run.gyro) if self.attitude is None else self.run.attitude
        reported = quaternion_rows(angles)
        carried = reported if self.carried is None else quaternion_rows(self.carried)
        # Only where the angles are: what shakes a craft can look like that.
        between = self.attitude is not None and self.attitude.between
        made = {
            "gaps": Gaps(~self.known[self.rows]),
            "force_between": between and force_read_between(self.run.accelerometer[self.rows]),
            "orientation": reported,
            "carried_orientation": carried,
            "upward": rotation_matrix(angles[self.rows])[:, 2],
            "rotors": measured_squares(self.run) if self.rotor_measured else None,
        }
        for name, one in made.items():
            object.__setattr__(self, name, one)

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
    received: Mask = np.asarray(np.isfinite(raw.gyro).all(axis=1), np.bool_)
    if not received.any():
        raise BadInputError(
            f"{raw.name}: the gyro is missing; without body rates no effect can be told"
        )
    filled = without_gaps(raw)
    measured = bool(np.isfinite(filled.rotor_rev_s).all())
    for name in () if measured else ("duty", "supply_v"):
        if not np.isfinite(getattr(raw, name)).any():
            require_known(raw, (name,), "the motors need it")
    has_accelerometer = bool(np.isfinite(raw.accelerometer).any())
    has_attitude = bool(np.isfinite(raw.attitude).any())
    period, flights = filled.period_s, []
    beside = round(BESIDE_S / period)
    for found in flights_in(filled):
        rows = slice(max(found.start - beside, 0), min(found.stop + beside, len(filled)))
        run, known, air = filled[rows], received[rows], found.within(rows)
        first, last, rests = air.first, air.last - air.maybe_low, air.rests
        if (last - first) * period < least_s:
            continue
        attitude = attitude_rows(run, known, first, last) if has_attitude else None
        settled = min(air.stop + round(TOUCH_DOWN_S / period), len(run))
        whole = slice(air.start if rests[0] else first, settled if rests[1] else last)
        mean_up = None
        if has_accelerometer and attitude is not None:
            up = rotation_matrix(run.attitude[whole])[:, 2]
            along = np.einsum("ni,ni->n", up, run.accelerometer[whole])
            mean_up = up.mean(axis=0), float(along.mean())
        flights.append(
            Flight(
                run,
                known,
                first,
                last,
                attitude=attitude,
                height_m=air.height_m,
                whole=whole,
                rests=rests,
                has_accelerometer=has_accelerometer,
                rotor_measured=measured,
                up=mean_up,
                carried=None if attitude is None else _carried(run, attitude, air.start),
            )
        )
    return flights


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
    there (``start_velocity``). Steady speed, and what an offset of the sensors would
    add, are forgotten (two leaks of time constant ``leak_s``).
    """
    from groundstation.identification.likelihood.kernels import body_velocity

    force = np.ascontiguousarray(force, np.float64)
    velocity = np.zeros_like(force)
    body_velocity(orientation, force, STANDARD_GRAVITY, period_s, leak_s, first, start, velocity)
    return velocity


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


LEAST_S, PIECE_S = 4.0, 1.0
"""Shortest sum of stretches, and shortest stretch, worth identifying on."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Consecutive airborne rows of a run, with the rotors behind them.

    first: its first row in ``run``. squares, run: of the whole run, so that interpolation and
    motor speeds know what came before. motor: the constants the rotors were simulated with, None
    where their speeds were measured.
    """

    run: Run
    squares: RotorSquares
    first: int
    last: int
    motor: MotorConstants | Motors | None = None

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)

    def __len__(self) -> int:
        return self.last - self.first


def stretches_of(
    runs: Sequence[Run],
    motor: MotorConstants | Motors,
    measured: bool = False,
    selection: Selection = EVERYTHING,
) -> list[Stretch]:
    """The airborne parts of runs, or what a selection chooses of them: pieces of 1 s and more.

    Motors are simulated over whole runs. measured: recorded rotor speeds instead.

    Raises BadInputError where less than 4 s are left, or where the gyro is missing.
    """
    found: list[Stretch] = []
    parts: list[Run] = []
    if measured:  # the parts in which every rotor's speed was; as they are where none was
        for run in runs:
            told = np.asarray(np.isfinite(run.rotor_rev_s).all(axis=1))
            parts += run.parts(told, PIECE_S)
    for run in parts or runs:
        require_known(run, ("gyro",), "without body rates nothing can be fitted")
        squares = measured_squares(run) if measured else rotor_squares(run, motor)
        chosen = airborne(run) & selected(run, selection)
        for first, last in spans(chosen):
            if (last - first) * run.period_s >= PIECE_S:
                found.append(Stretch(run, squares, first, last, None if measured else motor))
    seconds = sum(len(one) * one.run.period_s for one in found)
    if seconds < LEAST_S:
        names = ", ".join(sorted({run.name for run in runs}))
        wanted = "" if selection == EVERYTHING else f" that is {selection}"
        raise BadInputError(
            f"{names}: {seconds:.1f} s of uninterrupted flight after take-off{wanted}, at least"
            f" {LEAST_S:.0f} s are needed; record longer"
            + (" or choose more of it" if wanted else "")
        )
    return found


def quicker(motor: MotorConstants, factor: float) -> MotorConstants:
    """A motor that reaches the same speeds so much faster."""
    return MotorConstants(motor.a0 * factor, motor.a1 * factor, motor.a2 * factor)


def paced(stretch: Stretch, factor: float) -> Stretch:
    """The stretch with motors that reach the same speeds so much faster."""
    if stretch.motor is None or factor == 1.0:
        return stretch
    m1, m2, m3, m4 = (quicker(one, factor) for one in each_motor(stretch.motor))
    motors = (m1, m2, m3, m4)
    return replace(stretch, motor=motors, squares=rotor_squares(stretch.run, motors))


# Which rows are fitted and which are held out, where nobody names recordings for it.
#
# The last third. Where that third has, or leaves the fit, hardly any of the excitation of an
# axis, the first or the middle one; and where axes are flown one after the other, so that every
# third is needed by the fit, the last third of each third.


Span = tuple[int, int]

LAST, IN_PIECES = "last third", "last third of each third"
HELD: dict[str, tuple[tuple[float, float], ...]] = {
    LAST: ((2 / 3, 1.0),),
    "first third": ((0.0, 1 / 3),),
    "middle third": ((1 / 3, 2 / 3),),
    IN_PIECES: ((2 / 9, 3 / 9), (5 / 9, 6 / 9), (8 / 9, 1.0)),
}
"""Shares of the rows that are held out, of each recording or of all of them in a row."""
SERVES = 0.3
"""Least share of its fair part of the excitation that either side of a division must have."""


def best_way(recordings: Sequence[Array], least_rows: float) -> str:
    """Which of ``HELD``, by the ``excitation`` (n, 4) of each recording's rows.

    The last third where it serves, otherwise the third that divides best; pieces only where no
    third serves and each has ``least_rows``, for each begins without knowing what came before.
    """
    fair = {way: _fairness(recordings, way) for way in HELD}
    if fair[LAST] >= SERVES:
        return LAST
    best = max((way for way in HELD if way != IN_PIECES), key=lambda way: fair[way])
    long = min(len(rows) for rows in recordings) / 9 >= least_rows
    return IN_PIECES if long and fair[best] < min(SERVES, fair[IN_PIECES]) else best


def cut(way: str, lengths: Sequence[int]) -> list[tuple[list[Span], list[Span]]]:
    """(fitted, held out) rows of each part of so many rows, cut as if they were one."""
    rows, begin, found = sum(lengths), 0, []
    edges = [(round(rows * first), round(rows * last)) for first, last in HELD[way]]
    for length in lengths:
        fitted, held, at = [], [], 0
        for edge in edges:
            a, b = (min(max(one - begin, 0), length) for one in edge)
            if a > at:
                fitted.append((at, a))
            if b > a:
                held.append((a, b))
            at = max(at, b)
        if at < length:
            fitted.append((at, length))
        begin += length
        found.append((fitted, held))
    return found


def hold_out(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """(to fit on, to validate on): the last third of all rows, cutting a run where needed."""
    fit_on: list[Run] = []
    held_out: list[Run] = []
    for run, (fitted, held) in zip(runs, cut(LAST, [len(run) for run in runs]), strict=True):
        fit_on += [run[a:b] for a, b in fitted]
        held_out += [run[a:b] for a, b in held]
    return fit_on, held_out


def divided(
    stretches: Sequence[Stretch], configuration: str, least_s: float = LEAST_S
) -> tuple[list[Stretch], list[Stretch], str]:
    """(to fit on, to validate on, which rows of all of them these are in words).

    Of several recordings the last ones are held out, so that the fit has whole flights. least_s:
    shortest piece that says anything.
    """
    moved = np.vstack([excitation(one.run, configuration)[one.rows] for one in stretches])
    way = best_way([moved], least_s / stretches[0].run.period_s)
    fit_on: list[Stretch] = []
    held_out: list[Stretch] = []
    lengths = [len(one) for one in stretches]
    for one, (fitted, held) in zip(stretches, cut(way, lengths), strict=True):
        for found, cuts in ((fit_on, fitted), (held_out, held)):
            found += [replace(one, first=one.first + a, last=one.first + b) for a, b in cuts]
    return fit_on, held_out, way


def excitation(run: Run, configuration: str) -> Array:
    """What moves the craft about roll, pitch and yaw, and lifts it (n, 4), row by row: squares of
    duties, of rotor speeds where no duty is recorded."""
    driven = run.duty if np.isfinite(run.duty).any() else run.rotor_rev_s
    squares = without_gaps(replace(run, duty=driven)).duty ** 2
    return np.column_stack([squares @ MIXERS[configuration].T, squares.sum(axis=1)])


def _fairness(recordings: Sequence[Array], way: str) -> float:
    """The least share of its fair part that fitted or held-out rows have of the energy of roll,
    pitch, yaw or thrust."""
    fitted, held = np.zeros(4), np.zeros(4)
    for moved in recordings:
        energy = (moved - moved.mean(axis=0)) ** 2
        ((_, spans),) = cut(way, [len(moved)])
        here = sum((energy[a:b].sum(axis=0) for a, b in spans), np.zeros(4))
        fitted, held = fitted + energy.sum(axis=0) - here, held + here
    every = np.maximum(fitted + held, 1e-300)
    return float(np.minimum(1.5 * fitted / every, 3.0 * held / every).min())
