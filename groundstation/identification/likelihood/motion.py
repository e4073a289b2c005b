"""What the search estimates, and how a craft with those numbers moves, row by row."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.optimize import minimize_scalar

from groundstation.dynamics.craft import add_effects, craft_of_model, find_effect, load_effects
from groundstation.dynamics.effect import (
    FAR_M,
    VALUE_SLOTS,
    Body,
    Craft,
    Effect,
    Key,
    Parameter,
    Reading,
    Stage,
    Supply,
    Unknown,
    rotor_wrench,
    to_point,
    to_stderr,
    to_values,
    variants,
)
from groundstation.dynamics.model import (
    BodyConstants,
    EffectTerm,
    Estimate,
    Model,
    require_body,
    rotor_motors,
    vehicle_model,
    with_motor,
)
from groundstation.dynamics.registry import DELAY, EFFECTS, SPIN_UP
from groundstation.dynamics.simulation import steady_rev_s
from groundstation.dynamics.vehicle import MotorConstants, Motors, Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.flight import (
    LEAK_S,
    LEANING_LEAK_S,
    Flight,
    quaternion_rows,
    velocity_in,
)
from groundstation.identification.runs import Run, squares_between
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

# A ``point`` is a dictionary from key to value: ``c0``, ``c1``, ``c2``, ``thrust_per_mass``,
# ``a0``, ``a1``, ``a2``, ``attitude_timing`` and the unknowns of effects
# (``dynamics/effect.py``).


Point = dict[str, float]

BODY_KEYS = ("c0", "c1", "c2", "thrust_per_mass")
MOTOR_KEYS = ("a0", "a1", "a2")
SENSOR_LAG = "rotor_speed_sensor.lag_s"
"""Of the sensor behind measured rotor speeds, first order."""
TIMING = "attitude_timing"
"""Where within its period the attitude filter takes the gyro: 0 over all of it, 1 at its end."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way in which an effect may be there.

    unknowns: its sizes, then its shapes. source: the user's file that defines it, if one does.
    """

    unknowns: tuple[Key, ...]
    source: str = ""

    @property
    def definition(self) -> Effect:
        return self.unknowns[0].effect

    @property
    def effect(self) -> str:
        return self.definition.name

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(one.key for one in self.unknowns)

    @property
    def sizes(self) -> tuple[str, ...]:
        """Unknowns that alone make the effect; the others only shape it."""
        return tuple(one.key for one in self.unknowns if one.parameter.kind == "size")

    @property
    def start(self) -> tuple[tuple[float, ...], ...]:
        """Values from which joint fits start, one tuple each; empty where any will do."""
        return tuple(zip(*(one.parameter.starts for one in self.unknowns), strict=False))

    @property
    def tried(self) -> Key | None:
        """The shape of which several values are screened; such an effect has no columns before one
        of them promises something."""
        return next((one for one in self.unknowns if one.parameter.tried), None)

    @property
    def label(self) -> str:
        return self.effect if self.definition.choice is None else self.keys[0]


VARIANTS: tuple[Variant, ...] = tuple(
    Variant(keys) for effect in EFFECTS.values() for keys in variants(effect)
)
"""The listed effects'."""
RENAMES: tuple[Variant, ...] = tuple(one for one in VARIANTS if one.definition.renames)
"""Those that are another name for the change of a base constant, and so no candidates."""
ALONG: Variant = next(one for one in VARIANTS if SENSOR_LAG in one.keys)
"""The one that is fitted along with the base constants where rotor speeds were recorded."""
KEYS: dict[str, Key] = {one.key: one for variant in VARIANTS for one in variant.unknowns}
ABSENT: dict[str, float] = {key: one.absent for key, one in KEYS.items()}


def absent(key: str) -> float:
    """The value of an unknown at which its effect is not there."""
    return ABSENT.get(key, 0.0)


def value(point: Mapping[str, float], key: str) -> float:
    """A number of a point; an effect's that is not in it is absent."""
    return point.get(key, absent(key))


def own_effects(path: str | Path) -> list[Variant]:
    """The effects that a user's file defines, as candidates. Raises BadInputError like
    ``load_effects``, and for one without a size."""
    source = str(Path(path).resolve())
    effects = load_effects(source)
    for name, effect in effects.items():
        if not effect.sizes:
            raise BadInputError(
                f"effect file {source}: {name} has no size, a parameter that alone makes the"
                " effect; nothing could be found of it"
            )
    return [one for effect in effects.values() for one in _own(effect, source)]


def own_of(model: Model) -> list[Variant]:
    """The user's own effects that a model has already."""
    return [
        one
        for term in model.effects
        if term.source
        for one in _own(find_effect(term.name, term.source), term.source)
    ]


