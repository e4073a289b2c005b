"""What the body fit estimates (constants, effects named by the user, nuisances), how certain it is,
and what is refused or warned of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.effect import (
    CANDIDATES,
    GYRO,
    Key,
    Role,
    variants,
)
from groundstation.dynamics.model import Model, vehicle_model
from groundstation.dynamics.registry import DELAY, EFFECTS, SPIN_UP
from groundstation.dynamics.vehicle import MotorConstants, Motors, Vehicle, mean_motor
from groundstation.errors import BadInputError
from groundstation.identification.estimate import Estimates, implausible, inverse
from groundstation.identification.flight import (
    Flight,
    Stretch,
    attitude_rows,
    speed_spectrum,
    velocity_in,
)
from groundstation.identification.likelihood.evaluation import Columns, evaluate
from groundstation.identification.likelihood.linear import Linear, linearise
from groundstation.identification.likelihood.motion import (
    MOTOR_KEYS,
    SENSOR_LAG,
    Point,
    value,
)
from groundstation.identification.likelihood.problem import (
    FreeFit,
    Limits,
    Problem,
    fit_free,
    joined,
    without_upper_ends,
)
from groundstation.identification.motor.workflow import LAG, SAG
from groundstation.identification.runs import Run
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import FULL_16_BIT, STANDARD_GRAVITY

# What the body fit estimates: constants, effects named by the user, and nuisances.
#
# Nuisances are what every real flight has and a base model lacks. Left out, they bend the
# constants; kept in, they cost little certainty where they are absent. They stay out of the
# model: naming effects is the user's part (``--with``), or that of ``groundstation discrepancy``.


GAINS = ("c0", "c1")
CONSTANTS = (*GAINS, "c2")
SUPPLY_EFFECTS = (LAG, SAG)
"""Undone before the fit, from the report itself (``undo_supply``): they change what drives the
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


def as_flight(stretch: Stretch) -> Flight:
    """A stretch as the likelihood wants it."""
    run, (first, last) = stretch.run, (stretch.first, stretch.last)
    known = np.ones(len(run), np.bool_)
    has_accelerometer = bool(np.isfinite(run.accelerometer).all())
    attitude = up = None
    if np.isfinite(run.attitude).all():
        attitude = attitude_rows(run, known, first, last)
    if has_accelerometer and attitude is not None:
        up = np.array([0.0, 0.0, 1.0]), STANDARD_GRAVITY
    there = attitude, np.full(len(run), np.inf), slice(first, last), (False, False)
    measured = stretch.motor is None
    return Flight(run, known, first, last, *there, has_accelerometer, measured, up, None)


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


Known = tuple[Point, Array]
"""Estimates and their covariance (p, p)."""


@dataclass(frozen=True, slots=True)
class Certainty:
    """point: the estimates. covariance: (p, p) of all errors. moves: for c0, c1, c2 the largest
    move between bands beyond chance. alone: (p,) variances by the likelihood alone."""

    point: Point
    covariance: Array
    moves: dict[str, float]
    alone: Array


BANDS = ((1.0, 60.0), (0.3, 40.0), (2.0, 30.0))
YAW_BANDS, DRAG_HZ = BANDS[:2], (0.3, 4.0)
"""Hz. A constant of the craft is the same in all of them. Above some 2 Hz yaw answers to the change
of the rotors' speeds, not to their drag."""
STEERED_HZ, NARROWER_HZ = (2.0, 20.0), (4.0, 18.0)
"""Hz. Below, torque answers to slow moments of the air and the balance; above, to vibration that
the controller copies."""
BLOCK_S, LEAST_BLOCKS, LEAST_FLIGHTS = 5.0, 8, 4
"""Longer than what the spectra remember; scatter over fewer blocks says nothing."""
AGAIN = (*CONSTANTS, "slow_moment", SPIN_UP, DELAY, SENSOR_LAG)
"""Keys that are estimated again in each band: the delay and the sensor's lag too, which the fast
part of a flight tells, and which bend the constants."""
TELLS = 0.2
"""Standard error over the value from which a band judges nothing."""
CONTROL_HZ, SLOW = 500.0, 1.5
"""At which the firmware of 2014 and today's set the motors, and from how many settings a row on a
recorded one is not what was flown."""
ALTERNATES = 1.0
"""Standard error over the value of a c2 whose rows fold: what alternates about yaw from setting to
setting is as large as what lasts (flights of the software craft: 0.7 to 1 times)."""
HALF_WAY, MEANS = 0.05, 0.2
"""Share of settings that lie so near half-way between two from which they are means: of those
joined from other rates a tenth does."""
MOTION_S = 0.05
"""Means over so long are the craft's motion, not its vibration."""
BY_CHANCE = 2.5
"""Standard deviations by which blocks or bands may disagree before it counts."""
ABOVE, NOISY = 1.5, 30.0
"""Measured speeds tell too little above ``STEERED_HZ`` where up to so many times of it there is
less than so many times the noise, which bends a gain by its share."""


