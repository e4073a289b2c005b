"""The motor of each rotor, from flights with recorded rotor speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import Model
from groundstation.dynamics.sensors import lagged
from groundstation.dynamics.simulation import armature_mv, simulate_motor
from groundstation.dynamics.vehicle import MotorConstants, Motors, mean_motor
from groundstation.errors import BadInputError
from groundstation.identification.estimate import (
    Estimates,
    Evidence,
    Identified,
    Progress,
    along_term,
    bounded_step,
    effect_terms,
    fit_percent,
    inverse,
    rms,
    sandwich,
    with_effects,
)
from groundstation.identification.likelihood.linear import Spectrum, fourier
from groundstation.identification.likelihood.problem import (
    whiten_by_own,
)
from groundstation.identification.motor.fit import (
    COASTING,
    EFFECTS,
    SHARED,
    MotorProblem,
    MotorRun,
    motor_pictures,
    rotor_readings,
)
from groundstation.identification.runs import Run, require_known
from groundstation.telemetry.arrays import Array

# In flight a motor's speed stays near one value, its load changes slowly (air, brushes, warmth)
# and its controller answers. So a motor is described by what such data tell apart, around the
# mean speed n_r of all rotors:
#
#     U  armature voltage that holds n_r, mV         = (a1 n_r + a2 n_r^2) / a0
#     T  time constant there, s                      = 1 / (a1 + 2 a2 n_r)
#     s  share of the load that is quadratic, 0..1   = a2 n_r / (a1 + a2 n_r)
#
# which are positive constants a0, a1, a2 of thesis eq. 3.82 whatever the data say. The error of
# the simulated speed is weighted by its own spectrum, piece by piece and free in shape (Whittle),
# so that neither slow drift nor vibration passes for a motor's answer. U is each piece's, from
# its mean speed, as a battery's and a brush's resistance change; T and s are each rotor's, the
# lag of the speed sensors is common.


PIECE_S = 10.0
"""Pieces of flights: their scores scatter as the estimate does, and each may have a U of its own.
Long beside the motors' tenth of a second, short beside the minutes in which a battery and a
motor's warmth change."""
SETTLE_S = 0.5
"""Left out where a simulation starts: five time constants of a slow brushed motor."""
BAND_HZ = (0.5, 20.0)
"""Slower changes are drift, whose spectrum rises too steeply to be weighted by its mean over a
band; a motor's corner lies at 2 Hz and above. Faster ones are vibration that the controller copies
into the PWM, and a sensor that averages and holds is no first-order lag there: with them, T of one
craft differed by a third between calm and fast flights."""
START_T_S, START_LAG_S = 0.06, 0.003
START = {COASTING: 0.5}
"""Where an effect's size begins that has a minimum of its own where it is absent."""
LINEAR_S = 0.05
"""The least s that a motor has: its back EMF, (1 - s) U, is then as high as can be."""
TIME_CONSTANTS_S = (0.002, 2.0)
"""From faster than a row to slower than anything that keeps a craft in the air."""
LONGEST_LAG_S = 0.03
STEPS = 30
SMALL = 0.02
"""Steps end below this share of a standard error."""
PRIOR_S = 0.3
"""Standard deviation of s before any data: that of a number anywhere from 0 to 1."""
MOST_S = 0.95
USUAL_DRIFT = 0.02
"""Standard deviation of ln U where a single piece cannot show it: of brushed motors that flew."""
SHIFT = 1e-6
T, S, OWN = 0, 1, 2
"""Places of ln T and s among a rotor's own parameters, and how many these are."""


@dataclass(slots=True)
class Piece:
    """A rotor in one piece (by number) of a flight (by name).

    measured: (n,) without gaps. begun: ln U by its means. holding: its own ln U, which makes the
    mean speed right. settled: its first row that counts.
    """

    rotor: int
    flight: str
    piece: int
    run: MotorRun
    measured: Array
    begun: float
    settled: int
    holding: float = 0.0


@dataclass(frozen=True, slots=True)
class Holding:
    """ln U of each rotor (r,), medians over ``flights``; standard deviations of one flight's: of
    one rotor against the others (noise), and of all together (drift)."""

    rotors: Array
    noise: float
    drift: float
    flights: int