def _own(effect: Effect, source: str) -> list[Variant]:
    ways = variants(_counted(effect))
    return [Variant(tuple(replace(k, effect=effect) for k in keys), source) for keys in ways]


def _counted(effect: Effect) -> Effect:
    """The effect with unknowns that are 0 where it is absent, and its shapes at their default."""

    def counted(one: Parameter) -> Parameter:
        key = Key("", effect, one)
        zero = key.absent
        if one.kind == "choice" or zero == 0.0:
            return one
        unknown = Unknown(
            one.name if one.unknown is None else one.unknown.name,
            key.unit,
            lambda value: one.to_unknown(value) - zero,
            lambda value: one.from_unknown(value + zero),
        )
        low, high = key.bounds
        return replace(one, unknown=unknown, bounds=(low - zero, high - zero))

    return replace(effect, parameters=tuple(map(counted, effect.parameters)))


def joined(known: Sequence[Variant], candidates: Sequence[Variant]) -> list[Variant]:
    """The model's own effects and further candidates.

    Raises BadInputError where two files define one name.
    """
    found = {one.keys: one for one in known}
    for one in candidates:
        other = found.setdefault(one.keys, one)
        if other.source != one.source:
            raise BadInputError(
                f"effect {one.effect}: defined in {one.source} and, for the model, in"
                f" {other.source}; rename one"
            )
    return list(found.values())


def point_of(model: Model) -> Point:
    """Where a search starts: the model's constants, and the effects it has already."""
    body = require_body(model)
    point: Point = {key: getattr(body, key) for key in BODY_KEYS}
    point.update({key: getattr(model.motor, key) for key in MOTOR_KEYS})
    point[TIMING] = 0.0
    for term in model.effects:
        given = {name: one.value for name, one in term.parameters.items()}
        effect = find_effect(term.name, term.source)
        point.update(to_point(_counted(effect) if term.source else effect, given))
    return point


def model_of(
    point: Mapping[str, float],
    errors: Mapping[str, float],
    keys: Sequence[str],
    model: Model,
    own: Sequence[Variant] = (),
) -> Model:
    """The model file of a point: ``model`` with its constants and the effects behind ``keys``.

    errors: standard errors by key. own: the user's own effects among them.
    """
    there = [v for v in (*VARIANTS, *own) if v.keys[0] in keys]
    terms = [
        EffectTerm(v.effect, estimates_of(v, point, errors), v.source)
        for v in sorted(there, key=lambda v: list(keys).index(v.keys[0]))
    ]
    return msgspec.structs.replace(
        with_motor(model, MotorConstants(*(point[key] for key in MOTOR_KEYS))),
        body=BodyConstants(*(point[key] for key in BODY_KEYS)),
        effects=tuple(terms),
    )


def estimates_of(
    variant: Variant, point: Mapping[str, float], errors: Mapping[str, float]
) -> dict[str, Estimate]:
    """A variant's parameters as the model file has them."""
    spread = to_stderr(variant.unknowns, point, errors)
    return {
        name: Estimate(value, spread.get(name), variant.definition.parameter(name).unit)
        for name, value in to_values(variant.unknowns, point).items()
    }


MOTOR_DOUBT, LEAST_MOTOR_DOUBT = 0.02, 0.001
"""Relative standard error of a0, a1, a2 where the model does not say, and the least believed."""
BODY_DOUBT = 0.03
"""Relative standard deviation of c0, c1, c2 and thrust per mass, added to what the model states:
what flights of one craft differ by."""
TAIL = 10.0
"""A model that was fitted to flights with something missing may be off by half: its prior has the
tail of Student's distribution, and weighs an eleventh at 10 standard deviations. So has that of
motors whose pace such a fit took from flights."""
TIMING_DOUBT = 0.5
LAG_DOUBT_S = 0.01
"""Of measured rotor speeds: a sensor that averages over revolutions, and a log that holds them."""
TRIM_SHARE = 0.03
"""Of one rotor's moment in hover: the lasting moment that flights of one craft differ by. It is a
battery pushed in a millimetre elsewhere, a propeller changed."""


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of some unknowns p: it adds tail * log(1 + d / tail) to -2 log L, where d =
    (p - centre)' weight (p - centre); of a normal distribution, without a tail, d."""

    keys: tuple[str, ...]
    centre: dict[str, float]
    weight: Array
    tail: float = math.inf
    where_there: bool = False
    """Of an effect's shape, say: it says nothing of a point at which that effect is absent."""

    def at(self, point: Mapping[str, float]) -> tuple[Array, Array, float]:
        """(normal matrix (k, k), gradient (k,), value) around a point."""
        if self.where_there and all(value(point, key) == absent(key) for key in self.keys):
            return np.zeros_like(self.weight), np.zeros(len(self.keys)), 0.0
        away = np.array([self.centre[key] - value(point, key) for key in self.keys])
        square = float(away @ self.weight @ away)
        if math.isinf(self.tail):
            return self.weight, self.weight @ away, square
        weight = self.weight / (1.0 + square / self.tail)
        return weight, weight @ away, self.tail * math.log1p(square / self.tail)


