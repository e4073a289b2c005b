"""One flight at one point of the search: how the model moves, what is shown, what is left."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from groundstation.dynamics.effect import SPIN, Craft, Key, Stage
from groundstation.identification.flight import FIRMWARE_GAIN, Flight, mean_between
from groundstation.identification.likelihood.motion import (
    BODY_KEYS,
    MOTOR_KEYS,
    SENSOR_LAG,
    STILL,
    TIMING,
    Acting,
    BodyRows,
    Frame,
    Inputs,
    Motion,
    acting,
    before,
    in_order,
    spin_rotors,
    stacked,
    value,
)
from groundstation.identification.likelihood.sensing import (
    FORCES,
    RATES,
    Moving,
    Passing,
    Sensors,
    passed,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

# The model is the laws of the effects that act (``dynamics/effects``) on rows of motion, gyro and
# accelerometer in body axes. Whatever multiplies a rate or a velocity uses one that was predicted
# from earlier rows.


Columns = dict[int, Array]
"""Channel (0..8: gyro, accelerometer, angles) -> rows."""

Bodies = tuple[BodyRows, BodyRows]
"""Rows of a model over the period before each row, and at the row."""
Moved = dict[str, Acting | None]
"""Effects in the place of others, by their variant's label; None: absent."""

GYRO, ACCELEROMETER, ATTITUDE = 0, 3, 6
"""First channels."""
ANGLES = ("roll", "pitch", "yaw")
ROUNDING = 1e-12
"""Of a model's largest values."""


class Felt(NamedTuple):
    """What sensors that are known tell of a craft: rate and specific force (n, 3) in body axes, and
    how far an estimator turns the reported angles (n, 3), rad; None: it does not."""

    gyro: Array
    force: Array
    off: Array | None