@dataclass(frozen=True, slots=True)
class Linear:
    """A piece's normal equations. value: its -2 log L. off: what ln U should move by; follows: (k,)
    by how much less for each unit of the others' steps."""

    normal: Array
    gradient: Array
    value: float
    off: float
    follows: Array


class RotorProblem:
    """Parameters: lag, effects, then ln T and s of each rotor; ln U of each piece beside them."""

    def __init__(
        self,
        runs: Sequence[Sequence[MotorRun | None]],
        expected: MotorConstants,
        effects: Sequence[str],
    ) -> None:
        self.effects = tuple(effects)
        means = [np.nanmean(run.rev_s) for four in runs for run in four if run is not None]
        if not means:
            raise BadInputError("motor fit: no rotor speed was recorded by a working sensor")
        self.speed = float(np.mean(means))
        self.expected = shape_of(expected, self.speed)
        self.expected[S + 1] = np.clip(self.expected[S + 1], 0.0, MOST_S)
        self.pieces = [
            part
            for index, four in enumerate(_cut(runs))
            for rotor, run in enumerate(four)
            if run is not None and (part := self._piece(rotor, index, run)) is not None
        ]
        if not self.pieces:
            raise BadInputError("motor fit: the recorded rotor speeds are too short; fly longer")
        self.rotors = sorted({one.rotor for one in self.pieces})
        self.shared = 1 + len(self.effects)
        self.size = self.shared + OWN * len(self.rotors)

    def _piece(self, rotor: int, piece: int, run: MotorRun) -> Piece | None:
        if len(run.read) * run.period_s < 2.0 * SETTLE_S:
            return None
        measured = run.bridged
        holding = np.log(run.voltage_mv.mean() * self.speed / measured.mean())
        flight, settled = run.name.rpartition(" M")[0], round(SETTLE_S / run.period_s)
        return Piece(rotor, flight, piece, run, measured, float(holding), settled)

    def own(self, rotor: int) -> int:
        """Where a rotor's ln T stands among the parameters."""
        return self.shared + OWN * self.rotors.index(rotor)

    def minimise(self) -> tuple[Array, Array]:
        """The likeliest (theta, normal) from each of the starts."""
        starts = [float(self.expected[S + 1])]
        if COASTING in self.effects:  # with a threshold, which s moves, there are several minima
            starts.append(LINEAR_S)
        found = [self._descend(share) for share in starts]
        if len(found) == 1:
            return found[0]
        unlikely = []
        for theta, _normal in found:
            self.settle(theta)
            unlikely.append(self.unlikelihood(theta))
        theta, normal = found[int(np.argmin(unlikely))]
        self.settle(theta)
        return theta, normal

    def unlikelihood(self, theta: Array) -> float:
        """-2 log L in the band, given each piece's U, and what was known of s before."""
        parts = [self._linear(theta, one) for one in self.pieces]
        off = theta[[self.own(rotor) + S for rotor in self.rotors]] - self.expected[S + 1]
        return float(sum(one.value for one in parts) + np.mean(off**2) / PRIOR_S**2)

    def _descend(self, share: float) -> tuple[Array, Array]:
        """Gauss-Newton from a share s, with spectra from the last step's errors."""
        theta = np.zeros(self.size)
        theta[0] = START_LAG_S
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        most = np.full(self.size, 0.3)
        low[0], high[0], most[0] = 1e-5, LONGEST_LAG_S, 0.002
        for place, effect in enumerate(self.effects, start=1):
            size = EFFECTS[effect]
            theta[place], most[place] = START.get(effect, size.absent), size.stride
            low[place], high[place] = max(size.bounds[0], 0.0), size.bounds[1]
        for rotor in self.rotors:
            place = self.own(rotor)
            theta[place : place + OWN] = np.log(START_T_S), share
            low[place + T], high[place + T] = np.log(TIME_CONSTANTS_S)
            low[place + S], high[place + S] = 0.0, MOST_S
        for one in self.pieces:
            one.holding = one.begun
        normal = np.eye(self.size)
        for _ in range(STEPS):
            parts = [self._linear(theta, one) for one in self.pieces]
            normal, gradient = self._sum(theta, parts)
            ends = np.maximum(low - theta, -most), np.minimum(high - theta, most)
            step = bounded_step(normal, gradient, np.ones(self.size, np.bool_), *ends)
            theta = theta + step
            for one, part in zip(self.pieces, parts, strict=True):
                one.holding += float(part.off - part.follows @ step[self._places(one)])
            if np.all(np.abs(step) <= SMALL * np.sqrt(np.diag(inverse(normal)))):
                break
        return theta, normal

    def scores(self, theta: Array) -> Array:
        """Gradients (pieces, p) of the log-likelihood."""
        found = np.zeros((1 + max(one.piece for one in self.pieces), self.size))
        for one in self.pieces:
            found[one.piece, self._places(one)] += self._linear(theta, one).gradient
        return found[np.any(found != 0.0, axis=1)]

    def _places(self, one: Piece) -> NDArray[np.intp]:
        """Places among the parameters of a piece's columns behind ln U."""
        own = self.own(one.rotor)
        return np.array([own + T, own + S, *range(self.shared)], np.intp)

    def _sum(self, theta: Array, parts: Sequence[Linear]) -> tuple[Array, Array]:
        """Normal equations of all pieces, and of what was known of s before."""
        normal, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        for one, part in zip(self.pieces, parts, strict=True):
            places = self._places(one)
            normal[np.ix_(places, places)] += part.normal
            gradient[places] += part.gradient
        information = 1.0 / (PRIOR_S**2 * len(self.rotors))  # of the mean's prior, for each
        for rotor in self.rotors:
            place = self.own(rotor) + S
            normal[place, place] += information
            gradient[place] += information * (self.expected[S + 1] - theta[place])
        return normal, gradient

    def _linear(self, theta: Array, one: Piece) -> Linear:
        """A piece around theta: ln T, s, lag, effects; U makes up for their mean."""
        run, lag = one.run, float(theta[0])
        shape = np.array([one.holding, *theta[self.own(one.rotor) :][:OWN]])
        motor = constants_of(shape, self.speed)
        problem = MotorProblem([run], self.effects)
        point = problem.theta([motor.a0, motor.a1, motor.a2])
        point[SHARED : problem.starts] = theta[1 : self.shared]
        speed, slopes = problem.simulate(point, 0)
        columns = np.column_stack([slopes[:, :3] @ self.chain(shape), slopes[:, 4:]])
        both = lagged(np.column_stack([speed, columns]), lag, run.period_s)
        late = -lagged((speed - both[:, 0]) / lag, lag, run.period_s)
        stack = np.vstack([one.measured - both[:, 0], both[:, 2:4].T, late[None], both[:, 4:].T])
        stack, by_holding = stack[:, one.settled :], both[one.settled :, 1]
        follows = stack.mean(axis=1) / by_holding.mean()
        spectra, hz, weight = fourier(stack - follows[:, None] * by_holding, run.period_s)
        whole = Spectrum(0, 0, hz, weight, spectra[0], spectra[1:], np.arange(len(stack) - 1))
        noise = whiten_by_own([whole], [spectra[0]], [np.zeros(len(hz))])[0]
        inside = (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1])
        power = noise.at(hz)
        counts = np.where(inside, weight / power, 0.0)
        scaled = spectra[1:] * counts
        value = float(weight[inside] @ np.log(power[inside]) + counts @ spectra[0] ** 2)
        return Linear(
            scaled @ spectra[1:].T, scaled @ spectra[0], value, float(follows[0]), follows[1:]
        )

    def chain(self, shape: Array) -> Array:
        """Derivatives (3, 3) of a0, a1, a2 by ln U, ln T, s."""
        found = np.empty((3, 3))
        for i in range(3):
            step = SHIFT * np.eye(3)[i]
            ahead, behind = (constants_of(shape + sign * step, self.speed) for sign in (1, -1))
            for j, name in enumerate(("a0", "a1", "a2")):
                found[j, i] = (getattr(ahead, name) - getattr(behind, name)) / (2 * SHIFT)
        return found

    def settle(self, theta: Array) -> None:
        """Each piece's U given everything else."""
        for _ in range(2):
            for one in self.pieces:
                one.holding += self._linear(theta, one).off

    def holding(self) -> Holding:
        """How U differs between rotors, and between flights (or during the only one)."""
        flights = list(dict.fromkeys(one.flight for one in self.pieces))
        several = len(flights) > 1
        count = len(flights) if several else 1 + max(one.piece for one in self.pieces)
        sums, weights = np.zeros((count, len(self.rotors))), np.zeros((count, len(self.rotors)))
        for one in self.pieces:
            row = flights.index(one.flight) if several else one.piece
            place = row, self.rotors.index(one.rotor)
            sums[place] += one.holding
            weights[place] += 1.0
        rows = weights.any(axis=1)
        with np.errstate(invalid="ignore"):
            table = (sums / weights)[rows]
        flight = np.nanmean(table - np.nanmedian(table, axis=0), axis=1)
        rotor = np.nanmedian(table - flight[:, None], axis=0)
        left = table - flight[:, None] - rotor
        freedom = int(np.isfinite(left).sum()) - len(flight) - len(rotor) + 1
        noise = np.sqrt(np.nansum(left**2) / freedom) if freedom > 0 else USUAL_DRIFT
        drift = flight.std(ddof=1) if len(flight) > 1 else USUAL_DRIFT
        return Holding(
            rotor + float(np.median(flight)), float(noise), float(drift), count if several else 1
        )


