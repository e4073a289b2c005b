"""What a model leaves unexplained in a flight, row by row, and what each unknown would add to it.

One-step residuals, not free runs (docs/discrepancy.md has the equations):

- gyro: mean angular acceleration between two rows, measured less modelled, rad/s^2;
- accelerometer: specific force, m/s^2;
- attitude, on its fresh rows: Euler rate less the kinematics of the measured gyro, rad/s;
- vertical: a flight's mean vertical specific force less 1 g, one number.

The model is the laws of the effects that act (``dynamics/effects``) on rows of motion, gyro and
accelerometer in body axes; columns are differences of these laws. Whatever multiplies a rate or a
velocity uses one that was predicted from earlier rows.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effect import Stage
from groundstation.dynamics.law import SPIN, Craft
from groundstation.dynamics.unknowns import Key
from groundstation.identification.attitude_rows import FIRMWARE_GAIN
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.laws import Acting, acting, before, in_order
from groundstation.identification.likelihood.motion import STILL, BodyRows, Inputs, Motion, stacked
from groundstation.identification.likelihood.parameters import (
    BODY_KEYS,
    MOTOR_KEYS,
    SENSOR_LAG,
    TIMING,
    value,
)
from groundstation.identification.likelihood.rotors import Rotors, spin_rotors
from groundstation.identification.likelihood.sensing import (
    FORCES,
    RATES,
    Moving,
    Passing,
    Sensors,
    passed,
)
from groundstation.identification.read_between import mean_between
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]
Columns = dict[int, Array]
"""Channel (0..8 as in ``comparison.channels``) -> rows."""

Bodies = tuple[BodyRows, BodyRows]
"""Rows of a model over the period before each row, and at the row."""
Moved = dict[str, Acting | None]
"""Effects in the place of others, by their variant's label; None: absent."""

GYRO, ACCELEROMETER, ATTITUDE = 0, 3, 6
"""First channels."""
ANGLES = ("roll", "pitch", "yaw")
BASE_STEPS = {"a0": 1e-3, "a1": 1e-3, "a2": 1e-2} | dict.fromkeys(BODY_KEYS, 1e-4)
"""Steps of the differences, over the constant."""
SENSOR_STEP_S = 1e-3
ROUNDING = 1e-12
"""Of a model's largest values."""
MAKING_FORCE = (None, "supply", "motor", "rotor", "body")
"""Stages that make the force itself, not how or when the accelerometer shows it."""


class Felt(NamedTuple):
    """What sensors that are known tell of a craft: rate and specific force (n, 3) in body axes, and
    how far an estimator turns the reported angles (n, 3), rad; None: it does not."""

    gyro: Array
    force: Array
    off: Array | None


@dataclass(slots=True)
class Series:
    """Residuals and columns of one flight at one point.

    residual: channel -> rows. columns: key -> channel -> rows, d model / d key. vertical, lift:
    (residual, {key: derivative}) of the flight's mean vertical specific force less 1 g, as
    measured and as modelled, None without accelerometer or attitude. rate_error: (3,)
    mean squared one-step prediction error of the rates in rad/s. lasting: channel -> (k, rows),
    what a moment that never changes does, of 1 rad/s^2, or offsets of the gyro's axes, of 1 rad/s.
    """

    residual: Columns
    columns: dict[str, Columns]
    vertical: tuple[float, dict[str, float]] | None
    lift: tuple[float, dict[str, float]] | None
    rate_error: tuple[float, float, float]
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
    return _Evaluation(flight, frame, point, channels).series(keys)


def rate_errors(
    flight: Flight, frame: Frame, point: Mapping[str, float], gains: Sequence[float]
) -> Array:
    """Mean squared one-step prediction errors (gains, 3) of the rates, (rad/s)^2."""
    evaluation = _Evaluation(flight, frame, point)
    return np.array([evaluation.find_rates((gain, gain, gain)) for gain in gains])


def generic_signals(flight: Flight, frame: Frame, point: Mapping[str, float]) -> dict[str, Array]:
    """Signals (n,) that something unknown may go with: words -> values at every row."""
    return _Evaluation(flight, frame, point).generic()