class Evaluation:
    """One flight at one point; every array here covers all rows of the run."""

    def __init__(
        self,
        flight: Flight,
        frame: Frame,
        point: Mapping[str, float],
        channels: Container[int] = range(9),
    ) -> None:
        self.flight, self.frame, self.point = flight, frame, point
        run = flight.run
        rates, forces, angles = (
            any(first + axis in channels for axis in range(3))
            for first in (GYRO, ACCELEROMETER, ATTITUDE)
        )
        forces = forces and flight.has_accelerometer
        self.parts = [part for part, one in ((RATES, rates), (FORCES, forces)) if one]
        self.rows_of_attitude = flight.attitude if angles else None
        self.period = run.period_s
        self.there = frame.acting(point)
        self.craft = frame.craft(point)
        self.sides: dict[str, tuple[Moved, Moved, float]] = {}
        """By unknown, as ``both_sides`` has them."""
        self._sensors: dict[tuple[Acting, ...], Sensors] = {}
        self.sensors = self.sensors_with({})
        self.lean = attitude_gain(self.effects("attitude"))
        self.felt = self.feel(self.sensors)
        self.motion = self.moves(self.sensors, self.felt)
        self.delay = sum(one.law() for one in self.effects("delay"))
        self.rotors = spin_rotors(flight, point, frame)
        self.inputs = Inputs.of(self.rotors, self.delay, self.period)
        self.halves: tuple[Inputs, ...] = ()
        if self.rotors.halves is not None:
            self.halves = Inputs.of_halves(self.rotors.halves, self.delay, self.period)
        self.equal = [
            self.motion.thrust(self.craft, self.inputs, mean=mean) for mean in (False, True)
        ]
        # Rates need the model's acceleration and the model needs rates: the first pass takes
        # the last row's, the second the filter's.
        self.motion.follow(self.felt.gyro)
        self._model()
        self.find_rates(frame.rate_gain)
        if self.effects("body") or self.effects("sensor"):
            self._model()
            self.find_rates(frame.rate_gain)
            self._model()
        else:
            self._turn()
        self.angular_peak = float(np.abs(self.angular_read).max())

    def sensors_with(self, moved: Moved) -> Sensors:
        effects = self.effects("sensor", moved)
        if effects not in self._sensors:
            filters = self.frame.gyro_filter_hz, self.frame.accelerometer_filter_hz
            self._sensors[effects] = Sensors(effects, self.craft, filters)
        return self._sensors[effects]

    def feel(self, sensors: Sensors) -> Felt:
        run, off = self.flight.run, None
        gyro, force = sensors.true(run.gyro, run.accelerometer)
        if self.flight.attitude is not None and self.flight.has_accelerometer:
            off = sensors.lean(force, max(self.flight.first - 1, 0), self.period)
        return Felt(gyro, force, off)

    def moves(self, sensors: Sensors, felt: Felt) -> Motion:
        """How the craft moves by what its sensors say of it; rates are not known yet."""
        true = None if felt.off is None else self.flight.run.attitude - felt.off
        return Motion(self.flight, felt.force, sensors.turn, true, leaning=self.lean > 0.0)

    def effects(self, stage: Stage, moved: Moved | None = None) -> tuple[Acting, ...]:
        """The effects of a stage; moved: others in the place of some."""
        there = self.there if not moved else {**self.there, **moved}
        return in_order((one for one in there.values() if one is not None), stage)

    def find_rates(self, gain: tuple[float, float, float]) -> tuple[float, float, float]:
        """Predict the rates from the rows before; the mean squared error (3,)."""
        angular, _ = self.sensors.in_body(
            self.angular_read, self.force_read, self.passing[-1], self.period
        )
        return self.motion.predict(self.felt.gyro, angular, gain, self.sensors.gyro_lag)

    # The model.

    def model_rows(
        self,
        mean: bool,
        moved: Moved | None = None,
        craft: Craft | None = None,
        inputs: Inputs | None = None,
        body: tuple[Acting, ...] | None = None,
        motion: Motion | None = None,
    ) -> BodyRows:
        wrench, given = self.equal[mean], (craft or self.craft, inputs or self.inputs)
        if craft is not None or inputs is not None:
            wrench = self.motion.thrust(*given, mean=mean)
        rotor, body = (
            self.effects("rotor", moved),
            self.effects("body", moved) if body is None else body,
        )
        return (motion or self.motion).body(*given, wrench, rotor, body, mean=mean)

    def bodies(self, moved: Moved | None = None, **other: Any) -> Bodies:
        return self.model_rows(True, moved, **other), self.model_rows(False, moved, **other)

    def _model(self) -> None:
        """The model where the effects are as they are: ``middle`` over the period before each
        row, ``row`` at the row, and what the sensors make of the two."""
        self.middle, self.row = self.bodies()
        self.within = self._within()
        self.moving, self.passing = self.sensed(self.middle, self.row)
        self.angular_read, self.force_read = self.sensors.read(self.passing[-1], self.moving)

    def _turn(self) -> None:
        """The same where only the rates are others, and the model does not depend on them."""
        self.middle, self.row = map(self.motion.turning, (self.middle, self.row))
        self.moving, self.passing = self.sensed(self.middle, self.row)

    def _within(self) -> Array | None:
        """How angular acceleration (n, 3) differs between the halves of each row's period: the
        filter behind the gyro sees when a torque acted."""
        if not self.halves:
            return None
        count = len(self.flight.run)
        first, second = (
            stacked(self.model_rows(True, inputs=half).angular, count) for half in self.halves
        )
        return second - first

    def sensed(self, middle: BodyRows, row: BodyRows) -> tuple[Moving, list[Passing]]:
        first = max(self.flight.first - 1, 0)
        moving = Moving(self.motion.at_rows(row), self.period, first, self.within)
        given = Passing(row.rate, middle.angular, row.force)
        return moving, self.sensors.shown(given, moving)

    @cached_property
    def turned(self) -> Array:
        """``turning`` as the point has it."""
        return self.turning(self.sensors, self.lean, self.felt.off)

    def turning(self, sensors: Sensors, lean: float, off: Array | None) -> Array:
        """Euler rates (m, 3) with which the reported angles should turn, on their fresh rows.

        Behind a lag the rate is ahead of the gyro by the lag times its slope. The measured
        slope: the model's lacks what disturbances do, which the controller answers, and the
        noise of a difference is not in the mean of the same rows. A filter at the firmware's gain
        makes the angles of this very gyro, whose lag is then in both.
        """
        rows = self.flight.attitude
        assert rows is not None
        found = sensors.turning(rows.gyro, rows.slope, 1.0 - lean / FIRMWARE_GAIN)
        today = self.frame.vehicle.accelerometer_filter_hz > 0.0
        leaning = rows.lean_as_read if today else rows.lean
        found = found + self.point.get(TIMING, 0.0) * rows.timing + lean * leaning
        euler = rows.euler_rates(found)
        if off is not None:
            ends = rows.first + rows.stride * np.arange(len(euler))
            euler += (off[ends] - off[ends - rows.stride]) / (rows.stride * self.period)
        return euler

    # What is read of it.

    def as_read(self, part: slice, values: Array) -> Array:
        """Modelled rates or forces (n, 3) as the recording's rows have them."""
        between = part == FORCES and self.flight.force_between
        return mean_between(values) if between else values

    def put(self, part: slice, out: Columns, values: Array, step: float = math.inf) -> None:
        """Store rows (n, 3) of the gyro's (RATES) or the accelerometer's channels (FORCES), but
        not what is only the rounding of a difference over ``step``."""
        gaps, rows = self.flight.gaps, values[self.flight.rows]
        rows = gaps.spread(rows) if part == RATES else gaps.bridge(rows)
        least = ROUNDING * (self.angular_peak if part == RATES else STANDARD_GRAVITY) / abs(step)
        for axis in range(3):
            one = rows[:, axis]
            if (np.abs(one[:1000]) > least).any() or (np.abs(one) > least).any():
                out[part.start + axis] = one.copy()

    def put_attitude(self, out: Columns, rates: Array, step: float = math.inf) -> None:
        """Store Euler rates (m, 3)."""
        rows, least = self.rows_of_attitude, ROUNDING / abs(step)
        assert rows is not None
        euler = rows.where_told(rates)
        for axis in range(3):
            if (np.abs(euler[:, axis]) > least).any():
                out[ATTITUDE + axis] = euler[:, axis]

    def stage(self, key: str) -> Stage | None:
        """Where an unknown acts; None: it is one of the base model's."""
        one = self.frame.unknowns.get(key)
        return None if one is None else one.effect.stage