def constants_of(shape: Array, speed_rev_s: float) -> MotorConstants:
    """a0, a1, a2 of (ln U, ln T, s) at a speed."""
    holding, slow, share = np.exp(shape[0]), np.exp(shape[1]), float(shape[2])
    load = 1.0 / (slow * (1.0 + share))
    return MotorConstants(
        a0=float(load * speed_rev_s / holding),
        a1=float((1.0 - share) * load),
        a2=float(share * load / speed_rev_s),
    )


def shape_of(motor: MotorConstants, speed_rev_s: float) -> Array:
    """(ln U, ln T, s) of a motor at a speed, (3,)."""
    linear, quadratic = motor.a1, motor.a2 * speed_rev_s
    holding = np.log((linear + quadratic) * speed_rev_s / motor.a0)
    share = quadratic / (linear + quadratic)
    return np.array([holding, -np.log(linear + 2.0 * quadratic), share])


def _cut(runs: Sequence[Sequence[MotorRun | None]]) -> list[list[MotorRun | None]]:
    """Pieces of flights, of ``PIECE_S`` or a little more."""
    pieces = []
    for four in runs:
        one = next((run for run in four if run is not None), None)
        if one is None:
            continue
        count = max(1, int(len(one.rev_s) * one.period_s / PIECE_S))
        edges = np.linspace(0, len(one.rev_s), count + 1).astype(int)
        pieces += [[run and run[a:b] for run in four] for a, b in pairwise(edges)]
    return pieces


