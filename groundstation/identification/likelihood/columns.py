"""What each unknown would add to a flight's residuals: differences of the model's laws over a step.

The result of every column is d model / d key, on the channels that it reaches.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.dynamics.effect import Key
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
    else:
        one = at.frame.unknowns[key]
        if stage in ("supply", "motor"):
            toward = one.parameter.to_unknown(one.parameter.default) - one.absent
            _rotors_column(at, key, math.copysign(one.step, toward), out)
        else:
            columns = {
                "delay": _delay_column,
                "rotor": _rotor_column,
                "body": _body_column,
                "sensor": _sensor_column,
                "attitude": _attitude_column,
            }
            columns[str(stage)](at, out, *both_sides(at, one))
    return out


def both_sides(at: Evaluation, one: Key) -> tuple[Moved, Moved, float]:
    """Effects on both sides of an unknown's value, or on that which its bounds allow, and
    how far they are apart. Of a sensor, whose law is as good as straight, above the value and at
    it, where it is evaluated."""
    now, variant = value(at.point, one.key), at.frame.variants[one.key]
    here = at.stage(one.key) == "sensor" or now - one.step < one.bounds[0]
    low = now if here else now - one.step
    high = now + one.step
    ends = (
        {variant.label: acting(variant.unknowns, {**at.point, one.key: end})} for end in (high, low)
    )
    return next(ends), next(ends), high - low


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
    inputs = at.inputs_at(moved)
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
    moved_bodies = _moved_by(at, sensors, felt)
    for part, found in zip(at.parts, _shown_otherwise(at, high, low, step), strict=True):
        if moved_bodies is not None:
            more = _change(at, part, *moved_bodies, step)
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


def _moved_by(at: Evaluation, sensors: Sensors, felt: Felt) -> tuple[Bodies, Bodies] | None:
    """The model where these sensors tell the velocity and the attitude that it answers to, and as
    it is; None where it does not, or they tell the same."""
    if felt is at.felt or not (at.effects("rotor") or at.effects("body")):
        return None
    motion = at.moves(sensors, felt).with_rates_of(at.motion)
    return at.bodies(motion=motion), (at.middle, at.row)


def _attitude_column(at: Evaluation, out: Columns, high: Moved, low: Moved, step: float) -> None:
    if at.rows_of_attitude is not None:
        gains = (attitude_gain(at.effects("attitude", moved)) for moved in (high, low))
        above, below = (at.turning(at.sensors, gain, at.felt.off) for gain in gains)
        at.put_attitude(out, (above - below) / step, step)
