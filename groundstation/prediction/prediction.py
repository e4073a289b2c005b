"""What a model expects: a few rows ahead of what was measured, or flown along a reference."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.craft import SENSOR_STATES, acting, craft_of_model
from groundstation.dynamics.model import Model
from groundstation.dynamics.rotations import body_rates, quaternion_of_attitude, rotation_matrix
from groundstation.dynamics.sensors import FILTER, resting_sensors, shown_rotors
from groundstation.dynamics.simulation import (
    QUATERNION,
    RATE,
    ROTOR,
    STATES,
    attitude_of,
    craft_state,
    duties_for,
    hover_rev_s,
    simulate,
    with_states,
)
from groundstation.errors import BadInputError
from groundstation.prediction.drive import (
    Drive,
    Flown,
    drive_run,
    flying_rows,
    fresh_rows,
    height_of,
    reckoned_height,
)
from groundstation.prediction.observer import Gains, Noise, gains_of
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S, STANDARD_GRAVITY
from groundstation.telemetry.samples import filled

# How fast a craft is where a recording begins in the air.
#
# No sensor measures velocity, and its integral needs a beginning. On the ground that is rest. A
# craft that is recorded from somewhere in its flight on has any velocity, but it stays about where
# it is: over some seconds its velocity is zero on average, to its travel in that time.


LEVEL_S, LEAST_S = 8.0, 2.0
"""Over so much of a flight the mean is taken: a craft that travels 2 m in it is judged 0.25 m/s
off, as it is by an accelerometer's offset of 6 mg. Of a shorter flight nothing is said."""


def start_velocity(attitude: Array, accelerometer: Array, period_s: float) -> Array:
    """Inertial velocity (3,) in m/s at the first row of a flight, forward, left, up.

    attitude: (n, 3) rad, accelerometer: (n, 3) m/s^2, both FLU and of the flight alone; rows that
    lack either are bridged. 0 where either is unknown throughout, or the flight is short.
    """
    if len(attitude) * period_s < LEAST_S:
        return np.zeros(3)
    rows = round(LEVEL_S / period_s)
    angles, force = filled(attitude[:rows]), filled(accelerometer[:rows])
    if not (np.isfinite(angles).all() and np.isfinite(force).all()):
        return np.zeros(3)
    acceleration = np.einsum("nij,nj->ni", rotation_matrix(angles), force)
    acceleration[:, 2] -= STANDARD_GRAVITY
    gained = np.cumsum(acceleration, axis=0) * period_s
    return -gained.mean(axis=0)


# How far the reported angles wander off the gyro's integral.
#
# An estimator that knows positions (motion capture, a deck) corrects its angles by them: these
# then turn, over tenths of a second, as no rate does, and what follows the gyro alone is left
# behind. The size is read off a flight without a model: a filter that turns by the gyro and is
# corrected by the angles is tried for several walks.


Mask = NDArray[np.bool_]
Walk = tuple[float, float, float]

NONE: Walk = (0.0, 0.0, 0.0)
WALKS = (0.0, *(2.5e-4 * 2**k for k in range(9)))
"""rad in a second; from what adds to a gyro's own noise in still air to one at which nothing but
the newest angles counts."""
AHEAD_S = 0.02
WORTH = 0.9
"""A walk counts where the squared error ``AHEAD_S`` ahead falls below this share: it is no constant
that has to be known to a per cent."""
LEAST_ROWS = 200
LONGEST = 3
"""New angles so many times their usual distance apart: over a longer gap nobody knows the turn."""


