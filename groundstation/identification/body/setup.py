"""What the body fit estimates: constants, effects named by the user, and nuisances.

Nuisances are what every real flight has and a base model lacks. Left out, they bend the constants;
kept in, they cost little certainty where they are absent. They stay out of the model: naming
effects is the user's part (``--with``), or that of ``groundstation discrepancy``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.effect import CANDIDATES, GYRO, Key, Role, variants
from groundstation.dynamics.model import Model, vehicle_model
from groundstation.dynamics.registry import DELAY, EFFECTS, SPIN_UP
from groundstation.dynamics.vehicle import MotorConstants, Motors, Vehicle, mean_motor
from groundstation.errors import BadInputError
from groundstation.identification.attitude_rows import Gaps, attitude_rows
from groundstation.identification.flight import Flight, is_force_between
from groundstation.identification.likelihood.evaluation import Columns
from groundstation.identification.likelihood.free_spectra import Limits, joined, without_upper_ends
from groundstation.identification.likelihood.linearisation import Linear, linearise
from groundstation.identification.likelihood.parameters import MOTOR_KEYS, SENSOR_LAG, Point, value
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.likelihood.residuals import evaluate
from groundstation.identification.motor.supply import LAG, SAG
from groundstation.identification.stretches import Stretch
from groundstation.identification.velocity import velocity_in
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

GAINS = ("c0", "c1")
CONSTANTS = (*GAINS, "c2")
SUPPLY_EFFECTS = (LAG, SAG)
"""Undone before the fit, from the report itself (``motor/supply.py``): they change what drives the
motors, and a flight's rates alone cannot tell them from other constants."""
SOUGHT = {name: [key.name for key in one.parameters if key.tried] for name, one in EFFECTS.items()}
"""Shapes that have to be tried over their whole range, which the search does."""
FITTED = tuple(
    name
    for name, one in EFFECTS.items()
    if one.stage != "supply"
    and one.role in CANDIDATES
    and set(one.channels) & {*GYRO}
    and not SOUGHT[name]
)
FIT_WITH = (*FITTED, *SUPPLY_EFFECTS)
"""Effects that show in the rates."""
SLOW_MOMENTS = ("slow_moment.roll", "slow_moment.pitch")
LEAK_S = 3.0
"""Velocity from tilt alone is known over shorter times than this."""
LONGEST_DELAY_S, DELAY_STRIDE_S = 0.03, 3e-3
PACE = "motor_pace"
"""Logarithm of how much faster than said the motors reach the same speeds."""
PACE_LIMIT, PACE_STRIDE = 0.9, 0.25
LONGEST_LAG_S, LAG_STRIDE_S = 0.01, 2e-3
"""Of a sensor that averages over revolutions."""
PACE_LEAST_HZ, PACE_MOST_SHARE = 0.3, 0.9
"""The motors' lag shows around 2 Hz; drift below, and near the end of the spectrum what joining
topics of different rates has left, are not theirs."""
TIMING_EFFECTS = {
    name
    for name, one in EFFECTS.items()
    if one.stage == "delay" or any(state.follows in GYRO for state in one.states)
}
"""What shows a rate late."""