def certain(setup: Setup, free: FreeFit, noisy: bool) -> Certainty:
    """The estimates and how certain they are. noisy: whether what turns the rotors is not told.

    All frequencies together know most, and are right in closed loop, where what drives the rotors
    is known at each of them. Where noisy speeds or slow rows do not tell it, c0 and c1 are those of
    ``STEERED_HZ``. A move counts as an error of its own beside the likelihood's: of c0 and c1 then
    the one to ``NARROWER_HZ``, of c2 the one to ``DRAG_HZ``, too.
    """
    plain = inverse(free.normal)
    covariance = _by_blocks(setup, free, plain)
    moves = _moves(setup, free, covariance, noisy)
    found = Certainty(free.point, covariance, moves, np.diag(plain).copy())
    if noisy:
        found = _steered(setup, free, found)
    for key, move in found.moves.items():
        found.covariance[setup.keys.index(key), setup.keys.index(key)] += move**2
    return found


def _steered(setup: Setup, free: FreeFit, whole: Certainty) -> Certainty:
    """The same with the gains of ``STEERED_HZ``. One that this band does not tell stays, and is as
    uncertain as it moves."""
    gains = {key: setup.keys.index(key) for key in GAINS if key in setup.keys}
    steered, narrower = (_in_band(setup, free, band) for band in (STEERED_HZ, NARROWER_HZ))
    told = {key: i for key, i in gains.items() if _tells(steered, {key: i})}
    left = max((abs(narrower[0][key] / steered[0][key] - 1.0) for key in told), default=0.0)
    point, covariance, moves = dict(whole.point), whole.covariance, dict(whole.moves)
    alone = whole.alone.copy()
    for key, i in gains.items():
        if key not in told:
            moves[key] = max(moves[key], abs(steered[0][key] - point[key]))
            continue
        covariance[i] = covariance[:, i] = 0.0
        covariance[i, i] = alone[i] = steered[1][i, i]
        point[key], moves[key] = steered[0][key], left * abs(steered[0][key])
    if setup.tied:
        point["c1"] = point["c0"]
    return Certainty(point, covariance, moves, alone)


def blurred(flights: Sequence[Flight]) -> bool:
    """Whether rotor speeds are measured ones that may not tell what is above ``STEERED_HZ``: more
    than 1 / ``NOISY`` of it is noise, or readings so slow that noise cannot be told from motion.
    """
    if not all(one.rotor_measured for one in flights):
        return False
    fast, noise = 0.0, 0.0
    for flight in flights:
        seen = speed_spectrum(flight)
        if seen.noise is None:
            return True
        above = (seen.hz > STEERED_HZ[1]) & (seen.hz < ABOVE * STEERED_HZ[1])
        fast += float(np.mean(seen.power[above]))
        noise += seen.noise
    return fast < NOISY * noise


def unseen(flights: Sequence[Flight]) -> bool:
    """Whether rotors are driven by settings of the motors that no row shows."""
    driven = not all(one.rotor_measured for one in flights)
    return driven and any(unseen_delay_s(one.run) > 0.0 for one in flights)


