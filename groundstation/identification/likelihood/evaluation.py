"""One flight at one point: how the model moves on its rows, and what the sensors make of it.

The model is the laws of the effects that act (``dynamics/effects``) on rows of motion, gyro and
accelerometer in body axes. Whatever multiplies a rate or a velocity uses one that was predicted
from earlier rows.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from groundstation.dynamics.effect import SPIN, Craft, Stage
from groundstation.identification.attitude_rows import FIRMWARE_GAIN
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.laws import Acting, in_order
from groundstation.identification.likelihood.motion import BodyRows, Inputs, Motion, stacked
from groundstation.identification.likelihood.parameters import TIMING
from groundstation.identification.likelihood.rotors import Rotors, spin_rotors
from groundstation.identification.likelihood.sensing import (
    FORCES,
    RATES,
    Moving,
    Passing,
    Sensors,
)
from groundstation.identification.read_between import mean_between
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

Columns = dict[int, Array]
"""Channel (0..8 as in ``comparison.channels``) -> rows."""

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
        self.sensors = self.sensors_with({})
        self.lean = attitude_gain(self.effects("attitude"))
        self.felt = self.feel(self.sensors)
        self.motion = self.moves(self.sensors, self.felt)
        self.delay = sum(one.law() for one in self.effects("delay"))
        self.rotors = self.spin(point)
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
        filters = self.frame.gyro_filter_hz, self.frame.accelerometer_filter_hz
        return Sensors(self.effects("sensor", moved), self.craft, filters)

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

    def inputs_at(self, point: Mapping[str, float]) -> Inputs:
        return Inputs.of(self.spin(point), self.delay, self.period)

    def spin(self, point: Mapping[str, float]) -> Rotors:
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

    def model_rows(
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

    def bodies(self, moved: Moved | None = None, **other: Any) -> Bodies:
        return self.model_rows(True, moved, **other), self.model_rows(False, moved, **other)

    def _model(self) -> None:
        """The model where the effects are as they are: ``middle`` over the period before each
        row, ``row`` at the row, and what the sensors make of the two."""
        self.middle, self.row = self.bodies()
        self.within = self._within()
        self.moving, self.passing = self.sensed(self.middle, self.row)
        self.angular_read, self.force_read = self.sensors.read(self.passing[-1], self.moving)

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

    def _turn(self) -> None:
        """The same where only the rates are others, and the model does not depend on them."""
        self.middle, self.row = map(self.motion.turning, (self.middle, self.row))
        self.moving, self.passing = self.sensed(self.middle, self.row)

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
        plain = self.model_rows(mean=True, body=())
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