# Each rotor's motor. The rotors are drawn towards their mean as far as their
# differences do not exceed what the data can tell (empirical Bayes; DerSimonian and Laird 1986 for
# the spread between rotors), so that what flights cannot tell is shared.


UNKNOWN = 0.6
"""Standard error of ln T from which a time constant is not identified (as in the bench's fit)."""
TELLS = 0.4
"""Share of what was known of s before, as a standard deviation, below which data tell it."""
MOST_SPREAD = 0.2
"""Standard deviation of ln U, ln T and s between rotors of one craft, at most: ten times what four
worn brushed motors and four brushless ones showed (0.018 and 0.029)."""
MEDIAN_VARIANCE = 1.57
"""Of a median over that of a mean: pi/2 for a normal distribution."""


@dataclass(frozen=True, slots=True)
class RotorFit:
    """Four motors and what is known about them.

    motors: M1..M4; a rotor without a sensor has the mean of the others. shape: (4, 3) ln U, ln T,
    s, after drawing towards the mean, and stderr (4, 3). spread: (3,) standard deviation between
    rotors beyond what the data's noise makes. drift: standard deviation of ln U from flight to
    flight (during the flight, where there is but one). told: (4,) rotors with a sensor.
    estimates: mean a0, a1, a2, then ``sensor_lag_s``, then effects. speed_rev_s: n_r. s_from_data:
    whether the data say more of s than was known before. flights: how many tell U.
    """

    motors: Motors
    shape: Array
    stderr: Array
    spread: Array
    drift: float
    told: NDArray[np.bool_]
    estimates: Estimates
    effects: tuple[str, ...]
    speed_rev_s: float
    s_from_data: bool
    flights: int

    @property
    def lag_s(self) -> float:
        return self.estimates["sensor_lag_s"]


