"""What the sensor effects of a point do: undone on what was measured, done to what is modelled.

Near rest a sensor is linear: ds/dt = a s + b u, shown = c s + d u + offset, u = (gyro,
accelerometer) in body axes. The matrices are read off the laws by differences. What a law makes of
the craft's motion beside (a lever arm), or of large readings, it does row by row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effect import ANGLES, FAR_M, Body, Craft, Reading, Role
from groundstation.identification.likelihood.motion import (
    Acting,
    BodyRows,
    Rows,
    one_before,
    stacked,
)
from groundstation.telemetry.arrays import Array

# Linear filters of a recording's rows: sensors near rest, and the firmware's low-pass.
#
# Both are exact for the input they are given: rates that change straight from row to row, or values
# at the rows with straight lines between. A filter that is the same on each of three axes, and of
# second order at most, runs on all three at once; any other by its matrix.


FIRMWARE_HZ = 1000.0
"""Rate of the firmware's sensor loop."""
SAME = 1e-12
"""Rounding of the differences that laws are made linear by."""
RATES, FORCES = slice(0, 3), slice(3, 6)
AXES = 3


@dataclass(frozen=True, eq=False)
class NearRest:
    """One sensor near rest: ds/dt = a s + b u, shown = c s + d u + offset, u of (6,)."""

    a: Array
    b: Array
    c: Array
    d: Array
    offset: Array

    @cached_property
    def steady(self) -> tuple[Array, Array]:
        """Gain and lag (6, 6): over a ramp u the states follow as p u + a^-1 p du/dt."""
        if not self.a.size:
            return self.d, np.zeros((6, 6))
        return self.d + self.c @ self.still, -self.c @ solved(self.a, self.still)

    @cached_property
    def still(self) -> Array:
        """The states (s, 6) that steady inputs of 1 settle at."""
        return solved(self.a, -self.b)


def solved(matrix: Array, values: Array) -> Array:
    """The x of least squares of matrix x = values."""
    return np.asarray(np.linalg.lstsq(matrix, values, rcond=None)[0])


def behind_sensor(near: NearRest, part: slice, values: Array, first: int, period_s: float) -> Array:
    """Rows (n, 3) behind a sensor, exactly, from a start that has settled at row ``first``."""
    from groundstation.identification.likelihood.kernels import linear_filter

    matrix = _discrete(near, part == RATES, period_s)
    start = near.still[:, part] @ values[first]
    alike = _alike_on_axes(near, part == RATES, period_s)
    if alike is not None:
        return _on_axes(alike, start.reshape(-1, AXES), first, values)
    to, of = np.nonzero(np.abs(matrix) > SAME * np.abs(matrix).max())
    found = np.empty_like(values)
    rows = np.ascontiguousarray(values)
    linear_filter(to, of, matrix[to, of], start, first, rows, found)
    return found


def _on_axes(step: Array, start: Array, first: int, values: Array) -> Array:
    """Rows (n, 3) behind one filter on each axis: [s_k, y_k] = step [s_(k-1), u_k, u_(k-1)] with
    step (3, 4); start: (1 or 2, 3), what there is of its two states."""
    from groundstation.identification.likelihood.kernels import axes_filter

    begin, found = np.zeros((2, AXES)), np.empty((len(values), AXES))
    begin[: len(start)] = start
    axes_filter(step, begin, first, np.ascontiguousarray(values), found)
    return found


@lru_cache(maxsize=256)
def _alike_on_axes(near: NearRest, rates: bool, h: float) -> Array | None:
    """Of a filter whose states are those of three axes, one behind the other, and which is the same
    on each: its step of one axis (3, 4), the second state 0 where it has one; None of others."""
    matrix = _discrete(near, rates, h)
    states, more = divmod(len(near.a), AXES)
    if more or not 0 < states <= 2:
        return None
    rows = [np.arange(states + 1) * AXES + axis for axis in range(AXES)]
    columns = [np.arange(states + 2) * AXES + axis for axis in range(AXES)]
    parts = [matrix[np.ix_(to, of)] for to, of in zip(rows, columns, strict=True)]
    apart = matrix.copy()
    for to, of in zip(rows, columns, strict=True):
        apart[np.ix_(to, of)] = 0.0
    rounding = SAME * np.abs(matrix).max()
    other = max(float(np.abs(one - parts[0]).max()) for one in parts)
    if max(other, float(np.abs(apart).max())) > rounding:
        return None
    step = np.zeros((3, 4))
    step[np.ix_([*range(states), 2], [*range(states), 2, 3])] = parts[0]
    return step