def _in_band(setup: Setup, free: FreeFit, band: tuple[float, float]) -> Known:
    """The estimates of a band (Hz) and their covariance; all but ``AGAIN`` stays as it is."""
    cut = setup.within(band)
    still = [key for key in setup.keys if not key.startswith(AGAIN)]
    point = free.linear.point if free.settled else free.point
    values = np.array([value(point, key) for key in setup.keys])
    limits = cut.limits().held(setup.keys, still, values)
    start = cut.counted(free.linear) if free.settled else point
    part = fit_free(cut.linearise, start, limits, white=False)
    return part.point, _by_blocks(setup, part, inverse(part.normal))


def is_fast(period_s: float) -> bool:
    """Whether rows follow each other as fast as settings of the motors."""
    return CONTROL_HZ * period_s < SLOW


def open_delay_s(period_s: float) -> float:
    """Delay that rows leave open: half of what a row is longer than a setting, 0 where it is none.

    Its settings answer to the row's own disturbance: to a model that takes them as given before
    it, all seems late.
    """
    return 0.0 if is_fast(period_s) else 0.5 * (period_s - 1.0 / CONTROL_HZ)


def unseen_delay_s(run: Run) -> float:
    """How much later than its row shows it a setting of the motors may have come, 0 where rows
    show all of them: a row holds several, and which of them it shows says nothing of the others.
    """
    return 0.0 if settings_a_row(run) == 1.0 else run.period_s - 1.0 / CONTROL_HZ


def settings_a_row(run: Run) -> float:
    """How many settings of the motors stand behind each that a row holds, 1 where it is all there
    are. Telemetry of today's craft may hold the mean of two (``links/log_rows.py``): it lies
    half-way between the 65536 that there are."""
    away = np.abs((run.duty * FULL_16_BIT) % 1.0 - 0.5) < HALF_WAY
    told = np.isfinite(run.duty_step).all(axis=1).mean() > MEANS
    settings = CONTROL_HZ * run.period_s / (2.0 if told or away.mean() > MEANS else 1.0)
    return settings if settings >= SLOW else 1.0


def folds(run: Run) -> bool:
    """Whether what alternates from setting to setting looks like a lasting command: rows hold every
    second setting, every fourth or so on, always of the same sense.

    The alternation, half of ``CONTROL_HZ``, is sampled down to less than the lowest frequency that
    tells c2 (``DRAG_HZ``). Nothing in such rows says how large it is.
    """
    if settings_a_row(run) < 0.99 * CONTROL_HZ * run.period_s:
        return False  # all settings, or means of two: what alternates is in neither
    alternates, rows_hz = 0.5 * CONTROL_HZ, 1.0 / run.period_s
    return abs(alternates - round(alternates / rows_hz) * rows_hz) < DRAG_HZ[0]


def between_rows(setup: Setup) -> dict[str, float]:
    """Relative standard errors of the constants from settings of the motors that no row shows.

    One setting of several, always the same of each turn, is not a sample of their mean: angles
    seem to come earlier or later than setpoints by up to what lies between rows. The share of the
    torque that this is: the phase it makes at the frequency at which the craft turns to and fro.
    About yaw the setting alternates (``folds``).
    """
    flights = setup.problem.flights
    period, settings = flights[0].period_s, settings_a_row(flights[0].run)
    if flights[0].rotor_measured or settings == 1.0:
        return {}
    width = max(round(MOTION_S / period), 1)
    turned, rate = np.zeros(3), np.zeros(3)
    for flight in flights:
        rows = flight.run.gyro[flight.rows]
        sums = np.vstack([np.zeros(3), np.cumsum(rows - rows.mean(axis=0), axis=0)])
        means = (sums[width:] - sums[:-width]) / width
        turned += (((means[width:] - means[:-width]) / (width * period)) ** 2).sum(axis=0)
        rate += (means**2).sum(axis=0)
    phase = (settings - 1.0) / CONTROL_HZ * np.sqrt(turned / rate)
    yaw = {"c2": ALTERNATES} if folds(flights[0].run) else {}
    return {"c0": float(phase[0]), "c1": float(phase[1]), **yaw}