def fit_rotors(
    runs: Sequence[Sequence[MotorRun | None]],
    expected: MotorConstants,
    effects: Sequence[str] = (),
) -> RotorFit:
    """Four motors from flights: for each, the runs of M1..M4, None without a working sensor.

    expected: the profile's motor, whose quadratic share counts as one more weak observation.
    effects: motor_dead_voltage and motor_braking_asymmetry, common to all rotors.

    Raises BadInputError where the data do not tell the time constant.
    """
    problem = RotorProblem(runs, expected, effects)
    return _outcome(problem, *problem.minimise())


def simulate_rotor(run: MotorRun, motor: MotorConstants, fit: RotorFit) -> Array:
    """What the sensor of a rotor would show, (n,) rev/s, from the voltage alone."""
    problem = MotorProblem([run], fit.effects)
    theta = problem.theta([motor.a0, motor.a1, motor.a2])
    theta[SHARED : problem.starts] = list(fit.estimates.of_effects.values())
    return lagged(problem.simulate(theta, 0)[0].copy(), fit.lag_s, run.period_s)


def validate_rotor(run: MotorRun, motor: MotorConstants, fit: RotorFit) -> tuple[float, float]:
    """Fit % and RMS error in rev/s of a motor on a run, without its first half second."""
    model = simulate_rotor(run, motor, fit)
    rows = run.read[run.read >= round(SETTLE_S / run.period_s)]
    return fit_percent(run.rev_s[rows], model[rows]), rms(run.rev_s[rows] - model[rows])


def _outcome(problem: RotorProblem, theta: Array, normal: Array) -> RotorFit:
    # No less than what the scatter of the pieces' scores says.
    covariance, scores = inverse(normal), problem.scores(theta)
    if len(scores) > 2:
        seen = sandwich(normal, scores)
        scale = np.sqrt(np.maximum(np.diag(seen) / np.diag(covariance), 1.0))
        covariance = covariance * np.outer(scale, scale)
    count, rotors = len(problem.rotors), problem.rotors
    places = [problem.own(rotor) + np.arange(OWN) for rotor in rotors]
    mean = np.zeros((OWN, problem.size))
    for place in places:
        mean[range(OWN), place] = 1.0 / count
    slow, share = np.sqrt(np.diag(mean @ covariance @ mean.T))
    if slow > UNKNOWN:
        raise BadInputError(
            f"motor fit: the time constant is not identified, because the thrust hardly changes"
            f" (uncertain by more than {100 * UNKNOWN:.0f} %);"
            " fly faster manoeuvres, or fit on a motor bench"
        )
    held = problem.holding()
    share_of_one = MEDIAN_VARIANCE / held.flights
    alone, own = np.empty((count, 3)), np.zeros((count, 3, 3))
    alone[:, 0], own[:, 0, 0] = held.rotors, share_of_one * held.noise**2
    for i, place in enumerate(places):
        alone[i, 1:], own[i, 1:, 1:] = theta[place], covariance[np.ix_(place, place)]
    drawn, drawn_covariance, spread = towards_mean(alone, own)
    shared = theta.copy()
    for row, place in zip(drawn, places, strict=True):
        shared[place] = row[1:]
    problem.settle(shared)
    # U goes with T and s; the drift of all together adds to each rotor's uncertainty.
    drawn[:, 0] += problem.holding().rotors - alone[:, 0]
    drawn_covariance[:, 0, 0] += share_of_one * held.drift**2
    certain = float(drawn_covariance[:, 0, 0].mean())
    shape, stderr = np.tile(drawn.mean(axis=0), (4, 1)), np.empty((4, 3))
    stderr[:] = np.sqrt(spread**2 + np.diag(drawn_covariance.mean(axis=0)))
    shape[rotors] = drawn
    stderr[rotors] = np.sqrt(np.diagonal(drawn_covariance, axis1=1, axis2=2))
    m1, m2, m3, m4 = (constants_of(row, problem.speed) for row in shape)
    told, motors = np.isin(np.arange(4), rotors), (m1, m2, m3, m4)
    estimates = _estimates(problem, motors, theta, covariance, mean, certain)
    drift, from_data = float(np.hypot(held.drift, held.noise)), bool(share < TELLS * PRIOR_S)
    of_each = motors, shape, stderr, spread, drift, told
    known = problem.effects, problem.speed, from_data, held.flights
    return RotorFit(*of_each, estimates, *known)