class _Evaluation:
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
        self._moved: dict[str, tuple[Moved, Moved, float]] = {}
        self.craft = frame.craft(point)
        self.sensors = self._sensors({})
        self.lean = _gain(self.effects("attitude"))
        self.felt = self._felt(self.sensors)
        self.motion = self._motion(self.sensors, self.felt)
        self.delay = sum(one.law() for one in self.effects("delay"))
        self.rotors = self._rotors(point)
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
        self.rate_error = self.find_rates(frame.rate_gain)
        if self.effects("body") or self.effects("sensor"):
            self._model()
            self.find_rates(frame.rate_gain)
            self._model()
        else:
            self._turn()
        self.angular_peak = float(np.abs(self.angular_read).max())

    def _felt(self, sensors: Sensors) -> Felt:
        run, off = self.flight.run, None
        gyro, force = sensors.true(run.gyro, run.accelerometer)
        if self.flight.attitude is not None and self.flight.has_accelerometer:
            off = sensors.lean(force, max(self.flight.first - 1, 0), self.period)
        return Felt(gyro, force, off)

    def _motion(self, sensors: Sensors, felt: Felt) -> Motion:
        """How the craft moves by what its sensors say of it; rates are not known yet."""
        true = None if felt.off is None else self.flight.run.attitude - felt.off
        return Motion(self.flight, felt.force, sensors.turn, true, leaning=self.lean > 0.0)

    def _inputs(self, point: Mapping[str, float]) -> Inputs:
        return Inputs.of(self._rotors(point), self.delay, self.period)

    def _rotors(self, point: Mapping[str, float]) -> Rotors:
        return spin_rotors(self.flight, point, self.frame)

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

    def _body(
        self,
        mean: bool,
        moved: Moved | None = None,
        craft: Craft | None = None,
        inputs: Inputs | None = None,
        body: tuple[Acting, ...] | None = None,
        motion: Motion | None = None,
    ) -> BodyRows:
        wrench = self.equal[mean]
        if craft is not None or inputs is not None:
            wrench = self.motion.thrust(craft or self.craft, inputs or self.inputs, mean=mean)
        return (motion or self.motion).body(
            craft or self.craft,
            inputs or self.inputs,
            wrench,
            self.effects("rotor", moved),
            self.effects("body", moved) if body is None else body,
            mean=mean,
        )

    def _model(self) -> None:
        """The model where the effects are as they are: ``middle`` over the period before each
        row, ``row`` at the row, and what the sensors make of the two."""
        self.middle, self.row = self._bodies()
        self.within = self._within()
        self.moving, self.passing = self._sensed(self.middle, self.row)
        self.angular_read, self.force_read = self.sensors.read(self.passing[-1], self.moving)

    def _within(self) -> Array | None:
        """How angular acceleration (n, 3) differs between the halves of each row's period: the
        filter behind the gyro sees when a torque acted."""
        if not self.halves:
            return None
        count = len(self.flight.run)
        first, second = (
            stacked(self._body(True, inputs=half).angular, count) for half in self.halves
        )
        return second - first

    def _turn(self) -> None:
        """The same where only the rates are others, and the model does not depend on them."""
        self.middle, self.row = map(self.motion.turning, (self.middle, self.row))
        self.moving, self.passing = self._sensed(self.middle, self.row)

    def _sensed(self, middle: BodyRows, row: BodyRows) -> tuple[Moving, list[Passing]]:
        first = max(self.flight.first - 1, 0)
        moving = Moving(self.motion.at_rows(row), self.period, first, self.within)
        given = Passing(row.rate, middle.angular, row.force)
        return moving, self.sensors.shown(given, moving)

    def _turning(self, sensors: Sensors, lean: float, off: Array | None) -> Array:
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

    def generic(self) -> dict[str, Array]:
        """See ``generic_signals``."""
        middle = self.middle
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
        plain = self._body(mean=True, body=())
        for name, torque in zip(ANGLES, plain.angular, strict=True):
            found[f"the {name} torque"] = torque
        found["the total thrust"] = plain.thrust
        found["the change of thrust"] = np.diff(plain.thrust, prepend=plain.thrust[:1])
        found["the rotors' acceleration"] = spun
        found["pitch rate times rotor speeds"] = q * w
        found["roll rate times rotor speeds"] = p * w
        if self.flight.up is not None:
            for name, speed in zip(("forward", "leftward", "upward"), middle.velocity, strict=True):
                found[f"the {name} velocity"] = speed
            found["the roll angle"] = np.sin(self.flight.run.attitude[:, 0])
            found["the pitch angle"] = np.sin(self.flight.run.attitude[:, 1])
        return found

    # Residuals.

    def series(self, keys: Sequence[str]) -> Series:
        residual: Columns = {}
        run = self.flight.run
        if RATES in self.parts:
            measured = np.diff(run.gyro, axis=0, prepend=run.gyro[:1]) / self.period
            self._put(RATES, residual, measured - self.angular_read)
        if FORCES in self.parts:
            modelled = self._as_read(FORCES, self.force_read)
            self._put(FORCES, residual, run.accelerometer - modelled)
        lasting = {i: np.ones((1, len(residual[i]))) for i in range(3) if i in residual}
        rows = self.rows_of_attitude
        if rows is not None:
            modelled = self._turning(self.sensors, self.lean, self.felt.off)
            euler = rows.where_told(rows.rate - modelled)
            residual.update({ATTITUDE + i: euler[:, i] for i in range(3)})
            told = rows.where_told(rows.to_euler)
            lasting |= {ATTITUDE + i: np.ascontiguousarray(told[:, i].T) for i in range(3)}
        columns = {key: self._column(key) for key in keys}
        up = (self._vertical(keys), self._lift(columns)) if FORCES in self.parts else (None, None)
        return Series(residual, columns, *up, self.rate_error, lasting)

    def _vertical(self, keys: Sequence[str]) -> tuple[float, dict[str, float]] | None:
        """The mean vertical force as measured, less what the accelerometer adds, less 1 g."""
        if self.flight.up is None:
            return None
        up, mean = self.flight.up
        slopes: dict[str, float] = {}
        for key in keys:
            if self._stage(key) == "sensor":
                high, low, step = self._ends(self.frame.unknowns[key])
                change = self._sensors(high).offset - self._sensors(low).offset
                slope = float(up @ change[FORCES]) / step
                slopes |= {key: slope} if slope else {}
        return mean - float(up @ self.sensors.offset[FORCES]) - STANDARD_GRAVITY, slopes

    def _lift(self, columns: Mapping[str, Columns]) -> tuple[float, dict[str, float]] | None:
        """1 g less what the model says of the mean vertical force while airborne."""
        if self.flight.up is None:
            return None
        rows = self.flight.rows
        up = self.flight.upward @ self.sensors.turn.T
        _, force = self.sensors.in_body(
            self.angular_read, self.force_read, self.passing[-1], self.period
        )
        mean = float(np.einsum("ni,ni->n", up, force[rows]).mean())
        up = up @ self.sensors.undo[FORCES, FORCES]
        slopes = {
            key: float(sum((up[:, c - 3] * v).mean() for c, v in column.items() if 3 <= c < 6))
            for key, column in columns.items()
            if self._stage(key) in MAKING_FORCE
        }
        return STANDARD_GRAVITY - mean, slopes

    def _as_read(self, part: slice, values: Array) -> Array:
        """Modelled rates or forces (n, 3) as the recording's rows have them."""
        between = part == FORCES and self.flight.force_between
        return mean_between(values) if between else values

    def _put(self, part: slice, out: Columns, values: Array, step: float = math.inf) -> None:
        """Store rows (n, 3) of the gyro's (RATES) or the accelerometer's channels (FORCES), but
        not what is only the rounding of a difference over ``step``."""
        gaps, rows = self.flight.gaps, values[self.flight.rows]
        rows = gaps.spread(rows) if part == RATES else gaps.bridge(rows)
        least = ROUNDING * (self.angular_peak if part == RATES else STANDARD_GRAVITY) / abs(step)
        for axis in range(3):
            one = rows[:, axis]
            if (np.abs(one[:1000]) > least).any() or (np.abs(one) > least).any():
                out[part.start + axis] = one.copy()

    def _put_attitude(self, out: Columns, rates: Array, step: float = math.inf) -> None:
        """Store Euler rates (m, 3)."""
        rows, least = self.rows_of_attitude, ROUNDING / abs(step)
        assert rows is not None
        euler = rows.where_told(rates)
        for axis in range(3):
            if (np.abs(euler[:, axis]) > least).any():
                out[ATTITUDE + axis] = euler[:, axis]

    # Columns.

    def _stage(self, key: str) -> Stage | None:
        """Where an unknown acts; None: it is one of the base model's."""
        one = self.frame.unknowns.get(key)
        return None if one is None else one.effect.stage

    def _column(self, key: str) -> Columns:
        out: Columns = {}
        stage = self._stage(key)
        if key == TIMING:
            rows = self.rows_of_attitude
            if rows is not None:
                self._put_attitude(out, rows.euler_rates(rows.timing))
        elif key in BODY_KEYS:
            self._craft_column(key, out)
        elif key == SENSOR_LAG:
            self._rotors_column(key, SENSOR_STEP_S, out)
        elif key in MOTOR_KEYS:
            if self.point[key] != 0.0:
                self._rotors_column(key, BASE_STEPS[key] * self.point[key], out)
        else:
            one = self.frame.unknowns[key]
            if stage in ("supply", "motor"):
                toward = one.parameter.to_unknown(one.parameter.default) - one.absent
                self._rotors_column(key, math.copysign(one.step, toward), out)
            else:
                columns = {
                    "delay": self._delay_column,
                    "rotor": self._rotor_column,
                    "body": self._body_column,
                    "sensor": self._sensor_column,
                    "attitude": self._attitude_column,
                }
                columns[str(stage)](out, *self._ends(one))
        return out

    def _ends(self, one: Key) -> tuple[Moved, Moved, float]:
        """Effects on both sides of an unknown's value, or on that which its bounds allow, and
        how far they are apart."""
        if one.key not in self._moved:
            now, variant = value(self.point, one.key), self.frame.variants[one.key]
            low = now - one.step if now - one.step >= one.bounds[0] else now
            high = now + one.step
            above, below = (
                {variant.label: acting(variant.unknowns, {**self.point, one.key: end})}
                for end in (high, low)
            )
            self._moved[one.key] = above, below, high - low
        return self._moved[one.key]

    def _sensors(self, moved: Moved) -> Sensors:
        filters = self.frame.gyro_filter_hz, self.frame.accelerometer_filter_hz
        return Sensors(self.effects("sensor", moved), self.craft, filters)

    def _put_change(self, out: Columns, high: Bodies, low: Bodies, step: float) -> None:
        """Store the difference of two models over a step."""
        for part in self.parts:
            rows = self._change(part, high, low, step)
            if rows is not None:
                self._put(part, out, self._as_read(part, rows), step)

    def _change(self, part: slice, high: Bodies, low: Bodies, step: float) -> Array | None:
        """The difference (n, 3) of two models over a step, as it is read; None: they are one."""
        above, below = (both[0].angular if part == RATES else both[1].force for both in (high, low))
        change = tuple((a - b) / step for a, b in zip(above, below, strict=True))
        if not any(np.ndim(rows) or rows for rows in change):
            return None
        return self.sensors.answer(stacked(change, len(self.flight.run)), part, self.moving)

    def _bodies(self, moved: Moved | None = None, **other: Any) -> Bodies:
        return self._body(True, moved, **other), self._body(False, moved, **other)

    def _craft_column(self, key: str, out: Columns) -> None:
        step = BASE_STEPS[key] * self.point[key]
        crafts = [
            self.frame.craft({**self.point, key: self.point[key] + change})
            for change in (step, -step)
        ]
        high, low = (self._body(True, craft=craft) for craft in crafts)
        above, below = self.row, self.row
        if FORCES in self.parts and crafts[0].thrust != crafts[1].thrust:
            above, below = (self._body(False, craft=craft) for craft in crafts)
        self._put_change(out, (high, above), (low, below), 2.0 * step)

    def _rotors_column(self, key: str, step: float, out: Columns) -> None:
        if self.flight.rotor_measured != (key == SENSOR_LAG):
            return
        moved = {**self.point, key: value(self.point, key) + step}
        inputs = self._inputs(moved)
        middle, row = self._body(True, inputs=inputs), self.row
        if FORCES in self.parts or self.sensors.effects:
            row = self._body(False, inputs=inputs)
        moving, passing = self._sensed(middle, row)
        angular, force = self.sensors.read(passing[-1], moving)
        if RATES in self.parts:
            self._put(RATES, out, (angular - self.angular_read) / step, step)
        if FORCES in self.parts:
            self._put(FORCES, out, self._as_read(FORCES, force - self.force_read) / step, step)

    def _delay_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        delays = (sum(one.law() for one in self.effects("delay", m)) for m in (high, low))
        late, early = (
            self._bodies(inputs=Inputs.of(self.rotors, delay, self.period)) for delay in delays
        )
        self._put_change(out, late, early, step)

    def _rotor_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        above, below = (self._bodies(moved, body=()) for moved in (high, low))
        self._put_change(out, above, below, step)

    def _body_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        ends_of = (*high.values(), *low.values())
        if any(one is not None and one.effect.order > 0 for one in ends_of):
            # Its law reads what the effects before it add, which the rows' sum is not.
            self._put_change(out, self._bodies(high), self._bodies(low), step)
            return
        ends = []
        for moved in (high, low):
            bodies = []
            for body, mean in ((self.middle, True), (self.row, False)):
                angular, force = STILL, STILL
                for one in moved.values():
                    if one is not None:
                        angular, force = one.body_law(self.craft, body, self.period, mean)
                bodies.append(body._replace(angular=angular, force=force))
            ends.append((bodies[0], bodies[1]))
        self._put_change(out, ends[0], ends[1], step)

    def _sensor_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        (label,) = high
        there, one = self.there.get(label), high[label] or low[label]
        if one is None:  # the shape of an absent one
            return
        behind = sum(before(e, one) for e in self.sensors.effects)
        shown = [
            passed(moved[label], self.craft, self.passing[behind], self.moving)
            for moved in (high, low)
        ]
        ends = [self._sensors(moved) for moved in (high, low)]
        felt = [self.felt, self.felt]
        if not ends[0].feel_alike(ends[1]):
            felt = [self._felt(sensors) for sensors in ends]
        moved_bodies = self._moved_by(ends, felt)
        for part in self.parts:
            field = "angular" if part == RATES else "force"
            above, below = (getattr(given, field) for given in shown)
            found = None
            if above is not below:
                rows = tuple((a - b) / step for a, b in zip(above, below, strict=True))
                after = behind + (there is not None)
                change = stacked(rows, len(self.flight.run))
                found = self.sensors.answer(change, part, self.moving, after)
            if moved_bodies is not None:
                more = self._change(part, *moved_bodies, step)
                found = more if found is None or more is None else found + more
            if found is not None:
                self._put(part, out, self._as_read(part, found), step)
        if self.rows_of_attitude is not None and not (
            felt[0] is felt[1] and ends[0].alike(ends[1])
        ):
            turning = [
                self._turning(sensors, self.lean, one.off)
                for sensors, one in zip(ends, felt, strict=True)
            ]
            self._put_attitude(out, (turning[0] - turning[1]) / step, step)

    def _moved_by(
        self, ends: Sequence[Sensors], felt: Sequence[Felt]
    ) -> tuple[Bodies, Bodies] | None:
        """The model where sensors, another at each end, tell the velocity and the attitude that it
        answers to; None where it does not, or they tell the same."""
        if felt[0] is felt[1] or not (self.effects("rotor") or self.effects("body")):
            return None
        motions = [self._motion(*one) for one in zip(ends, felt, strict=True)]
        above, below = (
            self._bodies(motion=motion.with_rates_of(self.motion)) for motion in motions
        )
        return above, below

    def _attitude_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        if self.rows_of_attitude is not None:
            gains = (_gain(self.effects("attitude", moved)) for moved in (high, low))
            turning = [self._turning(self.sensors, gain, self.felt.off) for gain in gains]
            self._put_attitude(out, (turning[0] - turning[1]) / step, step)


def _gain(effects: Sequence[Acting]) -> float:
    """Proportional gain of an attitude filter, 1/s."""
    return float(sum(one.law()[0] for one in effects))