def trim_of(vehicle: Vehicle) -> tuple[float, float, float]:
    """Standard deviation of a flight's lasting moment about each axis, rad/s^2."""
    square = STANDARD_GRAVITY / (4.0 * vehicle.thrust_per_mass)
    roll, pitch, yaw = (TRIM_SHARE * abs(one) * square for one in vehicle.body_constants)
    return roll, pitch, yaw


def sensor_lag(model: Model) -> float:
    """Of measured rotor speeds in s, as the motors' fit found it; 0 where it did not. A model that
    has the effect says it itself."""
    account = model.fit.get("motor", {}).get("estimates") or {}
    known = dict(zip(account.get("names", ()), account.get("values", ()), strict=False))
    return float(np.clip(known.get("sensor_lag_s", 0.0), *KEYS[SENSOR_LAG].bounds))


def fitted_along(model: Model) -> Point:
    """How late the rotors' answer is and what they take to speed up, as the body's fit found it.

    They and the lag of the rotors' sensor multiply each other: from nothing each of them alone
    leads astray. What counts of delay and lag is their difference.
    """
    along = model.fit.get("body", {}).get("fitted_along") or {}
    found = {key: along[key]["value"] for key in (DELAY, SPIN_UP, SENSOR_LAG) if key in along}
    if DELAY in found and SENSOR_LAG in found:
        lag = point_of(model).get(SENSOR_LAG, found[SENSOR_LAG])
        found[DELAY] += lag - found[SENSOR_LAG]
    return found


def stated_covariance(model: Model, part: str, keys: Sequence[str]) -> Array | None:
    """Covariance (k, k) of constants, where the model says how its motor or body was fitted."""
    account = model.fit.get(part, {}).get("estimates") or {}
    names = account.get("names", ())
    if not set(keys) <= set(names):
        return None
    at = [names.index(key) for key in keys]
    return np.array(account["covariance"], np.float64)[np.ix_(at, at)]


def body_prior(model: Model, start: Point) -> Prior:
    """The given c0, c1, c2 and thrust per mass, with their stated covariance and ``BODY_DOUBT``."""
    values = np.array([start[key] for key in BODY_KEYS])
    covariance = np.diag((BODY_DOUBT * values) ** 2)
    stated = stated_covariance(model, "body", BODY_KEYS)
    if stated is not None and np.isfinite(stated).all():
        covariance = covariance + stated
    centre = {key: start[key] for key in BODY_KEYS}
    return Prior(BODY_KEYS, centre, np.asarray(np.linalg.inv(covariance)), TAIL)


def prior_of(model: Model, start: Point, told: bool) -> tuple[list[Prior], bool]:
    """The bench's a0, a1, a2 with their covariance, or those of a model without one, and the
    attitude filter's timing; whether there was a bench.

    told: rows show every setting of the motors. Where they do not, no likelihood tells how fast
    rotors answer, and the model's numbers have no tail. Nor have a profile's, which no flight bent.
    A constant that is zero (a2 of a first-order motor) stays so: it is not in the prior.
    """
    motor = tuple(key for key in MOTOR_KEYS if start[key] != 0.0)
    centre = {key: start[key] for key in motor}
    values = np.array([start[key] for key in motor])
    covariance, known = np.diag((MOTOR_DOUBT * values) ** 2), False
    given = stated_covariance(model, "motor", motor)
    if given is not None and np.isfinite(given).all():
        covariance, known = given + np.diag((LEAST_MOTOR_DOUBT * values) ** 2), True
    weight = np.asarray(np.linalg.inv(covariance))
    pace = model.fit.get("body", {}).get("motor_pace", {}).get("value", 1.0)
    tail = TAIL if told and not known and pace != 1.0 else math.inf
    timing = Prior((TIMING,), {TIMING: 0.0}, np.array([[TIMING_DOUBT**-2]]))
    return [Prior(motor, centre, weight, tail), timing], known


# The laws of effects on rows: which act at a point of the search, and what each gives for arrays.
#
# A law takes numbers (``dynamics/effect.py``). Most are plain arithmetic and take arrays (n,) of
# them as well; one that branches, calls ``math`` or remembers is compiled and run row by row.