def walk_of(
    attitude: Array, gyro: Array, used: Mask, period_s: float, *, angle: float, rate: float
) -> Walk:
    """About the body's axes, rad in a second (its square root for other times).

    attitude: (n, 3) rad, NaN where it is not new; gyro: (n, 3) rad/s. used: (n,) rows in the air.
    angle (rad) and rate (rad/s): white noise of a sample of either. A constant difference of rates
    is no walk: that is the gyro's bias.
    """
    rows = np.flatnonzero(used & np.isfinite(attitude).all(axis=1))
    if len(rows) < LEAST_ROWS:
        return NONE
    spacing = np.diff(rows)
    every = int(np.median(spacing))
    off = _off(attitude[rows], gyro, rows, period_s)
    told = np.isfinite(off).all(axis=1) & (spacing <= LONGEST * every)
    ahead = max(round(AHEAD_S / (every * period_s)), 1)
    judged = told[ahead:]
    if np.count_nonzero(judged) < LEAST_ROWS:
        return NONE
    places = np.cumsum(np.where(told[:, None], off - off[told].mean(axis=0), 0.0), axis=0)
    seconds = every * period_s
    own = rate**2 * period_s * seconds
    ratios = [(own + walk**2 * seconds) / angle**2 for walk in WALKS]
    errors = np.array([_squared_error(places, ratio, ahead, judged) for ratio in ratios])
    worth = errors.min(axis=0) < WORTH * errors[0]
    x, y, z = np.where(worth, np.array(WALKS)[errors.argmin(axis=0)], 0.0).tolist()
    return x, y, z


def _off(angles: Array, gyro: Array, rows: NDArray[np.int64], period_s: float) -> Array:
    """What the angles (m + 1, 3) turned from each of ``rows`` to the next less what the gyro did,
    (m, 3) rad about the body's axes."""
    turned = np.angle(np.exp(1j * np.diff(angles, axis=0)))
    rates = filled(gyro)
    steps = 0.5 * (rates[1:] + rates[:-1]) * period_s
    whole = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return body_rates(angles[:-1] + 0.5 * turned, turned) - np.diff(whole[rows], axis=0)


def _squared_error(places: Array, ratio: float, ahead: int, judged: Mask) -> Array:
    """Mean squared error (3,) of a Kalman filter's estimate of places (m, 3) some rows ahead.

    ratio: of the variances per row of their random walk and of a measurement.
    """
    from scipy.signal import lfilter

    gain = 0.5 * (math.sqrt(ratio**2 + 4.0 * ratio) - ratio)
    followed = lfilter([gain], [1.0, gain - 1.0], places, axis=0)
    error = places[ahead:] - followed[:-ahead]
    return (error[judged] ** 2).mean(axis=0)


# How much the rotors shake the gyro, which is noise to any model of rigid flight.
#
# Motors settle within 30 to 90 ms, so torque does next to nothing above 50 Hz, and what a gyro
# shows there is vibration: 0.2 to 1.3 deg/s on real crafts, where the sensor's own noise is 0.1.
# An observer that takes it for motion spoils every prediction from there. Read off a flight
# without a model.


FROM_HZ = 50.0
ORDER = 4
BLOCK_S = 1.0
"""The median over blocks counts: a landing shakes for a moment."""
LEAST_BLOCKS = 3