def towards_mean(values: Array, covariance: Array) -> tuple[Array, Array, Array]:
    """Estimates (r, 3) of ln U, ln T, s drawn towards their mean by what is known of each,
    (r, 3, 3).

    Returns them, their covariance, and the spread (3,) between rotors (method of moments). s stays
    within its bounds, which a mean weighted by matrices may leave: the others then are what is
    expected of them beside it.
    """
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    weight = 1.0 / variance
    total = weight.sum(axis=0)
    off = weight * (values - (weight * values).sum(axis=0) / total) ** 2
    room = np.maximum(total - (weight**2).sum(axis=0) / total, 1e-300)
    spread = np.maximum(off.sum(axis=0) - (len(values) - 1), 0.0) / room
    between = np.diag(np.minimum(spread, MOST_SPREAD**2))
    precision = [np.linalg.inv(one + between) for one in covariance]
    of_mean = np.linalg.inv(np.sum(precision, axis=0))
    mean = of_mean @ sum(p @ value for p, value in zip(precision, values, strict=True))
    drawn, left = np.empty_like(values), np.empty_like(covariance)
    for i, (p, own) in enumerate(zip(precision, covariance, strict=True)):
        drawn[i] = mean + between @ p @ (values[i] - mean)
        away = own @ p
        left[i] = between @ p @ own + away @ of_mean @ away.T
        beyond = np.clip(drawn[i, 2], 0.0, MOST_S) - drawn[i, 2]
        drawn[i] += left[i, :, 2] / left[i, 2, 2] * beyond
    return drawn, left, np.sqrt(np.diag(between))


def _estimates(
    problem: RotorProblem,
    motors: Motors,
    theta: Array,
    covariance: Array,
    mean: Array,
    holding: float,
) -> Estimates:
    """a0, a1, a2 of the mean motor, the sensors' lag and the effects; holding: variance of ln U."""
    motor = mean_motor(motors)
    shared = range(problem.shared)
    pick = np.zeros((problem.shared, problem.size))
    pick[shared, shared] = 1.0
    chosen = np.vstack([mean, pick])
    known = np.zeros((3 + problem.shared,) * 2)
    known[1:, 1:] = chosen @ covariance @ chosen.T
    known[0, 0] = holding
    chain = np.eye(len(known))
    chain[:3, :3] = problem.chain(shape_of(motor, problem.speed))
    names = ("a0", "a1", "a2", "sensor_lag_s", *(f"{e}.{EFFECTS[e].name}" for e in problem.effects))
    values = np.array([motor.a0, motor.a1, motor.a2, *theta[: problem.shared]])
    freedom = max(len({one.piece for one in problem.pieces}) - 1, 1)
    return Estimates(names, values, chain @ known @ chain.T, freedom)


Four = list[MotorRun | None]
"""What the sensors of M1..M4 show in one run; None for one that does not work."""

LEAST_S = 2.0
"""What is held out counts from this on; a simulation forgets its start in half a second."""
SWAP_S = 0.1
"""Over which changes of speed are compared between rotors: about a motor's time constant."""
SWAP_MARGIN = 0.2
"""By how much more a reading must go with another rotor's PWM than with its own."""
CLEARLY_BELOW, LEAST_BELOW = 0.8, 0.01
"""Voltage over what holds the speed below which a motor may coast, and the least share of rows with
so little: a1/a0 n bounds the back EMF from above, so nearer to it a motor may still be driven."""
TOLD = 3.0
"""Standard errors from which coasting is told from none."""