def attitude_gain(effects: Sequence[Acting]) -> float:
    """Proportional gain of an attitude filter, 1/s."""
    return float(sum(one.law()[0] for one in effects))


# What each unknown would add to a flight's residuals: differences of the model's laws over a step.
#
# The result of every column is d model / d key, on the channels that it reaches.


BASE_STEPS = {"a0": 1e-3, "a1": 1e-3, "a2": 1e-2} | dict.fromkeys(BODY_KEYS, 1e-4)
"""Steps of the differences, over the constant."""
SENSOR_STEP_S = 1e-3


def column(at: Evaluation, key: str) -> Columns:
    """The column of an unknown at the evaluation's point."""
    out: Columns = {}
    stage = at.stage(key)
    if key == TIMING:
        rows = at.rows_of_attitude
        if rows is not None:
            at.put_attitude(out, rows.euler_rates(rows.timing))
    elif key in BODY_KEYS:
        _craft_column(at, key, out)
    elif key == SENSOR_LAG:
        _rotors_column(at, key, SENSOR_STEP_S, out)
    elif key in MOTOR_KEYS:
        if at.point[key] != 0.0:
            _rotors_column(at, key, BASE_STEPS[key] * at.point[key], out)
    elif stage in ("supply", "motor"):
        one = at.frame.unknowns[key]
        toward = one.parameter.to_unknown(one.parameter.default) - one.absent
        _rotors_column(at, key, math.copysign(one.step, toward), out)
    else:
        COLUMNS[str(stage)](at, out, *both_sides(at, at.frame.unknowns[key]))
    return out


def both_sides(at: Evaluation, one: Key) -> tuple[Moved, Moved, float]:
    """Effects on both sides of an unknown's value, or on that which its bounds allow, and
    how far they are apart. Of a sensor, whose law is as good as straight, above the value and at
    it, where it is evaluated."""
    if one.key in at.sides:
        return at.sides[one.key]
    now, variant = value(at.point, one.key), at.frame.variants[one.key]
    here = at.stage(one.key) == "sensor" or now - one.step < one.bounds[0]
    low = now if here else now - one.step
    high = now + one.step
    ends = (
        {variant.label: acting(variant.unknowns, {**at.point, one.key: end})} for end in (high, low)
    )
    at.sides[one.key] = next(ends), next(ends), high - low
    return at.sides[one.key]


