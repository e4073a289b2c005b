"""Each rotor's motor from flights with recorded rotor speeds, driven by duty times battery.

``rotor_problem`` has the likelihood. Its rotors are drawn towards their mean as far as their
differences do not exceed what the data can tell (empirical Bayes; DerSimonian and Laird 1986 for
the spread between rotors), so that what flights cannot tell is shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.sensors import lagged
from groundstation.dynamics.vehicle import MotorConstants, Motors, mean_motor
from groundstation.errors import BadInputError
from groundstation.identification.estimate import Estimates, fit_percent, inverse, rms, sandwich
from groundstation.identification.motor.problem import EFFECTS, SHARED, MotorProblem, MotorRun
from groundstation.identification.motor.rotor_problem import (
    MOST_S,
    OWN,
    PRIOR_S,
    SETTLE_S,
    RotorProblem,
    constants_of,
    shape_of,
)
from groundstation.telemetry.arrays import Array

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

    @property
    def lag_stderr_s(self) -> float:
        return float(self.estimates.stderr[self.estimates.names.index("sensor_lag_s")])

    @property
    def values(self) -> dict[str, float]:
        """``effect.parameter`` of the effects that were fitted along."""
        return {name: self.estimates[name] for name in self.estimates.names if "." in name}


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


def simulate_rotor(
    run: MotorRun,
    motor: MotorConstants,
    lag_s: float,
    effects: Sequence[str] = (),
    values: Sequence[float] = (),
) -> Array:
    """What the sensor of a rotor would show, (n,) rev/s, from the voltage alone."""
    problem = MotorProblem([run], effects)
    theta = problem.theta([motor.a0, motor.a1, motor.a2])
    theta[SHARED : problem.starts] = values
    return lagged(problem.simulate(theta, 0)[0].copy(), lag_s, run.period_s)


def validate_rotor(run: MotorRun, motor: MotorConstants, fit: RotorFit) -> tuple[float, float]:
    """Fit % and RMS error in rev/s of a motor on a run, without its first half second."""
    model = simulate_rotor(run, motor, fit.lag_s, fit.effects, tuple(fit.values.values()))
    rows = np.flatnonzero(np.isfinite(run.rev_s))
    rows = rows[rows >= round(SETTLE_S / run.period_s)]
    error = run.rev_s[rows] - model[rows]
    return fit_percent(run.rev_s[rows], model[rows]), rms(error)


def _outcome(problem: RotorProblem, theta: Array, normal: Array) -> RotorFit:
    covariance = _covariance(problem, theta, normal)
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
    told = np.isin(np.arange(4), rotors)
    motors = m1, m2, m3, m4
    return RotorFit(
        motors,
        shape,
        stderr,
        spread,
        float(np.hypot(held.drift, held.noise)),
        told,
        _estimates(problem, motors, theta, covariance, mean, certain),
        problem.effects,
        problem.speed,
        bool(share < TELLS * PRIOR_S),
        held.flights,
    )


def _covariance(problem: RotorProblem, theta: Array, normal: Array) -> Array:
    """Covariance of theta, no less than what the scatter of the pieces' scores says."""
    formal, scores = inverse(normal), problem.scores(theta)
    pieces = len(scores)
    if pieces > 2:
        seen = sandwich(normal, scores)
        scale = np.sqrt(np.maximum(np.diag(seen) / np.diag(formal), 1.0))
        formal = formal * np.outer(scale, scale)
    return formal


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