STEPS_PER_RADIAN = 2.0
"""Steps of the integrator over the time constant of the fastest state: Runge-Kutta is then right
to one in a thousand of what the state still has to go."""


@dataclass(frozen=True, eq=False)
class Acting:
    """An effect that is there. values: of its parameters, in their order."""

    effect: Effect
    values: tuple[float, ...]

    @property
    def named(self) -> dict[str, float]:
        names = (one.name for one in self.effect.parameters)
        return dict(zip(names, self.values, strict=True))

    def law(self, *given: Any) -> Any:
        """Its law without states, of numbers or arrays (n,) as in ``dynamics/effect.py``."""
        with np.errstate(all="ignore"):
            try:
                return self.effect.law(self.values, *given)
            except (TypeError, ValueError):
                return _row_by_row(self, given)

    def body_law(self, craft: Craft, body: Any, period_s: float, mean: bool) -> Any:
        """Acceleration that an effect of the body adds, as ``law``, its states run along the rows.

        body: rows whose motion lasts over the period before each. mean: of the states over it;
        otherwise as they are at the row.
        """
        if not self.effect.states:
            return self.law(craft, body)
        return _row_by_row(self, (craft, body), period_s, mean)


def acting(keys: Sequence[Key], point: Mapping[str, float]) -> Acting | None:
    """The effect behind a variant's unknowns at a point, None where it is absent."""
    sizes = (one for one in keys if one.parameter.kind == "size")
    if all(point.get(one.key, one.absent) == one.absent for one in sizes):
        return None
    return Acting(keys[0].effect, tuple(to_values(tuple(keys), point).values()))


def in_order(effects: Iterable[Acting], stage: Stage) -> tuple[Acting, ...]:
    """Those of a stage in the order in which their laws act."""
    return tuple(sorted((one for one in effects if one.effect.stage == stage), key=_place))


def before(one: Acting, other: Acting) -> bool:
    """Whether an effect acts before another of its stage."""
    return _place(one) < _place(other)


def _place(one: Acting) -> tuple[int, str]:
    return one.effect.order, one.effect.name


def _row_by_row(
    one: Acting, given: tuple[Any, ...], period_s: float = 0.0, mean: bool = False
) -> Any:
    """A law of rotors, body or sensors as compiled code.

    One of the body that acts after others (``order``) is passed what they have made of the craft,
    as the chain of a flight passes it on, and what it adds is the difference.
    """
    from groundstation.dynamics.chains import own_address
    from groundstation.identification.likelihood.kernels import run_law

    effect, (craft, body, *passed) = one.effect, given
    count = len(body.height)
    rows = _columns(tuple(getattr(body, field) for field in Body._fields), count)
    late = effect.stage == "body" and effect.order > 0
    before = (body.angular, body.force) if late else (0.0,) * 6
    x = _columns(passed[0] if passed else before, count)
    values = np.zeros(VALUE_SLOTS)
    values[: len(one.values)] = one.values
    fastest = 0.0 if effect.fastest is None else effect.fastest(one.named)
    law, steps = own_address(effect.stage, (effect,), (0,)), STEPS_PER_RADIAN * fastest * period_s
    begin = np.array([state.initial for state in effect.states])
    run_law(law, values, np.array(_flat(craft)), rows, begin, period_s, 1 + int(steps), mean, x)
    if late:
        x -= _columns(before, count)
    found = tuple(np.ascontiguousarray(x.T))
    if effect.stage == "sensor":
        return Reading(found[:3], found[3:6], found[6:])
    return found if effect.stage == "rotor" else (found[:3], found[3:])


def _flat(given: Any) -> list[Any]:
    """The numbers of nested tuples in a row."""
    if not isinstance(given, tuple):
        return [given]
    return [number for part in given for number in _flat(part)]


def _columns(given: Any, count: int) -> Array:
    """(n, numbers) of nested tuples of arrays."""
    numbers = _flat(given)
    found = np.empty((count, len(numbers)))
    for place, one in enumerate(numbers):
        found[:, place] = one
    return found