def _put_change(at: Evaluation, out: Columns, high: Bodies, low: Bodies, step: float) -> None:
    """Store the difference of two models over a step."""
    for part in at.parts:
        rows = _change(at, part, high, low, step)
        if rows is not None:
            at.put(part, out, at.as_read(part, rows), step)


def _change(at: Evaluation, part: slice, high: Bodies, low: Bodies, step: float) -> Array | None:
    """The difference (n, 3) of two models over a step, as it is read; None: they are one."""
    above, below = (both[0].angular if part == RATES else both[1].force for both in (high, low))
    change = tuple((a - b) / step for a, b in zip(above, below, strict=True))
    if not any(np.ndim(rows) or rows for rows in change):
        return None
    return at.sensors.answer(stacked(change, len(at.flight.run)), part, at.moving)


def _craft_column(at: Evaluation, key: str, out: Columns) -> None:
    """Above the value and at it: forces and torques are straight in these."""
    step = BASE_STEPS[key] * at.point[key]
    craft = at.frame.craft({**at.point, key: at.point[key] + step})
    middle, row = at.model_rows(True, craft=craft), at.row
    if FORCES in at.parts and craft.thrust != at.craft.thrust:
        row = at.model_rows(False, craft=craft)
    _put_change(at, out, (middle, row), (at.middle, at.row), step)


def _rotors_column(at: Evaluation, key: str, step: float, out: Columns) -> None:
    if at.flight.rotor_measured != (key == SENSOR_LAG):
        return
    moved = {**at.point, key: value(at.point, key) + step}
    inputs = Inputs.of(spin_rotors(at.flight, moved, at.frame), at.delay, at.period)
    middle, row = at.model_rows(True, inputs=inputs), at.row
    if FORCES in at.parts or at.sensors.effects:
        row = at.model_rows(False, inputs=inputs)
    moving, passing = at.sensed(middle, row)
    angular, force = at.sensors.read(passing[-1], moving)
    if RATES in at.parts:
        at.put(RATES, out, (angular - at.angular_read) / step, step)
    if FORCES in at.parts:
        at.put(FORCES, out, at.as_read(FORCES, force - at.force_read) / step, step)


def _delay_column(at: Evaluation, out: Columns, high: Moved, low: Moved, step: float) -> None:
    delays = (sum(one.law() for one in at.effects("delay", m)) for m in (high, low))
    late, early = (at.bodies(inputs=Inputs.of(at.rotors, delay, at.period)) for delay in delays)
    _put_change(at, out, late, early, step)


def _rotor_column(at: Evaluation, out: Columns, high: Moved, low: Moved, step: float) -> None:
    above, below = (at.bodies(moved, body=()) for moved in (high, low))
    _put_change(at, out, above, below, step)


def _body_column(at: Evaluation, out: Columns, high: Moved, low: Moved, step: float) -> None:
    ends_of = (*high.values(), *low.values())
    if any(one is not None and one.effect.order > 0 for one in ends_of):
        # Its law reads what the effects before it add, which the rows' sum is not.
        _put_change(at, out, at.bodies(high), at.bodies(low), step)
        return
    ends = []
    for moved in (high, low):
        bodies = []
        for body, mean in ((at.middle, True), (at.row, False)):
            angular, force = STILL, STILL
            for one in moved.values():
                if one is not None:
                    angular, force = one.body_law(at.craft, body, at.period, mean)
            bodies.append(body._replace(angular=angular, force=force))
        ends.append((bodies[0], bodies[1]))
    _put_change(at, out, ends[0], ends[1], step)


def _sensor_column(at: Evaluation, out: Columns, high: Moved, low: Moved, step: float) -> None:
    """What a sensor shows otherwise, and what it then says of the craft's motion and attitude.
    low: the effects as they are."""
    if all(one is None for one in (*high.values(), *low.values())):
        return  # the shape of an absent one
    sensors, felt = at.sensors_with(high), at.felt
    if not sensors.feel_alike(at.sensors):
        felt = at.feel(sensors)
    answers = felt is not at.felt and (at.effects("rotor") or at.effects("body"))
    motion = at.moves(sensors, felt).with_rates_of(at.motion) if answers else None
    bodies = at.bodies(motion=motion) if motion else None
    for part, found in zip(at.parts, _shown_otherwise(at, high, low, step), strict=True):
        if bodies is not None:  # the model answers to the velocity and attitude that these tell
            more = _change(at, part, bodies, (at.middle, at.row), step)
            found = more if found is None or more is None else found + more
        if found is not None:
            at.put(part, out, at.as_read(part, found), step)
    if at.rows_of_attitude is not None and (felt is not at.felt or not sensors.alike(at.sensors)):
        turned = at.turning(sensors, at.lean, felt.off)
        at.put_attitude(out, (turned - at.turned) / step, step)


