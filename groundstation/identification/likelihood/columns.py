"""What each unknown would add to a flight's residuals: differences of the model's laws over a step.

The result of every column is d model / d key, on the channels that it reaches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from groundstation.dynamics.unknowns import Key
from groundstation.identification.likelihood.evaluation import (
    Array,
    Bodies,
    Columns,
    Evaluation,
    Felt,
    Moved,
    attitude_gain,
)
from groundstation.identification.likelihood.laws import acting, before
from groundstation.identification.likelihood.motion import STILL, Inputs, stacked
from groundstation.identification.likelihood.parameters import (
    BODY_KEYS,
    MOTOR_KEYS,
    SENSOR_LAG,
    TIMING,
    value,
)
from groundstation.identification.likelihood.sensing import FORCES, RATES, Sensors, passed

BASE_STEPS = {"a0": 1e-3, "a1": 1e-3, "a2": 1e-2} | dict.fromkeys(BODY_KEYS, 1e-4)
"""Steps of the differences, over the constant."""
SENSOR_STEP_S = 1e-3


class Differences(Evaluation):
    """An evaluation that can be moved: the columns of unknowns at its point."""

    def column(self, key: str) -> Columns:
        out: Columns = {}
        stage = self.stage(key)
        if key == TIMING:
            rows = self.rows_of_attitude
            if rows is not None:
                self.put_attitude(out, rows.euler_rates(rows.timing))
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
                columns[str(stage)](out, *self.both_sides(one))
        return out

    def both_sides(self, one: Key) -> tuple[Moved, Moved, float]:
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

    def _put_change(self, out: Columns, high: Bodies, low: Bodies, step: float) -> None:
        """Store the difference of two models over a step."""
        for part in self.parts:
            rows = self._change(part, high, low, step)
            if rows is not None:
                self.put(part, out, self.as_read(part, rows), step)

    def _change(self, part: slice, high: Bodies, low: Bodies, step: float) -> Array | None:
        """The difference (n, 3) of two models over a step, as it is read; None: they are one."""
        above, below = (both[0].angular if part == RATES else both[1].force for both in (high, low))
        change = tuple((a - b) / step for a, b in zip(above, below, strict=True))
        if not any(np.ndim(rows) or rows for rows in change):
            return None
        return self.sensors.answer(stacked(change, len(self.flight.run)), part, self.moving)

    def _craft_column(self, key: str, out: Columns) -> None:
        step = BASE_STEPS[key] * self.point[key]
        crafts = [
            self.frame.craft({**self.point, key: self.point[key] + change})
            for change in (step, -step)
        ]
        high, low = (self.model_rows(True, craft=craft) for craft in crafts)
        above, below = self.row, self.row
        if FORCES in self.parts and crafts[0].thrust != crafts[1].thrust:
            above, below = (self.model_rows(False, craft=craft) for craft in crafts)
        self._put_change(out, (high, above), (low, below), 2.0 * step)

    def _rotors_column(self, key: str, step: float, out: Columns) -> None:
        if self.flight.rotor_measured != (key == SENSOR_LAG):
            return
        moved = {**self.point, key: value(self.point, key) + step}
        inputs = self.inputs_at(moved)
        middle, row = self.model_rows(True, inputs=inputs), self.row
        if FORCES in self.parts or self.sensors.effects:
            row = self.model_rows(False, inputs=inputs)
        moving, passing = self.sensed(middle, row)
        angular, force = self.sensors.read(passing[-1], moving)
        if RATES in self.parts:
            self.put(RATES, out, (angular - self.angular_read) / step, step)
        if FORCES in self.parts:
            self.put(FORCES, out, self.as_read(FORCES, force - self.force_read) / step, step)

    def _delay_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        delays = (sum(one.law() for one in self.effects("delay", m)) for m in (high, low))
        late, early = (
            self.bodies(inputs=Inputs.of(self.rotors, delay, self.period)) for delay in delays
        )
        self._put_change(out, late, early, step)

    def _rotor_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        above, below = (self.bodies(moved, body=()) for moved in (high, low))
        self._put_change(out, above, below, step)

    def _body_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        ends_of = (*high.values(), *low.values())
        if any(one is not None and one.effect.order > 0 for one in ends_of):
            # Its law reads what the effects before it add, which the rows' sum is not.
            self._put_change(out, self.bodies(high), self.bodies(low), step)
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
        ends = [self.sensors_with(moved) for moved in (high, low)]
        felt = [self.felt, self.felt]
        if not ends[0].feel_alike(ends[1]):
            felt = [self.feel(sensors) for sensors in ends]
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
                self.put(part, out, self.as_read(part, found), step)
        if self.rows_of_attitude is not None and not (
            felt[0] is felt[1] and ends[0].alike(ends[1])
        ):
            turning = [
                self.turning(sensors, self.lean, one.off)
                for sensors, one in zip(ends, felt, strict=True)
            ]
            self.put_attitude(out, (turning[0] - turning[1]) / step, step)

    def _moved_by(
        self, ends: Sequence[Sensors], felt: Sequence[Felt]
    ) -> tuple[Bodies, Bodies] | None:
        """The model where sensors, another at each end, tell the velocity and the attitude that it
        answers to; None where it does not, or they tell the same."""
        if felt[0] is felt[1] or not (self.effects("rotor") or self.effects("body")):
            return None
        motions = [self.moves(*one) for one in zip(ends, felt, strict=True)]
        above, below = (self.bodies(motion=motion.with_rates_of(self.motion)) for motion in motions)
        return above, below

    def _attitude_column(self, out: Columns, high: Moved, low: Moved, step: float) -> None:
        if self.rows_of_attitude is not None:
            gains = (attitude_gain(self.effects("attitude", moved)) for moved in (high, low))
            turning = [self.turning(self.sensors, gain, self.felt.off) for gain in gains]
            self.put_attitude(out, (turning[0] - turning[1]) / step, step)