@dataclass(frozen=True)
class Frame:
    """The craft's configuration and scale, filter gains, the user's own effects, and the rotors'
    motors in proportion to each other (None: alike).

    gyro_filter_hz, accelerometer_filter_hz: corners of the on-board low-passes of second order that
    the readings have passed; 0: none.
    """

    vehicle: Vehicle
    motors: Motors | None = None
    rate_gain: tuple[float, float, float] = (0.5, 0.5, 0.5)
    own: tuple[Variant, ...] = ()
    gyro_filter_hz: float = 0.0
    accelerometer_filter_hz: float = 0.0

    @cached_property
    def unknowns(self) -> dict[str, Key]:
        """Every effect's, by key."""
        return KEYS | {one.key: one for variant in self.own for one in variant.unknowns}

    @cached_property
    def variants(self) -> dict[str, Variant]:
        """Of each unknown."""
        return {key: one for one in (*VARIANTS, *self.own) for key in one.keys}

    def acting(self, point: Mapping[str, float]) -> dict[str, Acting]:
        """The effects that are there at a point, by their variant's label."""
        found = {v.label: acting(v.unknowns, point) for v in (*VARIANTS, *self.own)}
        return {label: one for label, one in found.items() if one is not None}

    def model(self, point: Mapping[str, float]) -> Model:
        """The base model of a point."""
        model = msgspec.structs.replace(
            vehicle_model(self.vehicle),
            motors=self.motors,
            body=BodyConstants(*(point[key] for key in BODY_KEYS)),
        )
        return with_motor(model, MotorConstants(*(point[key] for key in MOTOR_KEYS)))

    def record(self, point: Mapping[str, float]) -> np.void:
        """The same as kernels take it, a record of ``dynamics.craft.CRAFT``."""
        return craft_of_model(self.model(point))[0]

    def craft(self, point: Mapping[str, float]) -> Craft:
        """The same as laws take it."""
        record = self.record(point)
        numbers = (record[field].tolist() for field in Craft._fields)
        plain: Any = (tuple(one) if isinstance(one, list) else one for one in numbers)
        return Craft(*plain)


SUBSTEPS = 1
FASTEST_REV_S = 2000.0
"""What a search tries need not be a motor: it must stay a number."""
SMALL_MV = 1e-3
"""Step of a difference: far below what a law limits."""
KNOT_S = 2.0
"""The cell's own voltage is straight over so long: over 10 s what its curve bends passes for sag,
over 1 s what a report's steps of 2 mV shake does."""
REPORT_LAG = next(
    key.key
    for one in VARIANTS
    for key in one.unknowns
    if one.definition.stage == "supply" and key.parameter.unit == "s"
)
LAGS_S, LAG_WITHIN, SHOWS_LAG = (0.01, 2.0), 0.05, 0.9
"""Lags that a report is asked for; how well it tells one, relative: a reading is held for 10 ms; a
lag is not shown by one that leaves a larger share of what the shortest of them leaves."""
PASSES = 2
"""A load is reckoned with the voltage itself: at first with the report, then with what that
says."""


@dataclass(slots=True)
class Rotors:
    """end: (n, 4) rev/s at the rows. square: (n, 4) mean square over the period before. halves: the
    same (2 n, 4) of half periods, where rows tell two settings."""

    end: Array
    square: Array
    halves: Rotors | None = None