@dataclass(frozen=True, slots=True)
class Setup:
    """Flights, and the keys that are estimated on them.

    variants: the unknowns of each effect fitted along. nuisances: keys that stay out of the model.
    slow: what the linear ones among them add to every flight. tied: c1 is c0. channels: the rates
    that count, from least_hz up to most_share of what the rows can show.
    """

    problem: Problem
    start: Point
    variants: tuple[tuple[Key, ...], ...]
    nuisances: tuple[str, ...]
    slow: dict[str, list[Columns]]
    tied: bool
    channels: range = range(3)
    least_hz: float = 0.0
    most_share: float = 1.0

    @property
    def keys(self) -> tuple[str, ...]:
        constants = ("c0", "c2") if self.tied else CONSTANTS[: len(self.channels)]
        return (*constants, *(one.key for keys in self.variants for one in keys), *self.nuisances)

    def linearise(self, point: Point, more: Sequence[str] = ()) -> Linear:
        """Spectra of the rates at a point. more: further keys to have columns of."""
        keys, point = [*self.keys, *more], dict(point)
        if self.tied:
            keys.insert(1, "c1")
            point["c1"] = point["c0"]
        if PACE in keys:
            keys[keys.index(PACE) : keys.index(PACE) + 1] = MOTOR_KEYS
            point |= {key: self.start[key] * math.exp(point[PACE]) for key in MOTOR_KEYS}
        problem = self.problem
        linear = linearise(problem.flights, problem.frame, point, keys, self.channels, self.slow)
        if self.tied:
            linear = joined(linear, "c0", {"c0": 1.0, "c1": 1.0})
        if PACE in self.keys:
            linear = joined(linear, PACE, {key: point[key] for key in MOTOR_KEYS})
        return self.counted(linear)

    def counted(self, linear: Linear) -> Linear:
        """What counts of a linearisation: the band, with what smoothing a spectrum takes from
        beyond it."""
        if self.least_hz == 0.0:
            return linear
        most_hz = self.most_share * 0.5 / self.problem.flights[0].period_s
        return without_upper_ends(linear.within(self.least_hz, most_hz), most_hz)

    def limits(self) -> Limits:
        """Where each key is kept."""
        low, high, stride = (dict.fromkeys(self.keys, v) for v in (-math.inf, math.inf, math.inf))
        for keys in self.variants:
            for one in keys:
                low[one.key], high[one.key] = one.bounds
                stride[one.key] = one.parameter.stride
        if DELAY in low:
            # Channels may be a row off against each other, either way.
            rows = self.problem.flights[0].period_s if DELAY in self.nuisances else 0.0
            low[DELAY], high[DELAY], stride[DELAY] = -rows, LONGEST_DELAY_S, DELAY_STRIDE_S
        if SENSOR_LAG in low:
            low[SENSOR_LAG], high[SENSOR_LAG], stride[SENSOR_LAG] = 0.0, LONGEST_LAG_S, LAG_STRIDE_S
        if PACE in low:
            low[PACE], high[PACE], stride[PACE] = -PACE_LIMIT, PACE_LIMIT, PACE_STRIDE
        return Limits(*(np.array([one[key] for key in self.keys]) for one in (low, high, stride)))

    def within(self, band: tuple[float, float]) -> Setup:
        """The same where only a band (Hz) counts."""
        top_hz = 0.5 / self.problem.flights[0].period_s
        return replace(self, least_hz=band[0], most_share=min(1.0, band[1] / top_hz))

    def for_pace(self) -> Setup:
        """The same for the motors' pace, from roll and pitch alone."""
        nuisances = [one for one in self.nuisances if one not in (SPIN_UP, PACE)]
        return replace(
            self,
            start={**self.start, PACE: 0.0},
            nuisances=(*nuisances, PACE),
            channels=range(2),
            least_hz=PACE_LEAST_HZ,
            most_share=PACE_MOST_SHARE,
        )

    def unfiltered(self) -> Setup:
        """The same for rates that have passed no filter on board."""
        problem = copy(self.problem)
        problem.frame = replace(problem.frame, gyro_filter_hz=0.0)
        return replace(self, problem=problem)

    def residuals(self, point: Point) -> list[Array]:
        """Measured less modelled acceleration (n, 3) of each flight's gyro, rad/s^2."""
        found = []
        slow = self.slow_moments(point)
        for flight, moment in zip(self.problem.flights, slow, strict=True):
            series = evaluate(flight, self.problem.frame, point, (), range(3))
            left = -moment
            for axis in range(3):
                left[:, axis] += series.residual.get(axis, 0.0)
            found.append(left)
        return found

    def slow_moments(self, point: Point) -> list[Array]:
        """What of it (n, 3) in each flight is the air's answer to velocity."""
        found = []
        for number, flight in enumerate(self.problem.flights):
            moment = np.zeros((flight.last - flight.first, 3))
            for key, columns in self.slow.items():
                for axis, column in columns[number].items():
                    moment[:, axis] += value(point, key) * column
            found.append(moment)
        return found


def on_other(setup: Setup, stretches: Sequence[Stretch]) -> Setup:
    """The same unknowns on other flights."""
    flights = [as_flight(one) for one in stretches]
    problem = copy(setup.problem)
    problem.flights = flights
    return replace(setup, problem=problem, slow=_slow_moments(flights) if setup.slow else {})


