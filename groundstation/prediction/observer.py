"""The observer that corrects a model by measurements: its gains, their settled covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.craft import Crafts, craft_of_model
from groundstation.dynamics.effect import FAR_M
from groundstation.dynamics.model import Model
from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.dynamics.sensors import resting_sensors, sensors_of_model
from groundstation.dynamics.simulation import (
    POSITION,
    QUATERNION,
    RATE,
    ROTOR,
    STATES,
    hover_rev_s,
    with_states,
)
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array

# The covariance of a Kalman filter that has settled, by doubling.
#
# A row takes the covariance P of an error to h + f P (1 + g P)^-1 f^T. Rows after each other are
# such a map again, so that 2^k rows take k steps (Anderson and Moore, Optimal Filtering, 1979,
# section 6.7).


DOUBLINGS = 13
"""16 s of rows at 500 Hz: three times that in which a velocity that nothing measures settles."""


@dataclass(frozen=True, slots=True)
class Row:
    """What a filter does in a row: the model moves the error on, and m numbers are measured.

    transition: (e, e). process: (e,) variances that come anew. seen: (m, e), what is measured of
    the error. sensor: (m,) variances of that.
    """

    transition: Array
    process: Array
    seen: Array
    sensor: Array

    def corrected(self, before: Array) -> tuple[Array, Array]:
        """The gain (e, m), and the covariance (e, e) after the row, of the one before it."""
        p = self.transition @ before @ self.transition.T + np.diag(self.process)
        cross = self.seen @ p
        gain = np.linalg.solve(cross @ self.seen.T + np.diag(self.sensor), cross).T
        p = p - gain @ cross
        return np.asarray(gain, np.float64), 0.5 * (p + p.T)


@dataclass(frozen=True, slots=True)
class _Map:
    """Each (e, e)."""

    f: Array
    g: Array
    h: Array

    def then(self, other: _Map) -> _Map:
        size = len(self.f)
        both = np.concatenate([self.f, self.h], axis=1)
        through = np.linalg.solve(np.eye(size) + self.h @ other.g, both)
        f, h = through[:, :size], through[:, size:]
        g = self.g + self.f.T @ other.g @ f
        h = other.h + other.f @ h @ other.f.T
        return _Map(other.f @ f, 0.5 * (g + g.T), 0.5 * (h + h.T))

    def of(self, p: Array) -> Array:
        found = self.h + self.f @ np.linalg.solve(np.eye(len(p)) + p @ self.g, p) @ self.f.T
        return 0.5 * (found + found.T)


def settled(rows: Sequence[Row], start: Array) -> Array:
    """The covariance (e, e) before the first of rows that have repeated many times.

    start: (e, e), that before the very first.
    """
    every = _map_of(rows[0])
    for row in rows[1:]:
        every = every.then(_map_of(row))
    for _ in range(DOUBLINGS - 1):
        every = every.then(every)
    return every.of(start)


def _map_of(row: Row) -> _Map:
    size = len(row.transition)
    moved = _Map(row.transition, np.zeros((size, size)), np.diag(row.process))
    information = row.seen.T @ (row.seen / row.sensor[:, None])
    return moved.then(_Map(np.eye(size), information, np.zeros((size, size))))


# The gains: a Kalman filter whose covariance has settled, with a new attitude in every
# second row: the model, with its effects, is linearised about hover by differences. Errors are
# those of attitude (rotation in the body), rates, what the gyro's last filter makes of them and
# velocity in the body: 12 numbers; behind them those of states that noise drives, and of filters
# before the last.


Places = NDArray[np.intp]

ERRORS = 12
NUDGE = 1e-4
LEAST = 1e-13
"""Variance per row of what nothing but the model moves; without any its covariance is singular."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of what no model explains; defaults are a Crazyflie's in still air.

    torque: (3,) rad/s^2 and force: m/s^2, white at ``period_s``. gyro: (3,) rad/s, accelerometer:
    m/s^2, attitude: rad, per sample. speed: m/s, how fast the craft usually flies: what the
    velocity is pulled back to where nothing measures it. walk: (3,) rad in a second, how far the
    reported angles wander off the gyro's integral, about the body's axes.
    """

    torque: tuple[float, float, float] = (2.0, 2.0, 0.5)
    force: float = 0.1
    gyro: tuple[float, float, float] = (1.75e-3, 1.75e-3, 1.75e-3)
    accelerometer: float = 0.1
    attitude: float = 3.6e-4
    speed: float = 0.7
    walk: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Gains:
    """fresh, stale: (e, 12), for rows with and without a new attitude. covariance: (e, e) of
    the error after a row. transition (e, e), shown (12, e): the model linearised about hover, and
    what gyro, accelerometer, attitude and velocity show of an error. process (e,), sensor (12,):
    variances per row."""

    fresh: Array
    stale: Array
    covariance: Array
    transition: Array
    shown: Array
    process: Array
    sensor: Array

    def expected(self, rows_ahead: int) -> Array:
        """Standard deviation (9,) of prediction errors of gyro, accelerometer and attitude."""
        p = self.covariance
        for _ in range(rows_ahead):
            p = self.transition @ p @ self.transition.T + np.diag(self.process)
        spread = np.diag(self.shown @ p @ self.shown.T) + self.sensor
        return np.asarray(np.sqrt(spread[:9]), np.float64)


@lru_cache(maxsize=64)
def _gains(key: bytes, period_s: float, noise: Noise) -> Gains:
    from groundstation.dynamics.craft import CRAFT
    from groundstation.dynamics.sensors import SENSORS

    craft = np.frombuffer(key[: CRAFT.itemsize], CRAFT)
    sensor = np.frombuffer(key[CRAFT.itemsize :], SENSORS)
    a, c = _linearised(craft, sensor, period_s)
    lean = bool(sensor[0]["gains"][0] > 0.0)
    observed = integrating_force(a, period_s, craft[0]["gravity"])
    torque = np.square(np.multiply(noise.torque, period_s))
    felt = noise.accelerometer**2 + noise.force**2
    process = np.concatenate(
        [torque * (0.5 * period_s) ** 2 + LEAST, torque, np.full(3, LEAST), np.full(3, felt)]
    )
    process[9:] *= period_s**2
    process[:3] += period_s * np.square(noise.walk)
    # A first-order process keeps its variance: what fades in a row comes anew.
    driven = craft[0]["body_noise"][craft[0]["body_noise"] > 0.0]
    fades = np.diag(a)[ERRORS : ERRORS + len(driven)]
    before = np.full(len(a) - ERRORS - len(driven), LEAST)
    process = np.concatenate([process, driven**2 * (1.0 - fades**2), before])
    # A leaning filter's report says next to nothing about the true attitude.
    attitude = 0.5 if lean else noise.attitude
    others = np.repeat([felt, attitude**2, noise.speed**2], 3)
    sensors = np.concatenate([np.square(noise.gyro), others])
    rows = np.array([0, 1, 2, 3, 4, 5, 9, 10, 11])
    without = Row(observed, process, c[rows], sensors[rows])
    fresh = Row(observed, process, c, sensors)
    stale = np.zeros((len(a), ERRORS))
    stale[:, rows], p = without.corrected(settled([without, fresh], np.eye(len(a)) * 1e-4))
    gain, p = fresh.corrected(p)
    shown = sensors.copy()
    shown[6:9] = noise.attitude**2
    process[9:ERRORS] = (period_s * noise.force) ** 2
    return Gains(gain, stale, p, a, c, process, shown)


def gains_of(model: Model, period_s: float, noise: Noise | None = None) -> Gains:
    """The settled gains for a model, whose rows are ``period_s`` apart (cached).

    Raises BadInputError for a model that predicts no number.
    """
    craft, sensor = craft_of_model(model), sensors_of_model(model)
    period_s = float(f"{period_s:.4g}")  # flights differ by what clocks drift, gains do not
    return _gains(craft.tobytes() + sensor.tobytes(), period_s, noise or Noise())


def _linearised(craft: Crafts, sensor: NDArray[np.void], period_s: float) -> tuple[Array, Array]:
    """(e, e) transition of an error over one row, and (12, e) what is measured of it afterwards."""
    from groundstation.prediction.kernels import coast

    one, hover = craft[0], hover_rev_s(craft)
    driven = STATES + np.flatnonzero(one["body_noise"])
    last, before = gyro_states(one["follows"])
    starts, sensed = _nudged(craft, hover, driven, last, before)
    count = len(starts)
    measured = np.empty((count, 1, 9))
    rows = np.zeros(2, np.bool_), np.zeros(count, np.int64), np.ones(1, np.int64)
    leaning = np.tile([1.0, 0, 0, 0, 0, 0, one["gravity"], 0, 0, 0], (count, 1))
    report, driving = np.tile([1.0, 0, 0, 0], (count, 1)), np.full((3, 4), hover)
    coast(one, sensor[0], driving, period_s, *rows, starts, sensed, leaning, report, measured)
    delayed = sensed[:, last] if len(last) else np.zeros((count, 3))
    moved = 2.0 * starts[:, 7:10], starts[:, RATE], delayed, starts[:, 3:6]
    reached = np.column_stack([*moved, starts[:, driven], sensed[:, before]])
    a = (reached[0::2] - reached[1::2]).T / (2 * NUDGE)
    felt = measured[:, 0, :6]
    seen = (felt[0::2] - felt[1::2]).T / (2 * NUDGE)
    if not delayed.any():  # no such state: it follows the rates
        a[6:9] = 0.0
        a[:, 6:9] = 0.0
        seen[:, 6:9] = 0.0
    if not (np.isfinite(a).all() and np.isfinite(seen).all()):
        raise BadInputError(
            "the model predicts no number for a hover: an effect of it divides by zero, or grows"
            " without end; look at your own effects first"
        )
    # ``seen`` is of the error before the row; the observer needs it of the one after.
    after = np.zeros((ERRORS, count // 2))
    after[:6] = np.linalg.lstsq(a.T, seen.T, rcond=1e-12)[0].T
    after[6:9, 0:3] = np.eye(3)
    after[9:, 9:ERRORS] = np.eye(3)
    return a, after


def _nudged(
    craft: Crafts, hover: float, driven: Places, last: Places, before: Places
) -> tuple[Array, Array]:
    """States (2 e, s) and sensors' states at hover, each error in turn ``NUDGE`` more and less.

    driven: places of states that noise drives; last, before: as in ``gyro_states``.
    """
    errors = ERRORS + len(driven) + len(before)
    starts = np.zeros((2 * errors, STATES))
    starts[:, QUATERNION.start], starts[:, ROTOR] = 1.0, hover
    starts[:, POSITION.stop - 1] = FAR_M
    starts = with_states(craft, starts).copy()
    sensed = np.tile(resting_sensors(craft[0]), (2 * errors, 1))
    for k in range(2 * errors):
        i, size = k // 2, NUDGE if k % 2 == 0 else -NUDGE
        part, axis = divmod(i, 3)
        if part == 0:
            starts[k, QUATERNION] = quaternion_of_attitude(size * np.eye(3)[axis])
        elif part == 1:
            starts[k, RATE.start + axis] = size
        elif part == 2:
            sensed[k, last[axis : axis + 1]] = size
        elif part == 3:
            starts[k, 3 + axis] = size
        elif i < ERRORS + len(driven):
            starts[k, driven[i - ERRORS]] = size
        else:
            sensed[k, before[i - ERRORS - len(driven)]] = size
    return starts, sensed


def integrating_force(transition: Array, period_s: float, gravity: float) -> Array:
    """The transition (e, e) of an observer's error, whose velocity is the integral of measured
    specific force, not of the model's."""
    observed = transition.copy()
    observed[9:ERRORS] = 0.0
    observed[9:ERRORS, 9:ERRORS] = np.eye(3)
    observed[9, 1] = period_s * gravity
    observed[10, 0] = -period_s * gravity
    return observed


def gyro_states(follows: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(places of what the gyro's last filter shows (3,), or none where it has no filter; places of
    what the filters before it pass on), among the sensors' states."""
    places = [np.flatnonzero(follows == axis) for axis in range(3)]
    last = np.array([one[-1] for one in places if len(one)], np.intp)
    return last, np.sort(np.concatenate([one[:-1] for one in places]))