def spin_rotors(flight: Flight, point: Mapping[str, float], frame: Frame) -> Rotors:
    """Rotor speeds of a flight at a point."""
    run, record = flight.run, frame.record(point)
    if flight.rotors is not None:
        shown, lag = np.sqrt(flight.rotors.end), value(point, SENSOR_LAG)
        if lag == 0.0:
            return Rotors(shown, flight.rotors.square)
        # True speeds behind a sensor that lags by the first order.
        end = np.maximum(shown + lag * np.gradient(shown, run.period_s, axis=0), 0.0)
        return Rotors(end, squares_between(end).square)
    there = list(frame.acting(point).values())
    settings = run.settings
    supply = np.repeat(1000.0 * run.supply_v, len(settings) // len(run))
    start = steady_rev_s(rotor_motors(frame.model(point)), run.duty[0] * supply[0])
    craft = frame.craft(point)
    keeps = {one: _keep(one, craft, supply[0], run.period_s) for one in in_order(there, "supply")}
    prompt = [one for one, keep in keeps.items() if keep == 0.0]
    acting = [*prompt, *in_order(there, "motor")]
    add_effects(record, [(one.effect, one.named) for one in acting])
    for keep in (keep for keep in keeps.values() if keep != 0.0):
        reported = supply
        for _ in range(PASSES):
            fast = _loads(settings, record, supply, _run(run, settings, record, supply, start))
            supply, _left = _behind(flight, reported, fast, keep)
    return _run(run, settings, record, supply, start)


def lag_of_reports(
    flights: Sequence[Flight], point: Mapping[str, float], frame: Frame
) -> Prior | None:
    """By how much the reports of the battery lag, by themselves: which lag makes what motors draw
    fit them best. None where none does much better than none.

    Motion tells the lag by a thousandth of the thrust, which every constant of the motors bends;
    the report shows it in millivolts.
    """
    record, given = frame.record(point), []
    for flight in flights:
        run, settings = flight.run, flight.run.settings
        if flight.rotors is not None or np.ptp(run.supply_v) == 0.0:
            continue
        reported = np.repeat(1000.0 * run.supply_v, len(settings) // len(run))
        start = steady_rev_s(rotor_motors(frame.model(point)), run.duty[0] * reported[0])
        given.append((flight, reported, _run(run, settings, record, reported, start)))

    def left(lag_s: float) -> float:
        total = 0.0
        for flight, reported, turned in given:
            supply, keep = reported, math.exp(-flight.period_s / lag_s)
            for _ in range(PASSES):
                fast = _loads(flight.run.settings, record, supply, turned)
                supply, square = _behind(flight, reported, fast, keep)
            total += square
        return total

    if not given:
        return None
    low, high = LAGS_S
    best = minimize_scalar(
        lambda log_s: left(math.exp(log_s)),
        bounds=(math.log(low), math.log(high)),
        method="bounded",
        options={"xatol": 0.2 * LAG_WITHIN},
    )
    if best.fun > SHOWS_LAG * left(low):
        return None
    lag_s = math.exp(best.x)
    weight = np.array([[(LAG_WITHIN * lag_s) ** -2]])
    return Prior((REPORT_LAG,), {REPORT_LAG: lag_s}, weight, TAIL, where_there=True)


def _loads(settings: Array, record: np.void, supply: Array, turned: Rotors) -> Array:
    """(m, 2) mV: what drives currents, negative, and what the rotors' speeds induce against it, by
    each setting (m, 4)."""
    back = (settings * (turned.halves or turned).end) @ record["back_emf_mv"]
    return np.column_stack([-(settings**2).sum(axis=1) * supply, back])


def _run(run: Run, settings: Array, record: np.void, supply: Array, start: Array) -> Rotors:
    """settings: (m, 4); supply: (m,) mV under each."""
    from groundstation.dynamics.kernels import run_motors

    each = len(settings) // len(run)
    behind = supply[each:]
    voltage = np.ascontiguousarray(settings[each:] * behind[:, None])
    speed, square = np.empty((len(voltage) + 1, 4)), np.empty_like(voltage)
    run_motors(record, voltage, behind, run.period_s / each, SUBSTEPS, start, speed, square)
    before = np.tile(start, (each, 1))
    end, mean = np.vstack([before[1:], speed]), np.vstack([before**2, square])
    for rows, most in ((end, FASTEST_REV_S), (mean, FASTEST_REV_S**2)):
        np.fmin(np.fmax(rows, 0.0, out=rows), most, out=rows)  # what is no number is 0
    if each == 1:
        return Rotors(end, mean)
    rows = mean.reshape(-1, each, 4).mean(axis=1)
    return Rotors(end[each - 1 :: each].copy(), rows, Rotors(end, mean))


def _keep(one: Acting, craft: Craft, supply_mv: float, period_s: float) -> float:
    """k of a report r that remembers, r_i = k r_(i-1) + (1 - k) v: 0 where it does not.

    The law gives the voltage v behind the report, so k is in its slopes.
    """
    still = (0.0, 0.0, 0.0, 0.0)

    def behind(now: float, before: float) -> float:
        given = Supply(now, before, period_s, still, still)
        return float(one.effect.law(one.values, craft, given, now))

    near = supply_mv + SMALL_MV
    nothing = behind(supply_mv, supply_mv)
    return (nothing - behind(supply_mv, near)) / (behind(near, supply_mv) - nothing)


def _behind(flight: Flight, reported: Array, fast: Array, keep: float) -> tuple[Array, float]:
    """Voltage (m,) mV under each setting, behind a report that remembers the share ``keep`` of
    itself from row to row, and the sum of squares in mV^2 that is left of the report. fast: of
    ``_loads``.

    The reading itself cannot be differentiated: its steps of a millivolt would be amplified. The
    cell can be modelled: E(t) - A sum d^2 V + B sum d n, lagged, is fitted to the report, which
    is what ``estimate_supply`` does on a bench; E is linear between knots. A row
    that tells two settings holds what was read under the second.
    """
    from groundstation.identification.likelihood.kernels import first_order

    run, count = flight.run, len(reported)
    each = count // len(run)
    first, slow = each * min(flight.first, len(run) // 4), keep ** (1.0 / each)
    pieces = max(2, round((count - first) / each * run.period_s / KNOT_S))
    knots = _Knots.of(first, count, each, pieces, slow)
    late = np.empty_like(fast)
    first_order(fast, slow, late)
    moved, told = knots.left_of(late), knots.left_of(reported)
    weights = np.linalg.lstsq(moved, told, rcond=1e-10)[0]
    left = told - moved @ weights
    return fast @ weights + knots.through(reported - late @ weights), float(left @ left)


@dataclass(frozen=True, slots=True)
class _Knots:
    """Straight pieces of a flight's rows, and what a report that lags shows of them.

    read: rows that were read. hats: (m, k) shares of knots in each row. lagged: (n, k) of the same,
    lagged, where it was read. inverse: (k, k) of their Gram matrix.
    """

    read: slice
    hats: Array
    lagged: Array
    inverse: Array

    @classmethod
    @lru_cache(maxsize=2)
    def of(cls, first: int, count: int, each: int, pieces: int, keep: float) -> _Knots:
        """Pieces that begin at row ``first``: a knot of earlier rows would hardly be in the rows
        that are fitted, and its height was a hundred million volts. Kept for the flight that is
        evaluated, whose motors are simulated for every column of theirs."""
        from groundstation.identification.likelihood.kernels import first_order

        knots, rows = np.linspace(first, count - 1, pieces + 1), np.maximum(np.arange(count), first)
        hats = np.maximum(0.0, 1.0 - np.abs(rows[:, None] - knots) / (knots[1] - knots[0]))
        late = np.empty_like(hats)
        first_order(hats, keep, late)
        read = slice(first + each - 1, None, each)
        lagged = np.ascontiguousarray(late[read])
        return cls(read, hats, lagged, np.linalg.inv(lagged.T @ lagged))

    def left_of(self, values: Array) -> Array:
        """What no knots explain of the rows that were read."""
        read = values[self.read]
        return np.asarray(read - self.lagged @ (self.inverse @ (self.lagged.T @ read)))

    def through(self, values: Array) -> Array:
        """The pieces (m,) that, lagged, come nearest to the rows that were read."""
        return np.asarray(self.hats @ (self.inverse @ (self.lagged.T @ values[self.read])))


Rows = tuple[Any, ...]
"""Arrays (n,), one for each axis or rotor; a plain number where it is the same in every row."""

BodyRows = Any
"""A ``Body`` of arrays (n,)."""

STILL, _FOUR = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Inputs:
    """Rotor speeds behind the rows, rev/s, each four of (n,), as late as the measurements are.

    mean: root of the mean square over the period before a row; last: at the row.
    rotor, slope: mean speed over the period, and its slope in rev/s^2.
    """

    mean: Rows
    last: Rows
    rotor: Rows
    slope: Rows

    @classmethod
    def of(cls, rotors: Rotors, delay_s: float, period_s: float) -> Inputs:
        """Between rows speeds and the integrals of their squares are cubic."""
        from groundstation.identification.likelihood.kernels import late_rotors

        rows = np.empty((4, *rotors.end.T.shape))
        late_rotors(rotors.end, rotors.square, delay_s / period_s, period_s, *rows)
        return cls(*map(tuple, rows))

    @classmethod
    def of_halves(cls, halves: Rotors, delay_s: float, period_s: float) -> tuple[Inputs, Inputs]:
        """Of the first and the second half of each row's period."""
        both = cls.of(halves, delay_s, 0.5 * period_s)
        fields = (both.mean, both.last, both.rotor, both.slope)
        first, second = (
            cls(*(_rows(np.column_stack(rows)[half::2]) for rows in fields)) for half in (0, 1)
        )
        return first, second


class Motion:
    """Velocity, height and attitude of a flight, and its rates as predicted from earlier rows.

    news: (n, 3) rad/s^2, what the rows' own measurement says of a disturbance.
    """

    def __init__(
        self, flight: Flight, force: Array, turn: Array, true: Array | None, leaning: bool
    ) -> None:
        """force: (n, 3) specific force in body axes. turn: (3, 3), sensor to body axes. leaning:
        reported angles follow the accelerometer. true: (n, 3) rad, the angles behind those that an
        estimator turns; None: they are the reported ones."""
        run, count = flight.run, len(flight.run)
        self.flight, self.period = flight, run.period_s
        self._rates, self.news = np.zeros((count, 3)), np.zeros((count, 3))
        self.velocity = np.zeros((count, 3))
        attitude, orientation = run.attitude, flight.orientation
        if true is not None:
            attitude, orientation = true, quaternion_rows(true)
        if flight.up is not None:
            sensed = self._velocity(force @ turn, attitude, orientation, leaning)
            self.velocity = sensed @ turn.T
        height = np.where(np.isfinite(flight.height_m), flight.height_m, FAR_M)
        moving = np.minimum(height, FAR_M), tuple(orientation), _rows(self.velocity)
        rows: Any = (*moving, STILL, _FOUR, _FOUR, 0.0, STILL, STILL)
        self._still: BodyRows = Body(*rows)

    def _velocity(self, sensed: Array, attitude: Array, orientation: Array, leaning: bool) -> Array:
        # A lean turns the attitude until no acceleration is felt, and a filter that takes every
        # second row of the gyro folds vibration into it: over seconds the gyro knows better.
        flight = self.flight
        if leaning and flight.carried is not None:
            attitude, orientation = flight.carried, flight.carried_orientation
        leak = LEANING_LEAK_S if leaning else LEAK_S
        return velocity_in(flight, attitude, orientation, sensed, leak)

    def follow(self, gyro: Array) -> None:
        """Take the last row's rate for the next one's."""
        self._rates[1:] = gyro[:-1]
        self._still = self._still._replace(rate=_rows(self._rates))

    def with_rates_of(self, other: Motion) -> Motion:
        """The rates that another predicted, in place of its own."""
        self._rates, self.news = other._rates, other.news
        self._still = self._still._replace(rate=other._still.rate)
        return self

    def predict(
        self, gyro: Array, angular: Array, gain: tuple[float, float, float], ahead: Array
    ) -> tuple[float, float, float]:
        """Predict the rates from a modelled angular acceleration; the mean squared error (3,).

        ahead: (3, 3) s, how far the true rate is ahead of the gyro.
        """
        from groundstation.identification.likelihood.kernels import predict_rates

        given = gyro, self.flight.known, angular, self.period, np.array(gain)
        first = max(self.flight.first - 1, 0)
        found: tuple[float, float, float] = predict_rates(*given, first, self._rates, self.news)
        # The share of an innovation that is torque, not sensor noise, in a filter with this gain.
        self.news *= np.array(gain) ** 2 / self.period
        rates = self._rates + angular @ ahead.T if ahead.any() else self._rates
        self._still = self._still._replace(rate=_rows(rates))
        return found

    def thrust(self, craft: Craft, inputs: Inputs, *, mean: bool) -> Rows:
        """What equal rotors do: thrust and torques, rows of N and N m."""
        return rotor_wrench(craft, inputs.mean if mean else inputs.last)

    def body(
        self,
        craft: Craft,
        inputs: Inputs,
        wrench: Rows,
        rotor: tuple[Acting, ...],
        body: tuple[Acting, ...],
        *,
        mean: bool,
    ) -> BodyRows:
        """Rows of the craft with its accelerations, by the laws of rotors and body.

        wrench: what equal rotors do, over the period before each row (mean) or at the row.
        """
        speed = inputs.mean if mean else inputs.last
        now = self._still._replace(rotor=speed, rotor_slope=inputs.slope, thrust=wrench[0])
        for one in rotor:
            wrench = one.law(craft, now, wrench)
        (ixx, iyy, izz), (thrust, roll, pitch, yaw) = craft.inertia, wrench
        angular, force = (roll / ixx, pitch / iyy, yaw / izz), (0.0, 0.0, thrust / craft.mass)
        now = now._replace(rotor=inputs.rotor, thrust=thrust, angular=angular, force=force)
        for one in body:
            if one.effect.order > 0:
                now = now._replace(angular=angular, force=force)
            more, push = one.body_law(craft, now, self.period, mean)
            angular, force = added(angular, more), added(force, push)
        return now._replace(angular=angular, force=force)

    def turning(self, body: BodyRows) -> BodyRows:
        """A body with the rates as they are predicted now."""
        return body._replace(rate=self._still.rate)

    def at_rows(self, row: BodyRows) -> BodyRows:
        """A body as sensors have it at the row itself, of one by the thrust there.

        The accelerometer has no part in the gyro's noise, so what the present row says of a
        disturbance may be used here.
        """
        half = 0.5 * self.period
        news = _rows(self.news)
        rate = tuple(r + half * a for r, a in zip(row.rate, row.angular, strict=True))
        return row._replace(rate=rate, angular=added(row.angular, news))


def added(one: Rows, other: Rows) -> Rows:
    return tuple(_sum(a, b) for a, b in zip(one, other, strict=True))


def _sum(one: Any, other: Any) -> Any:
    if np.ndim(one) == 0 and one == 0.0:
        return other
    return one if np.ndim(other) == 0 and other == 0.0 else one + other


def one_before(values: Any) -> Any:
    """Rows (n,), or a tuple of them, moved on by one; numbers stay."""
    if isinstance(values, tuple):
        return tuple(map(one_before, values))
    if np.ndim(values) == 0:
        return values
    moved = np.empty_like(values)
    moved[0], moved[1:] = values[0], values[:-1]
    return moved


def stacked(rows: Rows, count: int) -> Array:
    """(n, axes) of rows; plain numbers are spread."""
    found = np.empty((count, len(rows)))
    for i, values in enumerate(rows):
        found[:, i] = values
    return found


def _rows(values: Array) -> Rows:
    return tuple(np.ascontiguousarray(values.T))
