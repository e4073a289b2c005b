"""What a model expects a few rows ahead, from all that was measured until then.

The craft is unstable, so a model is judged over short horizons: an observer keeps the state
(``observer``), and from any row the model flies on the recorded inputs alone. Every effect of
the model acts, in the observer and in the prediction. Arrays in, arrays out; rows of the past
never see those of the future, so a live stream can be fed in pieces.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.craft import SENSOR_STATES, acting
from groundstation.dynamics.model import Model
from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.dynamics.sensors import FILTER
from groundstation.dynamics.state import QUATERNION, STATES
from groundstation.errors import BadInputError
from groundstation.prediction.attitude_rhythm import fresh_rows
from groundstation.prediction.attitude_walk import AHEAD_S, walk_of
from groundstation.prediction.drive import (
    Drive,
    Flown,
    drive_run,
    flying_rows,
    height_of,
    reckoned_height,
)
from groundstation.prediction.gyro_vibration import vibration_of
from groundstation.prediction.observer import Gains, Noise, gains_of
from groundstation.prediction.start_velocity import start_velocity
from groundstation.telemetry.arrays import Array

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

JUDGED = 4
"""Every so manyth row tells which of two observers suits a run."""
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

    @property
    def leans(self) -> bool:
        """Whether the model says by a filter of its own how reported angles leave the true ones."""
        return bool(self.drive.sensor[0]["gains"][0] > 0.0)


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
        turn = run.attitude[at] - self.attitude
        return np.concatenate(
            [
                run.gyro[at] - self.gyro,
                run.accelerometer[at] - self.accelerometer,
                np.angle(np.exp(1j * turn)),
            ],
            axis=2,
        )


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
    return Noise(
        torque=(float(push[0]), float(push[1]), float(push[2])),
        force=usual.force,
        gyro=(float(shaken[0]), float(shaken[1]), float(shaken[2])),
        accelerometer=float(felt.std()) if len(felt) else usual.accelerometer,
        attitude=usual.attitude,
        speed=usual.speed,
    )


def own_noise(run: Flown, flying: Mask) -> Noise:
    """The usual noise with what a run tells of its own without a model: how its gyro is shaken
    (``gyro_vibration``), and how far its reported angles, NaN where they are not new, wander off
    the gyro's integral (``attitude_walk``). flying: (n,) rows in the air.

    The whole run is used: for a live stream, take an earlier flight's.
    """
    usual = Noise()
    noises = {"angle": usual.attitude, "rate": max(usual.gyro)}
    walk = walk_of(run.attitude, run.gyro, flying, run.period_s, **noises)
    shaken = vibration_of(run.gyro, flying, run.period_s)
    x, y, z = map(max, usual.gyro, shaken)
    return replace(usual, gyro=(x, y, z), walk=walk)


def observe_as_it_is(model: Model, run: Flown, noise: Noise) -> tuple[Observed, Noise]:
    """As ``observe_run``, with what of a run's ``own_noise`` foretells it better: a gyro that is
    shaken, for a torque that is rough looks alike to it, and angles that wander, for what the model
    says of the sensors may explain them. That noise is returned too."""
    observed = _observer(model, run)
    steady, chosen = observed(None), Noise()
    if noise.gyro != chosen.gyro:
        other = replace(chosen, gyro=noise.gyro)
        shaken = observed(other)
        if _error(run, shaken, RATES) < _error(run, steady, RATES):
            steady, chosen = shaken, other
    if steady.leans or not any(noise.walk):  # a filter of its own says how far they are off
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
    start = _start(run, drive, flying)

    def observed(noise: Noise | None) -> Observed:
        gains = gains_of(model, run.period_s, noise)
        return observe_part(run, drive, gains, flying, fresh, height_m=height_m, start=start)[0]

    return observed


def _start(run: Flown, drive: Drive, flying: Mask) -> Array:
    """Inertial velocity (3,) with which a run begins, by the sensors as the model has them."""
    moving = slice(len(flying) if flying.all() else int(np.argmin(flying)))
    force = run.accelerometer[moving] - drive.sensor[0]["zero"][3:]
    return start_velocity(run.attitude[moving], force, run.period_s)


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
    observe(
        drive.craft[0],
        drive.sensor[0],
        drive.speed,
        drive.period_s,
        np.ascontiguousarray(run.gyro[:n]),
        np.ascontiguousarray(run.accelerometer[:n]),
        np.ascontiguousarray(run.attitude[:n]),
        fresh,
        flying,
        height_m,
        gains.fresh,
        gains.stale,
        np.zeros(3) if start is None else start,
        kept,
        carry is not None,
        states,
        sensed,
        filters,
        innovations,
    )
    return Observed(drive, gains, states, sensed, filters, innovations, flying, fresh), kept


def fly_ahead(run: Flown, seen: Observed, rows: ArrayLike, horizons: ArrayLike) -> Ahead:
    """From the observed state at each of ``rows`` on the inputs alone, to every horizon."""
    from groundstation.prediction.kernels import coast

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
    coast(
        drive.craft[0],
        drive.sensor[0],
        drive.speed,
        drive.period_s,
        seen.fresh,
        starts,
        steps,
        states,
        seen.sensed[starts],
        seen.filters[starts],
        np.ascontiguousarray(shown),
        measured,
    )
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