@lru_cache(maxsize=256)
def _discrete(near: NearRest, rates: bool, h: float) -> Array:
    """M of [s_k, y_k] = M [s_(k-1), u_k, u_(k-1)] over a period h.

    Rates change straight from row to row: their slopes are held over each period, and what comes
    out are means over it. Forces are values at the rows with straight lines between them.
    """
    from scipy.linalg import expm

    part = RATES if rates else FORCES
    a, b, c, d = near.a, near.b[:, part], near.c[part], near.d[part, part]
    n, m = b.shape
    # exp of [[A h, B h, 0], [0, 0, I], [0, 0, 0]]: the states' answers to a held input and a ramp.
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m] = a * h, b * h
    block[n : n + m, n + m :] = np.eye(m)
    whole = expm(block)
    keep, held, ramp = whole[:n, :n], whole[:n, n : n + m], whole[:n, n + m :]
    none = np.zeros((m, m))
    if rates:
        # A period changes s by h (A mean(s) + B u).
        mean = solved(a * h, np.hstack([keep - np.eye(n), held - b * h]))
        return np.block(
            [[keep, held, np.zeros((n, m))], [c @ mean[:, :n], c @ mean[:, n:] + d, none]]
        )
    return np.block([[keep, ramp, held - ramp], [c @ keep, c @ ramp + d, c @ (held - ramp)]])


def behind_firmware(
    values: Array, corner_hz: float, period_s: float, mean: bool, within: Array | None = None
) -> Array:
    """Rows (n, 3) behind the firmware's Butterworth filter, which runs at 1 kHz: means over the
    periods before them (mean), or values at the rows with straight lines between.

    within: (n, 3), how much more than the first half of a period the second has."""
    if within is None:
        step, still = _firmware_step(corner_hz, period_s, mean)
        return _on_axes(step, still[:, None] * values[:1], 0, values)
    from scipy.signal import lfilter

    b, a, steps = _butterworth(corner_hz, period_s)
    given = np.repeat(values, steps, axis=0)
    later = np.sign(np.arange(steps) - 0.5 * (steps - 1))
    given += 0.5 * np.tile(later, len(values))[:, None] * np.repeat(within, steps, axis=0)
    start = _settled(b, a)[:, None] * values[:1]
    out, _ = lfilter(b, a, given, axis=0, zi=start)
    return out.reshape(len(values), steps, -1).mean(axis=1)


@lru_cache(maxsize=32)
def _firmware_step(corner_hz: float, period_s: float, mean: bool) -> tuple[Array, Array]:
    """What a row makes of the filter's two states, its input and the one before: (3, 4), the states
    and what is shown; and the states (2,) that an input of 1 settles at."""
    from scipy.signal import lfilter

    b, a, steps = _butterworth(corner_hz, period_s)
    now = np.ones(steps) if mean else np.arange(1, steps + 1) / steps
    step = np.empty((3, 4))
    for column, (state, given) in enumerate(
        (((1.0, 0.0), 0.0 * now), ((0.0, 1.0), 0.0 * now), ((0.0, 0.0), now), ((0.0, 0.0), 1 - now))
    ):
        shown, step[:2, column] = lfilter(b, a, given, zi=state)
        step[2, column] = shown.mean() if mean else shown[-1]
    return step, _settled(b, a)


@lru_cache(maxsize=32)
def _butterworth(corner_hz: float, period_s: float) -> tuple[Array, Array, int]:
    """Coefficients b, a of second order, and how often the firmware filters in a row."""
    from scipy.signal import butter

    steps = max(round(FIRMWARE_HZ * period_s), 1)
    b, a = butter(2, corner_hz, fs=steps / period_s)
    return b, a, steps


def _settled(b: Array, a: Array) -> Array:
    """The filter's states (2,) after inputs of 1."""
    from scipy.signal import lfilter_zi

    return lfilter_zi(b, a)


PROBE = 1e-3
"""Step of the differences in SI: small beside what a sensor reads in flight."""
_STILL, _FOUR = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
REST = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), _STILL, _STILL, _FOUR, _FOUR, 0.0, _STILL, _STILL)


