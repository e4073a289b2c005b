"""What a model expects a few rows ahead, from all that was measured until then.

The craft is unstable, so a model is judged over short horizons: an observer keeps the state
(``observer``), and from any row the model flies on the recorded inputs alone. Every effect of
the model acts, in the observer and in the prediction. Arrays in, arrays out; rows of the past
never see those of the future, so a live stream can be fed in pieces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.craft import SENSOR_STATES, Crafts, acting, craft_of_model
from groundstation.dynamics.hover import settled_rev_s
from groundstation.dynamics.model import Model
from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.dynamics.sensors import FILTER, sensors_of_model
from groundstation.dynamics.state import QUATERNION, STATES
from groundstation.errors import BadInputError
from groundstation.prediction.attitude_rhythm import fresh_rows
from groundstation.prediction.height import heights_of, rise_of
from groundstation.prediction.observer import Gains, Noise, gains_of
from groundstation.spans import spans

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

TURNING = 0.1
"""Duty above which a motor turns."""
LANDED = 0.85
"""Thrust over weight at which a craft has come back to the ground."""
SETTLE_S, LIFT_OFF_S = 0.5, 0.1
REST_S, TOUCH_DOWN_S = 3.0, 0.5
"""The accelerometer's offset is judged by so much of the rest before a flight, or after it and the
touch-down."""


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

    def since(self, row: int) -> Drive:
        """The same from a row on."""
        return replace(
            self,
            speed=self.speed[2 * row :],
            push=self.push[2 * row :],
        )


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
    is still in the air at the longest horizon. height_m: (n,) above ground, for ground_effect;
    by default reckoned by ``height_of``. noise: sets the observer's gains.

    Raises BadInputError where PWM, battery voltage or gyro are missing.
    """
    seen = observe_run(model, run, height_m=height_m, noise=noise)
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
    flying = _flying(run, drive)
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
    supply = np.ascontiguousarray(1000.0 * run.supply_v, np.float64)
    duty = np.ascontiguousarray(run.settings, np.float64)
    start = settled_rev_s(craft, run.duty[0], float(supply[0]))
    speed = np.empty((2 * len(supply) - 1, 4))
    spin(craft[0], duty, supply, run.period_s, float(sensor[0]["delay"]), start, speed)
    push = np.empty((len(speed), 5))
    drives(craft[0], speed, run.period_s, push)
    return Drive(craft, sensor, run.period_s, speed, push)


def observe_run(
    model: Model, run: Flown, *, height_m: Array | None = None, noise: Noise | None = None
) -> Observed:
    """The state behind every row, from measurements up to that row.

    Raises BadInputError where PWM, battery voltage or the whole gyro are missing.
    """
    if not np.isfinite(run.gyro).any():
        raise BadInputError("the gyro is missing; the craft's state cannot be followed without it")
    drive = drive_run(model, run)
    flying = _flying(run, drive)
    fresh = fresh_rows(run.attitude)
    if height_m is None:
        near = any("height" in effect.unmeasured for effect, _ in acting(model))
        height_m = height_of(run, flying) if near else np.full(len(run.duty), np.nan)
    seen, _ = observe_part(
        run, drive, gains_of(model, run.period_s, noise), flying, fresh, height_m=height_m
    )
    return seen


def observe_part(
    run: Flown,
    drive: Drive,
    gains: Gains,
    flying: Mask,
    fresh: Mask,
    *,
    height_m: Array,
    carry: Array | None = None,
) -> tuple[Observed, Array]:
    """(state behind every row of ``flying`` (m,), what the next part goes on from).

    Those are the first m rows of the run; drive and fresh may reach further, for predictions.
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
    """Rows from which ``rows_ahead`` more are flown, and whose state has settled.

    From a take-off on the state is known; where a run starts in the air it takes ``SETTLE_S``.
    """
    flying = seen.flying
    settle = round((SETTLE_S if flying[0] else LIFT_OFF_S) / seen.drive.period_s)
    flown = np.concatenate([[0], np.cumsum(flying)])
    rows = np.arange(len(flying) - rows_ahead)
    first = np.maximum(rows - settle, 0)
    full = flown[rows + rows_ahead + 1] - flown[first] == rows + rows_ahead + 1 - first
    return np.asarray(rows[full & (rows >= settle)], np.int64)


def height_of(run: Flown, flying: Mask) -> Array:
    """Height above ground (n,) in m; infinite in flight where a recording cannot tell it."""
    height = np.where(flying, np.inf, 0.0)
    rise = rise_of(run.attitude, run.accelerometer)
    still = ~np.asarray((run.duty > 0.0).any(axis=1))
    for start, stop in spans(_turning(run)):
        known = np.maximum(heights_of(rise, still, start, stop, run.period_s), 0.0)
        height[start:stop] = np.where(flying[start:stop], known, 0.0)
    return height


def _flying(run: Flown, drive: Drive) -> Mask:
    """Rows in the air: from the first thrust above the weight until thrust has gone for good."""
    turning = _turning(run)
    one = drive.craft[0]
    lift, low_lift = drive.push[::2, 0] / one["gravity"], drive.push[::2, 1] / one["gravity"]
    flying = np.zeros(len(turning), np.bool_)
    for first, last in spans(turning):
        if first > 0:
            up = np.flatnonzero(low_lift[first:last] > 1.0)
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


def _turning(run: Flown) -> Mask:
    return np.asarray((run.duty > TURNING).all(axis=1))