def identify_rotors(
    fit_on: Sequence[Run],
    validate_on: Sequence[Run],
    apart: str,
    before: Model,
    effects: Sequence[str],
    selection: str,
    progress: Progress,
) -> Identified:
    """a0, a1, a2 of each rotor, from its recorded speed and its duty times battery voltage.

    apart: which rows ``validate_on`` are in words, of those that were given to fit.

    Raises BadInputError where no sensor works, where rotors are swapped, and where the data do
    not tell the time constant.
    """
    flights, left_out = rotor_runs(fit_on)
    held, held_out = rotor_runs(validate_on)
    _require_in_order(flights, before.motor)
    progress(0.2, "fitting the motors")
    fit, coasting = _with_coasting(flights, held, before.motor, effects)
    progress(0.8, "judging them on held-out data")
    judged = _judged(held, fit)
    rows = sum(len(run) for run in fit_on)
    drawn = [(run, simulate_rotor(run, motor, fit)) for run, motor in judged[:4]]
    traces, residuals = motor_pictures(drawn, rows)
    warnings = list(dict.fromkeys([*left_out, *held_out]))
    if not fit.s_from_data:
        share, error = float(fit.shape[:, 2].mean()), float(fit.stderr[:, 2].mean())
        warnings.append(
            "a2 is hardly identified, because the thrust hardly changes: the share of the load that"
            f" is quadratic is {share:.2f} +- {error:.2f}, the given motor's included as a guess"
        )
    account: dict[str, Any] = {
        "what": "motor",
        "method": "prediction error of each rotor, free noise spectrum",
        "samples": rows,
        "selection": selection,
        "held_out": apart,
        "estimates": fit.estimates.as_dict(),
        "rotors": _rotors(fit),
        "findings": [*_findings(fit), coasting],
        "validation": [
            {"recording": run.name, "rotor_fit_percent": percent, "rotor_rms_rev_s": error}
            for run, motor in judged
            for percent, error in [validate_rotor(run, motor, fit)]
        ],
        "residual_tests": {one.channel: one.as_dict() for one in residuals},
        "warnings": warnings,
    }
    lag = along_term(fit.lag_s, fit.estimates.error_of("sensor_lag_s"))
    terms = [*effect_terms(fit.estimates), *lag]
    motors = {"motor": mean_motor(fit.motors), "motors": fit.motors}
    model = msgspec.structs.replace(before, **motors, effects=with_effects(before, terms))
    return Identified(model, account, Evidence({"motor": fit.estimates}, traces, residuals))


def _with_coasting(
    flights: Sequence[Four], held: Sequence[Four], motor: MotorConstants, effects: Sequence[str]
) -> tuple[RotorFit, str]:
    """The fit, with ``motor_coasting`` where the flights tell it and held-out speeds are predicted
    no worse by it; and what is known of it, in words."""
    without = fit_rotors(flights, motor, [name for name in effects if name != COASTING])
    below = _share_below(flights, without)
    if below < LEAST_BELOW:
        return without, (
            f"{COASTING}: not identified, because only {100 * below:.2g} % of the voltages are"
            f" below {CLEARLY_BELOW:g} of what holds the speed: the motors never had to brake hard"
        )
    fit = fit_rotors(flights, motor, list(dict.fromkeys([*effects, COASTING])))
    name = f"{COASTING}.share"
    share, error = 100.0 * fit.estimates[name], 100.0 * fit.estimates.error_of(name)
    said = f"{COASTING}: {share:.0f} +- {error:.0f} % of a braking current does not flow"
    if COASTING in effects:
        return fit, said
    if share <= TOLD * error:
        return without, f"{said}: none is told"
    if _squares(held, fit) > _squares(held, without):
        return without, f"{said}, but held-out speeds are predicted worse with it: left out"
    return fit, said


def _squares(held: Sequence[Four], fit: RotorFit) -> float:
    """Sum of squared errors of held-out speeds."""
    judged = _judged(held, fit)
    return sum(len(run.rev_s) * validate_rotor(run, own, fit)[1] ** 2 for run, own in judged)


def _share_below(flights: Sequence[Four], fit: RotorFit) -> float:
    """Share of the rows whose voltage is clearly below what holds the mean speed."""
    below = [
        run.voltage_mv < CLEARLY_BELOW * np.exp(fit.shape[rotor, 0])
        for four in flights
        for rotor, run in enumerate(four)
        if run is not None
    ]
    return float(np.concatenate(below).mean())


def _judged(held: Sequence[Four], fit: RotorFit) -> list[tuple[MotorRun, MotorConstants]]:
    """What is held out and long enough, with the motor of its rotor."""
    return [
        (run, fit.motors[rotor])
        for four in held
        for rotor, run in enumerate(four)
        if run is not None and fit.told[rotor] and run.seconds > LEAST_S
    ]