def vibration_of(gyro: Array, used: Mask, period_s: float) -> tuple[float, float, float]:
    """RMS about the body's axes above ``FROM_HZ``, rad/s.

    gyro: (n, 3) rad/s, rows that were lost NaN. used: (n,) rows in the air. 0 where rows are too
    slow to show it, or fewer than three blocks are in the air.
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


# What a model expects a few rows ahead, from all that was measured until then.
#
# The craft is unstable, so a model is judged over short horizons: an observer keeps the state
# (``observer``), and from any row the model flies on the recorded inputs alone. Every effect of
# the model acts, in the observer and in the prediction. Arrays in, arrays out; rows of the past
# never see those of the future, so a live stream can be fed in pieces.


Rows = NDArray[np.int64]


JUDGED = 4
"""One row in so many tells which of two observers suits a run."""
RATES, ANGLES = slice(0, 3), slice(6, 9)
"""Of the nine channels."""
SETTLE_S, LIFT_OFF_S = 0.5, 0.1
"""From a take-off on the state is known; where a run begins in the air it takes the first."""


@dataclass(frozen=True, slots=True)
class Observed:
    """The state behind every row of a run.

    states: (n, 17) and those of effects; sensed: (n, m) what the sensors' effects remember;
    filters: (n, 10) of the on-board filter.
    innovations: (n, 9) one-row prediction errors of gyro, accelerometer and attitude (as a
    rotation), 0 where nothing new was measured. flying: (n,) in the air by the model's thrust.
    fresh: (n,) rows with a new attitude.
    """

    drive: Drive
    gains: Gains
    states: Array
    sensed: Array
    filters: Array
    innovations: Array
    flying: Mask
    fresh: Mask


@dataclass(frozen=True, slots=True)
class Ahead:
    """Predictions, from each of ``rows`` (m,) for every horizon (g,).

    gyro (m, g, 3) rad/s, accelerometer (m, g, 3) m/s^2, attitude (m, g, 3) rad, as the telemetry
    would report them at ``rows + horizon``. states: (m, 17 + those of effects) of the craft at
    the last horizon.
    """

    rows: Rows
    horizons: Rows
    gyro: Array
    accelerometer: Array
    attitude: Array
    states: Array

    def errors(self, run: Flown) -> Array:
        """Measured less predicted, (m, g, 9): gyro, accelerometer, roll pitch yaw (wrapped)."""
        at = self.rows[:, None] + self.horizons
        rates, force = run.gyro[at] - self.gyro, run.accelerometer[at] - self.accelerometer
        turn = np.angle(np.exp(1j * (run.attitude[at] - self.attitude)))
        return np.concatenate([rates, force, turn], axis=2)


def predict_ahead(
    model: Model,
    run: Flown,
    horizons: ArrayLike = (10, 25),
    *,
    stride: int = 2,
    height_m: Array | None = None,
    noise: Noise | None = None,
) -> Ahead:
    """Predict a run ``horizons`` rows ahead, from every ``stride``-th row that is in the air.

    A row counts from ``SETTLE_S`` after the take-off (or after the run's start) on, if the craft
    is still in the air at the longest horizon. A run that begins in the air begins with the
    velocity that its first seconds tell (``start_velocity``). height_m: (n,) above ground, for
    ground_effect; by default as ``reckoned_height`` has it. noise: sets the observer's gains.

    Raises BadInputError where PWM, battery voltage or gyro are missing.
    """
    seen = observe_run(model, run, height_m=height_m, noise=noise)
    return predict_observed(run, seen, horizons, stride=stride)


def predict_observed(run: Flown, seen: Observed, horizons: ArrayLike, *, stride: int = 1) -> Ahead:
    """The same of a run that has been observed."""
    steps = np.unique(np.atleast_1d(np.asarray(horizons, np.int64)))
    return fly_ahead(run, seen, airborne(seen, int(steps[-1]))[::stride], steps)


def noise_of(model: Model, run: Flown) -> Noise:
    """The noise of a craft in flight, for gains that suit it (vibration, rough air).

    Steps of the gyro less what the torques explain: white sensor noise r and torque noise q give
    them a variance q + 2 r and a covariance of -r from one row to the next. A model that is wrong
    counts as torque noise. The whole run is used: for a live stream, take an earlier flight's.

    Raises BadInputError where less than a second is in the air.
    """
    drive = drive_run(model, run)
    steps = np.diff(run.gyro, axis=0) - run.period_s * drive.push[1::2, 2:]
    flying = flying_rows(run, drive, reckoned_height(run))
    used = flying[1:] & np.asarray(np.isfinite(steps).all(axis=1))
    if used.sum() * run.period_s < 1.0:
        raise BadInputError("less than a second in the air: the noise cannot be judged from it")
    steps = np.where(used[:, None], steps - steps[used].mean(axis=0), 0.0)
    variance = np.sum(steps**2, axis=0) / used.sum()
    pairs = (used[1:] & used[:-1]).sum()
    sensor = np.clip(-np.sum(steps[1:] * steps[:-1], axis=0) / pairs, 0.02 * variance, variance / 2)
    push = np.sqrt(np.maximum(variance - 2.0 * sensor, 0.02 * variance)) / run.period_s
    shaken = np.sqrt(sensor)  # yaw by far less than roll and pitch
    usual = Noise()
    felt = run.accelerometer[flying][:, :2]
    felt = felt[np.isfinite(felt).all(axis=1)]
    torque, gyro = ((x, y, z) for x, y, z in (push.tolist(), shaken.tolist()))
    accelerometer = float(felt.std()) if len(felt) else usual.accelerometer
    return replace(usual, torque=torque, gyro=gyro, accelerometer=accelerometer)


def own_noise(run: Flown, flying: Mask) -> Noise:
    """The usual noise with what a run tells of its own without a model: how its gyro is shaken, and
    how far its reported angles, NaN where they are not new, wander. flying: (n,) rows in the air.
    """
    usual = Noise()
    noises = {"angle": usual.attitude, "rate": max(usual.gyro)}
    walk = walk_of(run.attitude, run.gyro, flying, run.period_s, **noises)
    shaken = vibration_of(run.gyro, flying, run.period_s)
    x, y, z = map(max, usual.gyro, shaken)
    return replace(usual, gyro=(x, y, z), walk=walk)


def observe_as_it_is(model: Model, run: Flown, noise: Noise) -> tuple[Observed, Noise]:
    """As ``observe_run``, with what of a run's ``own_noise`` predicts it better, and that noise: a
    gyro may seem shaken by rough torque, and the model's sensors may explain angles that wander."""
    observed = _observer(model, run)
    steady, chosen = observed(None), Noise()
    if noise.gyro != chosen.gyro:
        other = replace(chosen, gyro=noise.gyro)
        shaken = observed(other)
        if _error(run, shaken, RATES) < _error(run, steady, RATES):
            steady, chosen = shaken, other
    leans = steady.drive.sensor[0]["gains"][0] > 0.0  # the model says how far they are off
    if leans or not any(noise.walk):
        return steady, chosen
    wandering = replace(chosen, walk=noise.walk)
    walking = observed(wandering)
    if _error(run, walking, ANGLES) < _error(run, steady, ANGLES):
        return walking, wandering
    return steady, chosen


def _error(run: Flown, seen: Observed, channels: slice) -> float:
    """Mean squared error of rates or angles ``AHEAD_S`` ahead, without end where none is known."""
    told = seen.fresh if channels == ANGLES else np.ones_like(seen.fresh)
    new = np.flatnonzero(told)
    every = int(np.median(np.diff(new))) if len(new) > 1 else 1
    steps = every * max(round(AHEAD_S / (every * run.period_s)), 1)
    rows = airborne(seen, steps)
    rows = rows[told[rows] & told[rows + steps]][::JUDGED]
    made = fly_ahead(run, seen, rows, [steps]).errors(run)[:, 0, channels]
    known = made[np.isfinite(made).all(axis=1)]
    with np.errstate(over="ignore"):  # of a model that grows without end
        return float(np.square(known).mean()) if len(known) else math.inf


def observe_run(
    model: Model, run: Flown, *, height_m: Array | None = None, noise: Noise | None = None
) -> Observed:
    """The state behind every row, from measurements up to that row.

    Raises BadInputError where PWM, battery voltage or the whole gyro are missing.
    """
    return _observer(model, run, height_m)(noise)


def _observer(
    model: Model, run: Flown, height_m: Array | None = None
) -> Callable[[Noise | None], Observed]:
    """The same for one noise after another: what all share is made once."""
    if not np.isfinite(run.gyro).any():
        raise BadInputError("the gyro is missing; the craft's state cannot be followed without it")
    drive = drive_run(model, run)
    reckoned = reckoned_height(run)
    flying = flying_rows(run, drive, reckoned)
    fresh = fresh_rows(run.attitude)
    if height_m is None:
        near = any("height" in effect.unmeasured for effect, _ in acting(model))
        height_m = height_of(reckoned, flying) if near else np.full(len(run.duty), np.nan)
    # The velocity with which a run begins, by the sensors as the model has them.
    moving = slice(len(flying) if flying.all() else int(np.argmin(flying)))
    force = run.accelerometer[moving] - drive.sensor[0]["zero"][3:]
    start = start_velocity(run.attitude[moving], force, run.period_s)

    def observed(noise: Noise | None) -> Observed:
        gains = gains_of(model, run.period_s, noise)
        return observe_part(run, drive, gains, flying, fresh, height_m=height_m, start=start)[0]

    return observed


def observe_part(
    run: Flown,
    drive: Drive,
    gains: Gains,
    flying: Mask,
    fresh: Mask,
    *,
    height_m: Array,
    start: Array | None = None,
    carry: Array | None = None,
) -> tuple[Observed, Array]:
    """(state behind every row of ``flying`` (m,), what the next part goes on from).

    Those are the first m rows of the run; drive and fresh may reach further, for predictions.
    start: (3,) inertial velocity where it begins in the air, None: 0.
    carry: from the part before, whose last row is the first of this one; None: a beginning.
    """
    from groundstation.prediction.kernels import observe

    n, size = len(flying), STATES + int(drive.craft[0]["body_states"])
    states, sensed = np.empty((n, size)), np.empty((n, SENSOR_STATES))
    filters, innovations = np.empty((n, FILTER)), np.zeros((n, 9))
    kept = np.zeros(4 + size + SENSOR_STATES + FILTER) if carry is None else carry.copy()
    driven = drive.craft[0], drive.sensor[0], drive.speed, drive.period_s
    channels = run.gyro, run.accelerometer, run.attitude
    measured = [np.ascontiguousarray(one[:n]) for one in channels]
    begin = np.zeros(3) if start is None else start
    known = fresh, flying, height_m, gains.fresh, gains.stale, begin
    observe(
        *driven, *measured, *known, kept, carry is not None, states, sensed, filters, innovations
    )
    return Observed(drive, gains, states, sensed, filters, innovations, flying, fresh), kept


def fly_ahead(run: Flown, seen: Observed, rows: ArrayLike, horizons: ArrayLike) -> Ahead:
    """From the observed state at each of ``rows`` on the inputs alone, to every horizon."""
    starts = np.ascontiguousarray(rows, np.int64)
    steps = np.atleast_1d(np.asarray(horizons, np.int64))
    if len(steps) == 0 or steps[0] < 1 or (np.diff(steps) <= 0).any():
        raise ValueError(f"horizons {steps.tolist()}: need rows ahead, 1 or more, ascending")
    if len(starts) and (starts.min() < 0 or starts.max() + steps[-1] >= len(run.duty)):
        raise ValueError("rows plus the longest horizon leave the run")
    drive = seen.drive
    reported = run.attitude[starts]
    unknown = ~np.asarray(np.isfinite(reported).all(axis=1))
    shown = quaternion_of_attitude(np.where(unknown[:, None], 0.0, reported))
    shown[unknown] = seen.states[starts][unknown, QUATERNION]
    measured, states = np.empty((len(starts), len(steps), 9)), seen.states[starts]
    remembered = seen.sensed[starts], seen.filters[starts], np.ascontiguousarray(shown)
    drive.coast(seen.fresh, starts, steps, states, *remembered, measured)
    gyro, accelerometer, attitude = (measured[..., i : i + 3].copy() for i in (0, 3, 6))
    return Ahead(starts, steps, gyro, accelerometer, attitude, states)


def airborne(seen: Observed, rows_ahead: int) -> Rows:
    """Rows from which ``rows_ahead`` more are flown, and whose state has settled."""
    flying = seen.flying
    settle = round((SETTLE_S if flying[0] else LIFT_OFF_S) / seen.drive.period_s)
    flown = np.concatenate([[0], np.cumsum(flying)])
    rows = np.arange(len(flying) - rows_ahead)
    first = np.maximum(rows - settle, 0)
    full = flown[rows + rows_ahead + 1] - flown[first] == rows + rows_ahead + 1 - first
    return np.asarray(rows[full & (rows >= settle)], np.int64)


# Reference programmes: what a simulated craft is asked to do, angles over time.
#
# Built in are ``hover``, ``step``, ``doublet`` and ``sine``, each on roll, pitch and yaw in turn;
# any other is a CSV file with the columns ``time_s``, ``roll_deg``, ``pitch_deg``, ``yaw_deg`` and,
# if wanted, ``height_m``, linear between its rows.


SIZE_RAD, REST_S, HOLD_S = np.radians(10.0), 1.0, 0.5
SINE_HZ, SINE_PERIODS = 1.0, 3
HEIGHT_M = 1.0
BUILT_IN = ("hover", "step", "doublet", "sine")
LONGEST_S, STEEPEST_RAD = 600.0, np.radians(60.0)


@dataclass(frozen=True, slots=True)
class Reference:
    """attitude: (n, 3) rad roll, pitch (nose down), yaw; height_m: (n,); rows 2 ms apart."""

    name: str
    attitude: Array
    height_m: Array

    def __len__(self) -> int:
        return len(self.attitude)


def load_reference(source: str | Path) -> Reference:
    """A built-in programme by name, or a CSV file by path.

    Raises BadInputError, naming the built-in ones or the row that is wrong.
    """
    if str(source) in BUILT_IN:
        attitude = _built_in(str(source))
        return Reference(str(source), attitude, np.full(len(attitude), HEIGHT_M))
    path = Path(source)
    if not path.is_file():
        raise BadInputError(
            f"reference {str(source)!r}: neither built in ({', '.join(BUILT_IN)}) nor a file"
        )
    table = _read_rows(path)
    time = table[:, 0] - table[0, 0]
    grid = np.arange(0.0, time[-1], SAMPLE_PERIOD_S)
    columns = [np.interp(grid, time, table[:, i]) for i in range(1, table.shape[1])]
    attitude = np.radians(np.column_stack(columns[:3]))
    if np.abs(attitude[:, :2]).max() > STEEPEST_RAD:
        raise BadInputError(
            f"reference {path}: a tilt of {np.degrees(np.abs(attitude[:, :2]).max()):.0f} deg;"
            f" at most {np.degrees(STEEPEST_RAD):.0f} can be flown"
        )
    height = columns[3] if len(columns) > 3 else np.full(len(grid), HEIGHT_M)
    return Reference(path.stem, attitude, height)


def _built_in(name: str) -> Array:
    rest = np.zeros(round(REST_S / SAMPLE_PERIOD_S))
    hold = np.ones(round(HOLD_S / SAMPLE_PERIOD_S))
    time = np.arange(0.0, SINE_PERIODS / SINE_HZ, SAMPLE_PERIOD_S)
    sine, doublet = np.sin(2 * np.pi * SINE_HZ * time), np.concatenate([hold, -hold])
    shapes = {"hover": 0.0 * hold, "step": hold, "doublet": doublet, "sine": sine}
    piece = np.concatenate([rest, SIZE_RAD * shapes[name], rest])
    attitude = np.zeros((3 * len(piece), 3))
    for axis in range(3):
        attitude[axis * len(piece) : (axis + 1) * len(piece), axis] = piece
    return attitude


def _read_rows(path: Path) -> Array:
    """The rows of a CSV file: time, angles and, where it has that, height. Raises BadInputError
    naming what is missing, or the row that is wrong."""
    needed = ("time_s", "roll_deg", "pitch_deg", "yaw_deg")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            names = reader.fieldnames or []
            missing = [name for name in needed if name not in names]
            if missing:
                raise BadInputError(
                    f"reference {path}: no column {', '.join(missing)}; needed are"
                    f" {', '.join(needed)}, and height_m if wanted"
                )
            chosen = [*needed, *(name for name in names if name == "height_m")]
            rows = []
            for number, row in enumerate(reader, 2):
                try:
                    rows.append([float(row[name]) for name in chosen])
                except (TypeError, ValueError) as error:
                    raise BadInputError(f"reference {path}, line {number}: {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"reference {path}: cannot be read: {error}") from error
    table = np.array(rows)
    if len(rows) < 2 or not np.isfinite(table).all() or (np.diff(table[:, 0]) < 0).any():
        raise BadInputError(
            f"reference {path}: needs two rows or more of finite numbers, time_s ascending"
        )
    if not 0.1 <= table[-1, 0] - table[0, 0] <= LONGEST_S:
        raise BadInputError(f"reference {path}: must last 0.1..{LONGEST_S:.0f} s")
    return table


# A model flown along a reference by a simple controller, with everything it would report.
#
# The controller knows the true state: angle and height loops ask for accelerations, the mixer's
# constants turn these into rotor speeds, and each motor is driven to its speed in ``MOTOR_S``. It
# is there to keep an unstable craft in the air, not to be a model of a firmware: for closed loops
# with delay and real controllers see ``groundstation.control`` and the stand-in. What is reported
# is then made from the same inputs by the model with all its effects, sensors included.


ANGLE_RAD_S, ANGLE_DAMPING, ANGLE_INTEGRAL = 7.0, 0.9, 40.0
HEIGHT_RAD_S, HEIGHT_DAMPING = 3.0, 1.0
MOTOR_S = 0.025
PIECE_ROWS = 50
LOST_RAD = 1.4
"""A tilt from which the controller does not come back."""


@dataclass(frozen=True, slots=True)
class MadeRun:
    """A simulated flight with the channels of a run: rows 2 ms apart.

    duty: (n, 4); supply_v: (n,) as reported; gyro (n, 3) rad/s, accelerometer (n, 3) m/s^2 and
    attitude (n, 3) rad as reported, without noise; rotor_rev_s: (n, 4) behind each row; states:
    (n, 17), the true ones at each row; reference: (n, 3) rad.
    """

    period_s: float
    duty: Array
    supply_v: Array
    gyro: Array
    accelerometer: Array
    attitude: Array
    rotor_rev_s: Array
    states: Array
    reference: Array

    @property
    def settings(self) -> Array:
        """The duty: rows are as fast as the motors are set."""
        return self.duty


def fly_reference(model: Model, reference: Reference, supply_v: float = 3.7) -> MadeRun:
    """Fly a model along a reference, from a hover, at a steady supply voltage.

    Raises BadInputError where the model cannot hover at that voltage, or falls.
    """
    duty, states = _closed_loop(model, reference, supply_v)
    n = len(duty)
    volts = np.full(n, supply_v)
    nothing = np.zeros((n, 3))
    run = MadeRun(SAMPLE_PERIOD_S, duty, volts, nothing, nothing, nothing, nothing, states, nothing)
    made = replace(_report(drive_run(model, run), run), reference=reference.attitude[:n])
    return replace(made, rotor_rev_s=shown_rotors(model, made.rotor_rev_s, made.period_s))


def _closed_loop(model: Model, reference: Reference, supply_v: float) -> tuple[Array, Array]:
    """Duty (n, 4), row i acting before sample i, and true states (n, 17 + those of effects)."""
    craft = craft_of_model(model)
    one = craft[0]
    supply = 1000.0 * supply_v
    # Rotor speeds from wanted accelerations: the inverse of mixer and constants.
    roll = one["rotor_y"] * one["thrust"] / one["inertia"][0]
    pitch = -one["rotor_x"] * one["thrust"] / one["inertia"][1]
    yaw = np.array([-1.0, 1.0, -1.0, 1.0]) * one["drag"] / one["inertia"][2]
    mixing = np.vstack([roll, pitch, yaw, np.full(4, one["thrust"] / one["mass"])])
    inverse = np.linalg.inv(mixing)
    hover = hover_rev_s(craft)
    at, turned = (0.0, 0.0, reference.height_m[0]), (0.0, 0.0, reference.attitude[0, 2])
    state = craft_state(position_m=at, attitude=turned, rotor_rev_s=hover)
    state = with_states(craft, state[None], made=True)[0]
    n = len(reference)
    duty, states = np.empty((n, 4)), np.empty((n, len(state)))
    duty[0] = duties_for(craft, state[ROTOR], np.zeros(4), supply)
    if duty[0].max() > 0.95:
        raise BadInputError(
            f"model for {model.vehicle}: to hover at {supply_v:g} V takes"
            f" {100 * duty[0].max():.0f} % of full duty; give more voltage"
        )
    states[0] = state
    integral = np.zeros(3)
    for row in range(1, n):
        attitude = attitude_of(state)
        if np.abs(attitude[:2]).max() > LOST_RAD or not np.isfinite(state).all():
            raise BadInputError(
                f"reference {reference.name}: the craft falls after {row * SAMPLE_PERIOD_S:.2f} s;"
                " ask for less tilt, or look at the model's effects"
            )
        error = reference.attitude[row] - attitude
        error[2] = np.angle(np.exp(1j * error[2]))
        integral = np.clip(integral + error * SAMPLE_PERIOD_S, -0.5, 0.5)
        turn = ANGLE_RAD_S**2 * error + ANGLE_INTEGRAL * integral
        turn -= 2.0 * ANGLE_DAMPING * ANGLE_RAD_S * state[RATE]
        climb = HEIGHT_RAD_S**2 * (reference.height_m[row] - state[2])
        climb -= 2.0 * HEIGHT_DAMPING * HEIGHT_RAD_S * state[5]
        lift = (STANDARD_GRAVITY + np.clip(climb, -4.0, 4.0)) / (
            np.cos(attitude[0]) * np.cos(attitude[1])
        )
        wanted = np.sqrt(np.maximum(inverse @ [*turn, lift], (0.3 * hover) ** 2))
        speed = state[ROTOR]
        duty[row] = duties_for(craft, speed, (wanted - speed) / MOTOR_S, supply)
        driven = duty[row : row + 1] * supply
        (_, state) = simulate(craft, state, driven, supply_mv=np.array([supply]))
        states[row] = state
    return duty, states


def _report(drive: Drive, run: MadeRun) -> MadeRun:
    """The channels that the model's sensors show of a flight whose true states are known.

    Flown again in short pieces from true states: an open loop would magnify rounding errors.
    """
    n = len(run.duty)
    late = np.maximum(np.arange(n) * run.period_s - float(drive.sensor[0]["delay"]), 0.0)
    states = _between(run.states, late / run.period_s)
    sensed, report = resting_sensors(drive.craft[0])[None], states[:1, QUATERNION].copy()
    leaning = np.zeros((1, FILTER))
    leaning[0, :4], leaning[0, 6] = report[0], STANDARD_GRAVITY
    shown = np.empty((n, 9))
    fresh = np.arange(n) % 2 == 0
    for row in range(0, n - 1, PIECE_ROWS):
        ahead = np.arange(1, min(PIECE_ROWS, n - 1 - row) + 1)
        measured = np.empty((1, len(ahead), 9))
        begun = states[row : row + 1].copy()
        drive.coast(fresh, np.array([row]), ahead, begun, sensed, leaning, report, measured)
        shown[row + 1 : row + 1 + len(ahead)] = measured[0]
    shown[0] = shown[1]
    gyro, force, attitude = (shown[:, i : i + 3].copy() for i in (0, 3, 6))
    attitude, speed = np.unwrap(attitude, axis=0), drive.rotor_rev_s
    return replace(run, gyro=gyro, accelerometer=force, attitude=attitude, rotor_rev_s=speed)


def _between(states: Array, at: Array) -> Array:
    """States between rows, by Hermite's cubic over central differences."""
    from scipy.interpolate import CubicHermiteSpline

    grid = np.arange(len(states))
    found = np.asarray(CubicHermiteSpline(grid, states, np.gradient(states, axis=0))(at))
    found[:, QUATERNION] /= np.linalg.norm(found[:, QUATERNION], axis=1)[:, None]
    return found