def _by_blocks(setup: Setup, free: FreeFit, plain: Array) -> Array:
    """The covariance, each parameter stretched by as much as blocks of time, or whole flights,
    scatter more than the likelihood says (a sandwich estimate, where it is certain)."""
    scores = _scores(setup, free)
    flights = sorted({flight for flight, _ in scores})
    groups = [
        np.array(list(scores.values())),
        np.array([sum(v for (f, _), v in scores.items() if f == flight) for flight in flights]),
    ]
    stretch = np.ones(len(plain))
    for group, least in zip(groups, (LEAST_BLOCKS, LEAST_FLIGHTS), strict=True):
        if len(group) >= least:
            ratio = ((group @ plain) ** 2).sum(axis=0) / np.diag(plain)
            chance = 1.0 + BY_CHANCE * np.sqrt(2.0 / len(group))
            stretch = np.maximum(stretch, np.sqrt(np.where(ratio > chance, ratio, 1.0)))
    return plain * np.outer(stretch, stretch)


def _scores(setup: Setup, free: FreeFit) -> dict[tuple[int, int], Array]:
    """Derivative (p,) of log L by flight and block of time: whitened series, multiplied row by
    row."""
    from scipy.fft import irfft

    sums: dict[tuple[int, int], Array] = {}
    for s, power, left in zip(free.linear.spectra, free.powers, free.left, strict=True):
        flight = setup.problem.flights[s.flight]
        size = round(1.0 / (s.hz[1] * s.period_s))
        energy = 0.5 * s.weight.max() * size
        inside = np.vstack([left, s.columns]) * (s.weight > 0.0)
        real, imaginary = np.split(inside, 2, axis=1)
        white = irfft((real + 1j * imaginary) * np.sqrt(energy / power), size, axis=1)
        rows = np.arange(flight.last - flight.first)
        count = max(1, round(len(rows) * s.period_s / BLOCK_S))
        for number, part in enumerate(np.array_split(rows, count)):
            score = sums.setdefault((s.flight, number), np.zeros(len(free.keys)))
            score[s.place] += white[1:, part] @ white[0, part]
    return sums


def _moves(setup: Setup, free: FreeFit, covariance: Array, noisy: bool) -> dict[str, float]:
    """How far c0, c1, c2 move with the band where that is beyond chance, otherwise 0: roll and
    pitch alike, for what is wrong with rotors and rows bends both."""
    places = {key: setup.keys.index(key) for key in CONSTANTS if key in setup.keys}
    gains = {key: i for key, i in places.items() if key in GAINS}
    drag = {"c2": places["c2"]}
    share, yaw = 0.0, 0.0
    slow = not is_fast(setup.problem.flights[0].period_s)
    for band in (*BANDS, STEERED_HZ, NARROWER_HZ) if slow else BANDS:
        part = _in_band(setup, free, band)
        share = max(share, _share((free.point, covariance), part, gains))
        if band in YAW_BANDS:
            yaw = max(yaw, _share((free.point, covariance), part, drag))
    if noisy:
        yaw = max(yaw, _share((free.point, covariance), _in_band(setup, free, DRAG_HZ), drag))
    return {key: abs(free.point[key]) * (share if key in gains else yaw) for key in places}


def _share(one: Known, other: Known, places: Mapping[str, int]) -> float:
    """By which share the estimates of a band differ from those with more of the flights, at most;
    0 where that is chance, or where the band does not tell."""
    found = [0.0]
    for key, i in places.items():
        (now, variance), (there, inside) = ((p[key], c[i, i]) for p, c in (one, other))
        chance = BY_CHANCE * np.sqrt(max(inside - variance, 0.2 * variance))
        if _tells(other, {key: i}) and abs(there - now) > chance:
            found.append(abs(there - now) / max(abs(now), 1e-300))
    return float(max(found))


def _tells(one: Known, places: Mapping[str, int]) -> bool:
    """Whether a band knows all these well enough to judge by them."""
    point, covariance = one
    return all(covariance[i, i] <= (TELLS * point[key]) ** 2 for key, i in places.items())