def set_up(
    stretches: Sequence[Stretch],
    vehicle: Vehicle,
    thrust_per_mass: float,
    effects: Sequence[str],
    tied: bool = False,
    rotor: int = 0,
) -> Setup:
    """The unknowns of a fit. rotor: index of the mismatched one."""
    flights = [as_flight(one) for one in stretches]
    model = _model(stretches[0].motor, vehicle)
    chosen = []
    for name in effects:
        ways = variants(EFFECTS[name])
        chosen.append(ways[rotor] if len(ways) > 1 else ways[0])
    nuisances: list[str] = []
    if not TIMING_EFFECTS & {*effects}:
        nuisances.append(DELAY)
    if stretches[0].motor is None:
        nuisances.append(SENSOR_LAG)
    if SPIN_UP.partition(".")[0] not in effects:
        nuisances.append(SPIN_UP)
    slow: dict[str, list[Columns]] = {}
    if "velocity_moment" not in effects and all(f.attitude is not None for f in flights):
        nuisances += SLOW_MOMENTS
        slow = _slow_moments(flights)
    start = dict(zip(CONSTANTS, vehicle.body_constants, strict=True))
    start |= {"thrust_per_mass": thrust_per_mass, "attitude_timing": 0.0}
    start |= {key: getattr(model.motor, key) for key in ("a0", "a1", "a2")}
    start |= dict.fromkeys(nuisances, 0.0)
    start |= {one.key: one.absent for keys in chosen for one in keys}
    problem = Problem(flights, model, start)
    problem.frame = replace(problem.frame, gyro_filter_hz=vehicle.gyro_filter_hz)
    problem.settle_filters()
    return Setup(problem, start, tuple(chosen), tuple(nuisances), slow, tied)


def require_known(names: Sequence[str]) -> None:
    """Raises BadInputError for an effect that cannot be fitted along, with the reason."""
    for name in names:
        if name in FIT_WITH:
            continue
        if SOUGHT.get(name):
            raise BadInputError(
                f"--with {name}: its {', '.join(SOUGHT[name])} has to be looked for, which"
                " 'groundstation discrepancy' does"
            )
        if name in EFFECTS and EFFECTS[name].role in (Role.NOISE, Role.UNPHASED):
            raise BadInputError(
                f"--with {name}: no fit of constants shows it, for only how large it is can be"
                " known; 'groundstation discrepancy' finds it"
            )
        if name in EFFECTS:
            raise BadInputError(
                f"--with {name}: it shows in {', '.join(EFFECTS[name].channels)}, and the body"
                " fit explains the rates; 'groundstation discrepancy' finds and fits it"
            )
        raise BadInputError(f"--with {name}: the body fit knows {', '.join(FIT_WITH)}")


def reported_name(one: Key) -> str:
    """The name of an unknown's parameter as a model has it."""
    return f"{one.effect.name}.{one.parameter.name}"


def as_flight(stretch: Stretch) -> Flight:
    """A stretch as the likelihood wants it."""
    run, (first, last) = stretch.run, (stretch.first, stretch.last)
    known = np.ones(len(run), np.bool_)
    has_accelerometer = bool(np.isfinite(run.accelerometer).all())
    attitude = None
    if np.isfinite(run.attitude).all():
        attitude = attitude_rows(run, known, first, last)
    return Flight(
        run,
        known,
        first,
        last,
        attitude,
        np.full(len(run), np.inf),
        slice(first, last),
        (False, False),
        has_accelerometer,
        stretch.motor is None,
        Gaps(~known[first:last]),
        (np.array([0.0, 0.0, 1.0]), STANDARD_GRAVITY)
        if has_accelerometer and attitude is not None
        else None,
        None,
        is_force_between(run, attitude, first, last),
    )


def _model(motor: MotorConstants | Motors | None, vehicle: Vehicle) -> Model:
    import msgspec

    model = vehicle_model(vehicle)
    if isinstance(motor, tuple):
        return msgspec.structs.replace(model, motor=mean_motor(motor), motors=motor)
    return model if motor is None else msgspec.structs.replace(model, motor=motor)


def _slow_moments(flights: Sequence[Flight]) -> dict[str, list[Columns]]:
    """Roll and pitch acceleration per m/s of body velocity left and back.

    The velocity is integrated in the world, where a turn about yaw does not turn it along.
    Without an accelerometer tilt alone moves the craft: the rotors push along z only.
    """
    found: dict[str, list[Columns]] = {key: [] for key in SLOW_MOMENTS}
    for flight in flights:
        run = flight.run
        force = run.accelerometer
        if not flight.has_accelerometer:
            level = np.cos(run.attitude[:, 0]) * np.cos(run.attitude[:, 1])
            force = np.zeros_like(run.gyro)
            force[:, 2] = STANDARD_GRAVITY / np.maximum(level, 0.1)
        velocity = velocity_in(flight, run.attitude, flight.orientation, force, LEAK_S)
        columns = velocity[flight.rows, :2] * [-1.0, 1.0]
        for axis, key in enumerate(SLOW_MOMENTS):
            column = flight.gaps.spread(columns[:, 1 - axis : 2 - axis])[:, 0]
            found[key].append({axis: column})
    return found