@dataclass(frozen=True, slots=True)
class Passing:
    """What comes to a sensor: the mean rate over the period before each row, its slope over the
    period, and the specific force at the row."""

    rate: Rows
    angular: Rows
    force: Rows


@dataclass
class Moving:
    """A craft as its sensors have it, at each row; the sensors are settled at row ``first``.

    within: (n, 3) rad/s^2, by how much the mean angular acceleration of the second half of the
    period before a row is more than that of the first; None: it is held over the period.
    """

    now: BodyRows
    period_s: float
    first: int
    within: Array | None = None

    @cached_property
    def before(self) -> BodyRows:
        """``now`` of the row before."""
        return Before(self.now)

    def __len__(self) -> int:
        return len(self.now.height)


class Before:
    """A body's rows moved on by one, each when it is asked for."""

    def __init__(self, body: BodyRows) -> None:
        self._body = body

    def __getattr__(self, field: str) -> Rows:
        rows = one_before(getattr(self._body, field))
        setattr(self, field, rows)
        return rows


class Sensors:
    """The sensor effects that act at a point, in their order.

    gain, offset: shown = gain u + offset when steady, (6, 6) and (6,). lag: (6, 6) s, shown falls
    behind gain u by lag du/dt on a ramp; unfelt: the part of lag that reported angles do not share.
    undo: inverse of gain. turn: (3, 3), sensor to body axes.
    """

    def __init__(
        self,
        effects: tuple[Acting, ...],
        craft: Craft,
        filter_hz: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """filter_hz: corners of the on-board low-passes of second order behind gyro and
        accelerometer; 0: none."""
        self.craft = craft
        self.estimators = tuple(one for one in effects if one.effect.role is Role.ESTIMATE)
        effects = tuple(one for one in effects if one.effect.role is not Role.ESTIMATE)
        self.effects = effects
        self.gyro_filter_hz, self.accelerometer_filter_hz = filter_hz
        self.gain, self.lag, self.offset = np.eye(6), np.zeros((6, 6)), np.zeros(6)
        self.unfelt: Array = np.zeros((6, 6))
        self.linear = [_near_rest(one, craft) for one in effects]
        for acts, one in zip(effects, self.linear, strict=True):
            gain, lag = one.steady
            self.lag = gain @ self.lag + lag @ self.gain
            # What the firmware filters goes to its attitude estimator as well.
            own = np.zeros((6, 6)) if acts.effect.on_board else lag
            self.unfelt = gain @ self.unfelt + own @ self.gain
            self.offset = gain @ self.offset + one.offset
            self.gain = gain @ self.gain
        self.undo: Array = np.linalg.inv(self.gain).astype(np.float64)
        left, _, right = np.linalg.svd(self.gain[RATES, RATES])
        self.turn = (left @ right).T

    @property
    def gyro_lag(self) -> Array:
        """(3, 3) s in body axes: how far the true rate is ahead of the gyro on a ramp."""
        return (self.undo @ self.lag)[RATES, RATES]

    def true(self, gyro: Array, force: Array) -> tuple[Array, Array]:
        """Rate and specific force (n, 3) in body axes behind what was measured, but for lags."""
        gyro, force = gyro - self.offset[RATES], force - self.offset[FORCES]
        rate, felt = gyro @ self.undo[RATES, RATES].T, force @ self.undo[FORCES, FORCES].T
        if self.undo[RATES, FORCES].any() and np.isfinite(force).all():
            rate += force @ self.undo[RATES, FORCES].T
        if self.undo[FORCES, RATES].any():
            felt += gyro @ self.undo[FORCES, RATES].T
        return rate, felt

    def turning(self, gyro: Array, slope: Array, lagging: float) -> Array:
        """Rate (m, 3) in sensor axes behind a gyro and its slope, as reported angles turn.

        lagging: share of the gyro's lag that these angles do not have themselves.
        """
        undo = self.undo[RATES, RATES]
        found = (gyro - self.offset[RATES]) @ (self.turn.T @ undo).T
        if lagging and self.unfelt.any():
            found += lagging * slope @ (self.turn.T @ undo @ self.unfelt[RATES, RATES] @ undo).T
        return np.asarray(found)

    def lean(self, force: Array, first: int, period_s: float) -> Array | None:
        """How far reported roll, pitch and yaw (n, 3) are off by a specific force (n, 3) in body
        axes, rad; None: not at all. first: the row at which that has settled.

        An estimator knows the sensor's axes alone: of thrust along another axis than the sensor's
        it takes the part across for a push.
        """
        found = None
        for one in self.estimators:
            near = _estimator_near_rest(one, self.craft)
            more = behind_sensor(near, FORCES, force @ self.turn, first, period_s)
            more[:first] = 0.0
            found = more if found is None else found + more
        return found

    def shown(self, given: Passing, moving: Moving) -> list[Passing]:
        """``given``, and what passes each sensor on."""
        found = [given]
        for one, near in zip(self.effects, self.linear, strict=True):
            found.append(_passed(one, near, self.craft, found[-1], moving))
        return found

    def read(self, shown: Passing, moving: Moving) -> tuple[Array, Array]:
        """Angular acceleration and specific force (n, 3) as a recording has them."""
        count, period = len(moving), moving.period_s
        angular, force = stacked(shown.angular, count), stacked(shown.force, count)
        if self.gyro_filter_hz:
            within = moving.within
            angular = behind_firmware(angular, self.gyro_filter_hz, period, True, within)
        if self.accelerometer_filter_hz:
            force = self._force_filtered(force, period)
        return angular, force

    def in_body(
        self, angular: Array, force: Array, shown: Passing, period_s: float
    ) -> tuple[Array, Array]:
        """Angular acceleration and specific force (n, 3) in body axes that readings stand for."""
        if not self.effects:
            return angular, force
        force = force - self.offset[FORCES]
        found = _turned(angular, self.undo[RATES, RATES])
        felt = _turned(force, self.undo[FORCES, FORCES])
        if self.undo[RATES, FORCES].any():
            slope = np.diff(force, axis=0, prepend=force[:1]) / period_s
            found = found + slope @ self.undo[RATES, FORCES].T
        if self.undo[FORCES, RATES].any():
            now = stacked(shown.rate, len(angular)) + 0.5 * period_s * angular
            felt = felt + (now - self.offset[RATES]) @ self.undo[FORCES, RATES].T
        return found, felt

    def answer(self, values: Array, part: slice, moving: Moving, behind: int = 0) -> Array:
        """What small changes (n, 3) of angular acceleration or force become in a recording.

        behind: how many of the sensors they have passed already.
        """
        if part == RATES and self.gyro_filter_hz:
            values = behind_firmware(values, self.gyro_filter_hz, moving.period_s, True)
        elif part == FORCES and self.accelerometer_filter_hz:
            values = self._force_filtered(values, moving.period_s)
        matrix = np.eye(3)
        for near in self.linear[behind:]:
            if near.c[part].any():
                given = _turned(values, matrix)
                values = behind_sensor(near, part, given, moving.first, moving.period_s)
                matrix = np.eye(3)
            else:
                matrix = near.d[part, part] @ matrix
        return _turned(values, matrix)

    def _force_filtered(self, force: Array, period_s: float) -> Array:
        """Forces (n, 3) with those in the rotors' plane behind the filter.

        Not along z: what is fast there is less thrust than the noise of modelled and measured rotor
        speeds, and behind the filter it would say how late everything is.
        """
        found = behind_firmware(force, self.accelerometer_filter_hz, period_s, False)
        found[:, 2] = force[:, 2]
        return found

    def feel_alike(self, other: Sensors) -> bool:
        """Whether the two tell the same specific force, and the same angles by it."""
        one, two = (
            np.column_stack([x.undo[FORCES], x.turn, x.offset[FORCES]]) for x in (self, other)
        )
        same = self.estimators == other.estimators
        return same and np.allclose(one, two, rtol=0.0, atol=SAME)

    def alike(self, other: Sensors) -> bool:
        """Whether reported angles turn alike behind the two."""
        one, two = (
            np.column_stack(
                [x.turn.T @ x.undo[RATES, RATES], x.unfelt[RATES, RATES], x.offset[RATES]]
            )
            for x in (self, other)
        )
        same = self.estimators == other.estimators
        return same and np.allclose(one, two, rtol=0.0, atol=SAME)


def _turned(values: Array, matrix: NDArray[Any]) -> Array:
    if np.abs(matrix - np.eye(3)).max() < SAME:
        return values
    return values @ matrix.T


@lru_cache(maxsize=256)
def _near_rest(one: Acting, craft: Craft) -> NearRest:
    states = len(one.effect.states)

    def shown(x: Array) -> Array:
        numbers = x.tolist()
        reading = Reading(tuple(numbers[RATES]), tuple(numbers[FORCES]), _FOUR)
        if not states:
            found = one.effect.law(one.values, craft, REST, reading)
            return np.array([*found.gyro, *found.accelerometer])
        found, slopes = one.effect.law(one.values, craft, REST, reading, tuple(numbers[6:]))
        return np.array([*found.gyro, *found.accelerometer, *slopes])

    steps = PROBE * np.eye(6 + states)
    slopes = np.stack([(shown(e) - shown(-e)) / (2.0 * PROBE) for e in steps], axis=1)
    still = shown(np.zeros(6 + states))
    a, c, offset = slopes[6:, 6:], slopes[:6, 6:], still[:6]
    if states:
        offset = offset - c @ solved(a, still[6:])
    return NearRest(a, slopes[6:, :6], c, slopes[:6, :6], offset)


@lru_cache(maxsize=256)
def _estimator_near_rest(one: Acting, craft: Craft) -> NearRest:
    """An effect that turns reported angles, which are what it shows of forces."""
    near = _near_rest(one, craft)
    shown = np.zeros((6, len(one.effect.states)))
    for place, state in enumerate(one.effect.states):
        if state.turns:
            shown[FORCES][ANGLES.index(state.turns), place] = 1.0
    return replace(near, c=shown, d=np.zeros((6, 6)), offset=np.zeros(6))


def passed(one: Acting | None, craft: Craft, given: Passing, moving: Moving) -> Passing:
    """What a sensor passes on."""
    if one is None or one.effect.role is Role.ESTIMATE:
        return given
    return _passed(one, _near_rest(one, craft), craft, given, moving)


def _passed(one: Acting, near: NearRest, craft: Craft, given: Passing, moving: Moving) -> Passing:
    if one.effect.states:
        return _remembered(near, given, moving)
    half = 0.5 * moving.period_s
    now = tuple(r + half * a for r, a in zip(given.rate, given.angular, strict=True))
    shown = one.law(craft, moving.now, Reading(now, given.force, moving.now.rotor))
    if shown.gyro is now:
        return replace(given, force=shown.accelerometer)
    earlier = tuple(r - half * a for r, a in zip(given.rate, given.angular, strict=True))
    reading = Reading(earlier, one_before(given.force), moving.before.rotor)
    pairs = list(zip(shown.gyro, one.law(craft, moving.before, reading).gyro, strict=True))
    rate = tuple(0.5 * (late + early) for late, early in pairs)
    angular = tuple((late - early) / moving.period_s for late, early in pairs)
    return Passing(rate, angular, shown.accelerometer)


def _remembered(near: NearRest, given: Passing, moving: Moving) -> Passing:
    """A sensor with states, as the linear filter that it is near rest."""
    (gain, lag), count = near.steady, len(moving)
    angular, force = stacked(given.angular, count), stacked(given.force, count)
    rate = stacked(given.rate, count) @ gain[RATES, RATES].T - angular @ lag[RATES, RATES].T
    if near.c[RATES].any():
        angular = _filtered_rates(near, angular, moving)
    if near.c[FORCES].any():
        force = behind_sensor(near, FORCES, force, moving.first, moving.period_s)
    rows = (np.ascontiguousarray(part.T) for part in (rate, angular, force))
    return Passing(*(tuple(part) for part in rows))


def _filtered_rates(near: NearRest, angular: Array, moving: Moving) -> Array:
    """Slopes of rates (n, 3) behind a sensor, which sees those within a row as well."""
    if moving.within is None:
        return behind_sensor(near, RATES, angular, moving.first, moving.period_s)
    halves = np.stack([angular - 0.5 * moving.within, angular + 0.5 * moving.within], axis=1)
    finer = behind_sensor(
        near, RATES, halves.reshape(-1, 3), 2 * moving.first, 0.5 * moving.period_s
    )
    return finer.reshape(-1, 2, 3).mean(axis=1)