def rotor_runs(runs: Sequence[Run]) -> tuple[list[Four], list[str]]:
    """The working sensors of each run, and in words which do not work.

    Raises BadInputError where PWM or battery voltage are missing.
    """
    found: list[Four] = []
    left_out: list[str] = []
    for run in runs:
        voltage = armature_mv(run.duty, run.supply_v)
        require_known(run, ("duty", "supply_v"), "the motors need it")
        speeds, silent = rotor_readings(run)
        left_out += silent
        four: Four = [None] * 4
        for rotor in np.flatnonzero(np.isfinite(speeds).any(axis=0)).tolist():
            name, nothing = f"{run.name} M{rotor + 1}", np.zeros(len(run))
            driven = np.ascontiguousarray(voltage[:, rotor])
            four[rotor] = MotorRun(name, run.period_s, driven, speeds[:, rotor], nothing, nothing)
        found.append(four)
    return found, left_out


def _require_in_order(flights: Sequence[Four], motor: MotorConstants) -> None:
    """Raises BadInputError where rotors' readings follow each other's PWM, not their own."""
    from scipy.optimize import linear_sum_assignment

    products, squares = np.zeros((4, 4)), np.zeros((2, 4))
    for four in flights:
        if any(run is None for run in four):
            continue
        runs = [run for run in four if run is not None]
        voltage = np.column_stack([run.voltage_mv for run in runs])
        driven, _ = simulate_motor(motor, voltage[1:], runs[0].period_s)
        width = max(round(SWAP_S / runs[0].period_s), 1)
        shown = np.column_stack([run.bridged for run in runs])
        seen, driven = (one[width:] - one[:-width] for one in (shown, driven))
        products += seen.T @ driven
        squares += [(seen**2).sum(axis=0), (driven**2).sum(axis=0)]
    if not squares.all():
        return
    correlation = products / np.sqrt(np.outer(*squares))
    rotors, goes_with = linear_sum_assignment(-correlation)
    moved = np.flatnonzero(goes_with != rotors)
    if len(moved) and np.all(
        correlation[moved, goes_with[moved]] > correlation[moved, moved] + SWAP_MARGIN
    ):
        pairs = ", ".join(f"rotor {i + 1} with motor {goes_with[i] + 1}'s" for i in moved)
        raise BadInputError(
            f"the recorded rotor speeds are not in the order of the motors: they go {pairs} PWM;"
            " correct the order of the sensors or of the columns"
        )


def _rotors(fit: RotorFit) -> list[dict[str, Any]]:
    """For the model file: each rotor's constants and what stands behind them."""
    each = zip(fit.motors, fit.shape, fit.stderr, strict=True)
    return [
        {
            "rotor": rotor + 1,
            "sensor": bool(fit.told[rotor]),
            **msgspec.structs.asdict(motor),
            "holding_mv": float(np.exp(shape[0])),
            "holding_stderr_mv": float(np.exp(shape[0]) * error[0]),
            "time_constant_s": float(np.exp(shape[1])),
            "time_constant_stderr_s": float(np.exp(shape[1]) * error[1]),
            "quadratic_share": float(shape[2]),
            "quadratic_share_stderr": float(error[2]),
        }
        for rotor, (motor, shape, error) in enumerate(each)
    ]


def _findings(fit: RotorFit) -> list[str]:
    """In words: how the rotors differ, and how steady each is."""
    speed, holding = fit.speed_rev_s, np.exp(fit.shape[:, 0])
    slow, errors = 1e3 * np.exp(fit.shape[:, 1]), fit.stderr
    low, high = float(holding.min()), float(holding.max())
    lines = [
        f"at {speed:.0f} rev/s M1..M4 take {', '.join(f'{mv:.0f}' for mv in holding)} mV"
        f" (+- {float((holding * errors[:, 0]).mean()):.0f}): they differ by"
        f" {100 * (high / low - 1):.1f} %"
    ]
    if fit.spread[1] == 0.0:
        lines.append(
            f"time constant {slow[0]:.1f} ms +- {slow[0] * errors[0, 1]:.1f} for all: the data"
            " tell no difference between the rotors"
        )
    else:
        lines.append(
            f"time constants {', '.join(f'{ms:.1f}' for ms in slow)} ms"
            f" (+- {float((slow * errors[:, 1]).mean()):.1f})"
        )
    over = "from flight to flight" if fit.flights > 1 else "during the flight"
    lines.append(f"what holds a speed changes by {100 * fit.drift:.1f} % {over}")
    unknown = np.flatnonzero(~fit.told)
    return [*lines, *(f"M{rotor + 1} is taken as the mean of the others" for rotor in unknown)]