def _shown_otherwise(at: Evaluation, high: Moved, low: Moved, step: float) -> list[Array | None]:
    """How differently a sensor shows the same motion on both sides, over a step, (n, 3) of each
    part; None where it does not."""
    (label,) = high
    one = high[label] or low[label]
    assert one is not None
    behind = sum(before(e, one) for e in at.sensors.effects)
    after = behind + (at.there.get(label) is not None)
    above, below = (
        passed(moved[label], at.craft, at.passing[behind], at.moving) for moved in (high, low)
    )
    found: list[Array | None] = []
    for part in at.parts:
        a, b = (ends.angular if part == RATES else ends.force for ends in (above, below))
        change = None
        if a is not b:
            rows = tuple((x - y) / step for x, y in zip(a, b, strict=True))
            change = at.sensors.answer(stacked(rows, len(at.flight.run)), part, at.moving, after)
        found.append(change)
    return found


def _attitude_column(at: Evaluation, out: Columns, high: Moved, low: Moved, step: float) -> None:
    if at.rows_of_attitude is not None:
        gains = (attitude_gain(at.effects("attitude", moved)) for moved in (high, low))
        above, below = (at.turning(at.sensors, gain, at.felt.off) for gain in gains)
        at.put_attitude(out, (above - below) / step, step)


COLUMNS = {
    "delay": _delay_column,
    "rotor": _rotor_column,
    "body": _body_column,
    "sensor": _sensor_column,
    "attitude": _attitude_column,
}
"""By the stage of an effect."""


# What a model leaves unexplained in a flight, row by row, and what each unknown would add to it.
#
# One-step residuals, not free runs (docs/discrepancy.md has the equations):
#
# - gyro: mean angular acceleration between two rows, measured less modelled, rad/s^2;
# - accelerometer: specific force, m/s^2;
# - attitude, on its fresh rows: Euler rate less the kinematics of the measured gyro, rad/s;
# - vertical: a flight's mean vertical specific force less 1 g, one number.


MAKING_FORCE = (None, "supply", "motor", "rotor", "body")
"""Stages that make the force itself, not how or when the accelerometer shows it."""


@dataclass(slots=True)
class Series:
    """Residuals and columns of one flight at one point.

    residual: channel -> rows. columns: key -> channel -> rows, d model / d key. vertical, lift:
    (residual, {key: derivative}) of the flight's mean vertical specific force less 1 g, as
    measured and as modelled, None without accelerometer or attitude. lasting: channel
    -> (k, rows), what a moment that never changes does, of 1 rad/s^2, or offsets of the gyro's
    axes, of 1 rad/s.
    """

    residual: Columns
    columns: dict[str, Columns]
    vertical: tuple[float, dict[str, float]] | None
    lift: tuple[float, dict[str, float]] | None
    lasting: Columns


def evaluate(
    flight: Flight,
    frame: Frame,
    point: Mapping[str, float],
    keys: Sequence[str],
    channels: Container[int] = range(9),
) -> Series:
    """Residuals of a flight at ``point`` and the columns of ``keys``.

    channels: what is asked for; the vertical rows belong to the accelerometer's. A sensor of which
    no channel is wanted is left out, one axis more of a wanted one may come along.
    """
    return series_of(Evaluation(flight, frame, point, channels), keys)