CLEAR = 6.0
"""Standard errors from which an effect that was left out is worth a word."""
HINTS = ("inertia_coupling.fraction", "rotor_gyroscopic_torque.rotor_inertia_kg_m2")
"""Unknowns of effects that every craft has beside the nuisances: a word where they show."""
CROSS_TALK = 0.3
"""Share of an axis's own torque constant that another axis's torque may seem to have."""
TURNED, TURNED_ERRORS = 0.4, 10.0
"""The same where both axes do and the signs are those of a turn, and how many standard errors make
it certain: rotors 45 degrees away give 1."""
WELL_KNOWN, UNKNOWN = 0.05, 0.5
"""Standard errors over the value from which a constant is worth a warning, or a refusal."""
MOVES = 0.1
"""Share of a constant from which its moving with the band is worth a word."""
EVERY_SETTING = "500 rows a second, or rotor speeds"
ALIKE = 0.97
"""Correlation beyond which two estimates are told only together."""


def require_usable(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    """Raises BadInputError for mixed rates, and for a torque or a rate that never changes."""
    period = stretches[0].run.period_s
    for stretch in stretches:
        if abs(stretch.run.period_s / period - 1) > 0.01:
            raise BadInputError(
                f"{stretch.run.name}: {1 / stretch.run.period_s:.0f} rows a second, others"
                f" {1 / period:.0f}; the noise model needs one rate: fit them apart"
            )
        torque = stretch.squares.mixed(vehicle.configuration)[stretch.rows]
        turned = np.diff(stretch.run.gyro[stretch.rows], axis=0)
        for axis, name in enumerate(AXES):
            if np.ptp(torque[:, axis]) == 0.0 or np.ptp(turned[:, axis]) == 0.0:
                raise BadInputError(
                    f"{stretch.run.name}: torque or rate about {name} is constant;"
                    " fly, and move all three axes"
                )


def slow_rows(run: Run, shares: Mapping[str, float]) -> list[str]:
    """A warning where rows come slower than the controller moves the motors, otherwise nothing.
    shares: of ``between_rows``."""
    if not shares:
        return []
    share = max(size for name, size in shares.items() if name in GAINS)
    return [
        f"{1 / run.period_s:.0f} rows a second hold one in {settings_a_row(run):.2g} of the"
        f" motors' settings: c0 and c1 are uncertain by {100 * share:.0f} % for it where the motor"
        f" was fitted (--model), by more where it was not; record {EVERY_SETTING}"
    ]


def require_told(setup: Setup, point: Point, variances: Array) -> None:
    """A c0 or c1 that may as well be zero is no model, nor is a negative constant. variances: (p,)
    by the likelihood."""
    errors = np.sqrt(variances)
    names = ", ".join(sorted({f.run.name for f in setup.problem.flights}))
    for key in setup.keys:
        if key not in CONSTANTS:
            continue
        axis = "roll and pitch" if setup.tied and key == "c0" else AXES[CONSTANTS.index(key)]
        found, error = point[key], float(errors[setup.keys.index(key)])
        unclear = not np.isfinite(found) or error > UNKNOWN * abs(found)
        if unclear and key == "c2":
            continue  # figures of eight hardly turn the craft about yaw: not identified
        if unclear:
            why = "; was the craft free to turn, and is the vehicle profile the right one?"
            if blurred(setup.problem.flights):
                why = (
                    ": measured rotor speeds are noisy; fly longer and move that axis more, or fit"
                    " without --measured-rotors"
                )
            raise BadInputError(
                f"{names}: torque does not show in the rate about {axis} (its constant is"
                f" {found:.3g} +- {error:.2g}){why}"
            )
        if found <= 0.0:
            raise BadInputError(
                f"{names}: {key} came out negative ({found:.3g} +- {error:.2g}): the craft turns"
                f" against the torque about {axis}; motors, axes or configuration are not those"
                " of the vehicle profile"
            )


def untold(
    estimates: Estimates,
    moves: Mapping[str, float],
    missed: Mapping[str, float],
    flights: Sequence[Flight],
) -> dict[str, str]:
    """c2 where it is not identified, with the reason. missed: of ``between_rows``.

    Raises BadInputError where c0 or c1 is not: without them there is no model.
    """
    found = {}
    for name, size, error in estimates.rows:
        if name not in CONSTANTS or error <= UNKNOWN * abs(size):
            continue
        axis, move = AXES[CONSTANTS.index(name)], moves.get(name, 0.0)
        reason = f"{axis} is hardly excited: {size:.3g} +- {error:.2g}"
        if move > 0.5 * error:
            much = "more than its size" if move > abs(size) else f"{100 * move / abs(size):.0f} %"
            reason = (
                f"it moves by {much} with the band of frequencies it is estimated in, so something"
                f" else turns {axis}"
            )
        if missed.get(name, 0.0) > UNKNOWN:
            reason = (
                f"{settings_a_row(flights[0].run):.2g} settings of the motors pass in each row, so"
                f" one that alternates looks like one that lasts: {size:.3g} +- {error:.2g}"
            )
        if name != "c2" and error**2 - move**2 <= (UNKNOWN * size) ** 2:
            continue  # a cut band is biased in closed loop where little is excited: warned of
        if name != "c2":
            names = ", ".join(sorted({f.run.name for f in flights}))
            raise BadInputError(f"{names}: {name} is not identified, because {reason}")
        found[name] = reason
    return found


def given_way(whole: Point, point: Point, flights: Sequence[Flight]) -> list[str]:
    """A warning where c0 and c1 are not those of all frequencies: what these say instead."""
    off = [whole[key] / point[key] - 1.0 for key in GAINS]
    if not any(off):
        return []
    low, high = STEERED_HZ
    reason = (
        "measured rotor speeds are too noisy or too slow above"
        if flights[0].rotor_measured
        else "rows do not show every setting of the motors, which counts above"
    )
    return [
        f"c0 and c1 are those of {low:g} to {high:g} Hz, for {reason}: all frequencies together say"
        f" {100 * off[0]:+.0f} and {100 * off[1]:+.0f} %"
    ]


def unused_speeds(flights: Sequence[Flight]) -> list[str]:
    """A warning where rotor speeds were recorded throughout and the motors' model drove the fit."""
    unused = [
        one for one in flights if not one.rotor_measured and np.isfinite(one.run.rotor_rev_s).all()
    ]
    if len(unused) < len(flights):
        return []
    return [
        "rotor speeds were recorded and are not used: with --measured-rotors c0 and c1 do not"
        " depend on how fast the motors are believed to answer"
    ]


def warnings_of(
    estimates: Estimates, moves: Mapping[str, float], beside: Mapping[str, float]
) -> list[str]:
    """What of the estimates is poorly known, implausible, or told only together. beside: relative
    errors that have a warning of their own."""
    lines = []
    for name, found, error in estimates.rows:
        if name == "c2" and error > UNKNOWN * abs(found):
            continue
        if moves.get(name, 0.0) > MOVES * abs(found):
            lines.append(
                f"{AXES[CONSTANTS.index(name)]} is hardly excited, or what turns it is not all"
                f" in the model: {name} is uncertain by {100 * error / abs(found):.0f} %, it moves"
                " with the band of frequencies it is estimated in"
            )
        elif name in CONSTANTS and error > np.hypot(WELL_KNOWN, beside.get(name, 0.0)) * abs(found):
            lines.append(
                f"{AXES[CONSTANTS.index(name)]} is hardly excited: {name} is uncertain by"
                f" {100 * error / abs(found):.0f} %; move that axis more"
            )
        elif "." in name:
            lines += implausible(name, found, error)
    correlation = estimates.correlation
    for i, one in enumerate(estimates.names):
        for j, other in enumerate(estimates.names[:i]):
            if "." in one + other and abs(correlation[i, j]) > ALIKE:
                lines.append(
                    f"{other} and {one} are told only together (correlation"
                    f" {correlation[i, j]:+.2f}){_separation(one, other)}"
                )
    return lines


def _separation(one: str, other: str) -> str:
    """What to fly to tell two effects apart, where the catalogue knows."""
    first, second = one.partition(".")[0], other.partition(".")[0]
    for effect, rival in ((first, second), (second, first)):
        for confusion in EFFECTS[effect].confused_with if effect in EFFECTS else ():
            if confusion.other == rival:
                return f"; {confusion.manoeuvre}"
    return ""


def cross_talk(setup: Setup, free: FreeFit) -> dict[str, list[str]]:
    """Axes whose rate answers to another axis's torque as well, with a warning for each.

    Raises BadInputError where roll and pitch answer to each other's in opposite senses: the rotors
    sit a part of a turn away from the profile's.
    """
    vehicle = setup.problem.frame.vehicle
    names = ", ".join(sorted({f.run.name for f in setup.problem.flights}))
    lines: dict[str, list[str]] = {}
    share, clear = np.zeros((3, 3)), np.zeros((3, 3), np.bool_)
    torque = _torques(setup, free)
    for axis, name in enumerate(AXES):
        normal, gradient = np.zeros((3, 3)), np.zeros(3)
        for s, power, left in zip(free.linear.spectra, free.powers, free.left, strict=True):
            if s.channel == axis and s.flight in torque:
                weight = s.weight / np.tile(power, 2)
                columns = torque[s.flight]
                normal += (columns * weight) @ columns.T
                gradient += columns @ (weight * left)
        covariance = inverse(normal)
        gain, error = covariance @ gradient, np.sqrt(np.diag(covariance))
        own = free.point[CONSTANTS[axis]] + gain[axis]
        share[axis], clear[axis] = gain / own, np.abs(gain) > TURNED_ERRORS * error
        found = [
            f"{name} turns with the torque about {AXES[other]} as well"
            f" ({gain[other] / own:+.0%}): is the profile's configuration"
            f" '{vehicle.configuration}' the craft's?"
            for other in {0, 1, 2} - {axis}
            if abs(gain[other]) > max(CROSS_TALK * abs(own), 5 * error[other])
        ]
        if found:
            lines[name] = found
    crossed = share[0, 1] * share[1, 0] < 0 and min(abs(share[0, 1]), abs(share[1, 0])) > TURNED
    if crossed and clear[0, 1] and clear[1, 0]:
        raise BadInputError(
            f"{names}: not flown by a {vehicle.name!r}: roll answers to pitch torque"
            f" ({share[0, 1]:+.0%}) and pitch to roll torque ({share[1, 0]:+.0%}); its rotors do"
            f" not sit in configuration '{vehicle.configuration}': give the right --vehicle"
        )
    return lines


def _torques(setup: Setup, free: FreeFit) -> dict[int, Array]:
    """Flight -> spectra (3, 2 m) of the mixer's u' about each axis."""
    found: dict[int, dict[int, Array]] = {}
    for s in setup.linearise(free.point).spectra:
        key = "c0" if setup.tied and s.channel == 1 else CONSTANTS[s.channel]
        place = np.flatnonzero(s.place == setup.keys.index(key))
        if len(place):
            found.setdefault(s.flight, {})[s.channel] = s.columns[place[0]]
    return {
        flight: np.stack([one[axis] for axis in range(3)])
        for flight, one in found.items()
        if len(one) == 3
    }


def late_in(nuisances: Mapping[str, tuple[float, float]], errors: float) -> list[str]:
    """Effects by which rotors answer late, by name, where flights show them beyond so many standard
    errors."""
    return [
        key.partition(".")[0]
        for key, (size, error) in nuisances.items()
        if key in (DELAY, SPIN_UP) and size > errors * error
    ]


def hints(
    setup: Setup, free: FreeFit, nuisances: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    """Effects that were not fitted along although the prediction errors show them clearly."""
    found = late_in(nuisances, CLEAR)
    there = {one.key for keys in setup.variants for one in keys}
    for key in HINTS:
        if key in there:
            continue
        normal, gradient = setup.linearise(free.point, (key,)).equations(free.powers)
        covariance = inverse(normal)
        size, error = (covariance @ gradient)[-1], float(np.sqrt(covariance[-1, -1]))
        if abs(size) > CLEAR * error and value(free.point, key) == 0.0:
            found.append(key.partition(".")[0])
    return tuple(found)