def series_of(at: Evaluation, keys: Sequence[str]) -> Series:
    """``evaluate`` of a flight whose model is evaluated at a point."""
    residual: Columns = {}
    run = at.flight.run
    if RATES in at.parts:
        measured = np.diff(run.gyro, axis=0, prepend=run.gyro[:1]) / at.period
        at.put(RATES, residual, measured - at.angular_read)
    if FORCES in at.parts:
        modelled = at.as_read(FORCES, at.force_read)
        at.put(FORCES, residual, run.accelerometer - modelled)
    lasting = {i: np.ones((1, len(residual[i]))) for i in range(3) if i in residual}
    rows = at.rows_of_attitude
    if rows is not None:
        modelled = at.turning(at.sensors, at.lean, at.felt.off)
        euler = rows.where_told(rows.rate - modelled)
        residual.update({ATTITUDE + i: euler[:, i] for i in range(3)})
        told = rows.where_told(rows.to_euler)
        lasting |= {ATTITUDE + i: np.ascontiguousarray(told[:, i].T) for i in range(3)}
    columns = {key: column(at, key) for key in keys}
    up = (_vertical(at, keys), _lift(at, columns)) if FORCES in at.parts else (None, None)
    return Series(residual, columns, *up, lasting)


def rate_errors(
    flight: Flight, frame: Frame, point: Mapping[str, float], gains: Sequence[float]
) -> Array:
    """Mean squared one-step prediction errors (gains, 3) of the rates, (rad/s)^2."""
    evaluation = Evaluation(flight, frame, point)
    return np.array([evaluation.find_rates((gain, gain, gain)) for gain in gains])


def generic_signals(flight: Flight, frame: Frame, point: Mapping[str, float]) -> dict[str, Array]:
    """Signals (n,) that something unknown may go with: words -> values at every row."""
    at = Evaluation(flight, frame, point)
    middle = at.middle
    p, q, r = middle.rate
    w, spun = (
        sum(sign * one for sign, one in zip(SPIN, rows, strict=True))
        for rows in (middle.rotor, middle.rotor_slope)
    )
    found = {"a constant": np.ones(len(p))}
    for name, rate in zip(ANGLES, (p, q, r), strict=True):
        found[f"the {name} rate"] = rate
        found[f"the {name} rate times its magnitude"] = rate * np.abs(rate)
    found["pitch rate times yaw rate"] = q * r
    found["roll rate times yaw rate"] = p * r
    found["roll rate times pitch rate"] = p * q
    plain = at.model_rows(mean=True, body=())
    for name, torque in zip(ANGLES, plain.angular, strict=True):
        found[f"the {name} torque"] = torque
    found["the total thrust"] = plain.thrust
    found["the change of thrust"] = np.diff(plain.thrust, prepend=plain.thrust[:1])
    found["the rotors' acceleration"] = spun
    found["pitch rate times rotor speeds"] = q * w
    found["roll rate times rotor speeds"] = p * w
    if at.flight.up is not None:
        for name, speed in zip(("forward", "leftward", "upward"), middle.velocity, strict=True):
            found[f"the {name} velocity"] = speed
        found["the roll angle"] = np.sin(at.flight.run.attitude[:, 0])
        found["the pitch angle"] = np.sin(at.flight.run.attitude[:, 1])
    return found


def _vertical(at: Evaluation, keys: Sequence[str]) -> tuple[float, dict[str, float]] | None:
    """The mean vertical force as measured, less what the accelerometer adds, less 1 g."""
    if at.flight.up is None:
        return None
    up, mean = at.flight.up
    slopes: dict[str, float] = {}
    for key in keys:
        if at.stage(key) == "sensor":
            high, _, step = both_sides(at, at.frame.unknowns[key])
            change = at.sensors_with(high).offset - at.sensors.offset
            slope = float(up @ change[FORCES]) / step
            slopes |= {key: slope} if slope else {}
    return mean - float(up @ at.sensors.offset[FORCES]) - STANDARD_GRAVITY, slopes


def _lift(at: Evaluation, columns: Mapping[str, Columns]) -> tuple[float, dict[str, float]] | None:
    """1 g less what the model says of the mean vertical force while airborne."""
    if at.flight.up is None:
        return None
    up = at.flight.upward @ at.sensors.turn.T
    _, force = at.sensors.in_body(at.angular_read, at.force_read, at.passing[-1], at.period)
    mean = float(np.einsum("ni,ni->n", up, force[at.flight.rows]).mean())
    up = up @ at.sensors.undo[FORCES, FORCES]
    slopes = {
        key: float(sum((up[:, c - 3] * v).mean() for c, v in rows.items() if 3 <= c < 6))
        for key, rows in columns.items()
        if at.stage(key) in MAKING_FORCE
    }
    return STANDARD_GRAVITY - mean, slopes
