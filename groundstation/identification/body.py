"""Grey-box identification of the body from closed-loop flights (thesis 7.3.6): the fit, how well it
predicts flights it has not seen, and the model it makes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import msgspec
import numpy as np

from groundstation.dynamics.effect import to_stderr, to_values
from groundstation.dynamics.model import (
    BodyConstants,
    EffectTerm,
    Estimate,
    Model,
    rotor_motors,
    with_motor,
)
from groundstation.dynamics.registry import DELAY, EFFECTS, SPIN_UP, at_stage
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body_setup import (
    CONSTANTS,
    EVERY_SETTING,
    FIT_WITH,
    PACE,
    SUPPLY_EFFECTS,
    Setup,
    between_rows,
    blurred,
    certain,
    cross_talk,
    given_way,
    hints,
    is_fast,
    late_in,
    on_other,
    open_delay_s,
    require_known,
    require_told,
    require_usable,
    set_up,
    slow_rows,
    unseen,
    unseen_delay_s,
    untold,
    unused_speeds,
    warnings_of,
)
from groundstation.identification.estimate import (
    TOLD,
    Estimates,
    Evidence,
    Identified,
    Progress,
    ResidualTest,
    Trace,
    along_term,
    effect_terms,
    fit_percent,
    fitted_effects,
    inverse,
    liveliest,
    residual_test,
    rms,
    sandwich,
    silent,
    with_effects,
)
from groundstation.identification.flight import Stretch, divided, paced, quicker, stretches_of
from groundstation.identification.likelihood.evaluation import BASE_STEPS
from groundstation.identification.likelihood.linear import Linear
from groundstation.identification.likelihood.motion import (
    ALONG,
    MOTOR_KEYS,
    SENSOR_LAG,
    Point,
    spin_rotors,
    stated_covariance,
    value,
)
from groundstation.identification.likelihood.problem import (
    ON_BOARD,
    FreeFit,
    Limits,
    cost_of,
    filter_terms,
    filters_of,
    fit_free,
    minimum_phase_whitener,
    reweighted,
    smoothed,
    unfitted,
)
from groundstation.identification.motor.workflow import (
    SAG,
    SupplyEstimate,
    flight_figures,
    supply_terms,
    undo_supply,
)
from groundstation.identification.runs import EVERYTHING, Run, Selection, by_saturation
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

# Grey-box identification of the body from closed-loop flights (thesis 7.3.6).
#
# A quadrotor flies in closed loop and its rates are the integral of torque: to simulate it freely
# over a flight would compare a diverging integral with a stabilised one. Here each rate is
# predicted one row ahead, on the likelihood of the search (``likelihood/``), with a noise
# spectrum of each flight's own that is free at every frequency. Several starts; nuisances and
# effects fitted along.


TRIAL_STEP_S, TRIED_S, TRIED_LAG_S = 2e-3, 0.016, 3e-3
"""Delays some ms apart can predict almost equally well: each is tried, the best are followed."""
FOLLOWED = 2
BLOCK_S = 0.5
LEAST_SHARE = 0.1
"""Of what the profile's geometry says, for a gain of a craft that its rotors turn."""
CLEARLY = 20.0
"""Of -2 log L, by which unfiltered rates are likelier than those that the profile says. A delay
stands in for the filter; what the model lacks yet decides between them otherwise."""
PACE_BAND = 0.3, 0.9
"""From so many Hz to this share of what rows can show: the motors' lag shows around 2 Hz; drift
below, and what joining topics of different rates has left near the end, are not theirs."""
PACE_ERRORS = 3.0
"""Standard errors from which a motor is said to answer faster or slower than its constants."""
PACE_OF_CRAFTS, PACE_PER_UNSEEN_S = 0.25, 30.0
"""Logarithms, one standard deviation: of a craft's motors about its profile's, and of the estimate
for each second by which settings may have come unseen (flights of the software craft)."""


@dataclass(frozen=True, slots=True)
class BodyFit:
    """Outcome of ``fit_body``.

    estimates: c0, c1, c2, thrust_per_mass and one ``effect.parameter`` for each effect.
    nuisances: what was fitted along and is not in the model, by key, with standard errors.
    setup, free: predict with the fit. pace: by which a0, a1, a2 were multiplied, and its relative
    standard error. shown: effects that are clearly there and left out. crossed: axes that another's
    torque turns.
    """

    body: BodyConstants
    estimates: Estimates
    effects: tuple[str, ...]
    nuisances: Mapping[str, tuple[float, float]]
    setup: Setup
    free: FreeFit
    warnings: tuple[str, ...]
    not_identified: Mapping[str, str]
    shown: tuple[str, ...] = ()
    pace: tuple[float, float] = (1.0, 0.0)
    crossed: tuple[str, ...] = ()

    @property
    def point(self) -> Point:
        return self.free.point

    @property
    def saved(self) -> Point:
        """The point of what is saved: the nuisances are zero, but for the sensor's lag, and c2 is
        the profile's where it is not identified."""
        zero = {key: 0.0 for key in self.setup.nuisances if key != SENSOR_LAG}
        return {**self.point, **zero, "c2": self.body.c2}

    @property
    def delay_s(self) -> float:
        """The delay behind the rotors, however it was fitted; otherwise 0."""
        return value(self.point, DELAY)


def fit_body(
    stretches: Sequence[Stretch],
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
    motor_covariance: Array | None = None,
    motor_known: bool = True,
) -> BodyFit:
    """Estimate c0, c1, c2 and thrust_per_mass from all stretches together.

    effects: names in ``FIT_WITH`` that are known to be there. tie_roll_pitch: c1 = c0, as in the
    thesis. motor_covariance: (3, 3) of a0, a1, a2, whose part is added to that of the estimates.
    motor_known: otherwise how fast the motors answer is fitted as well, not their steady speeds.

    Raises BadInputError for stretches without torque or motion.
    """
    require_known(effects)
    if not stretches:
        raise BadInputError("body fit: nothing to fit on; give a longer recording")
    require_usable(stretches, vehicle)
    acting = tuple(name for name in effects if name not in SUPPLY_EFFECTS)
    pace = doubt = 0.0
    if not motor_known and stretches[0].motor is not None:
        pace, doubt = _believed_pace(stretches, vehicle)
        stretches = [paced(one, math.exp(pace)) for one in stretches]
    rotors = range(4 if "rotor_mismatch" in effects else 1)
    plain = set_up(stretches, vehicle, vehicle.thrust_per_mass, ())
    thrust, _ = fit_thrust(plain, plain.start)
    found = []
    for rotor in rotors:
        setup = set_up(stretches, vehicle, thrust, acting, tie_roll_pitch, rotor)
        found.append((setup, likeliest(setup)))
    setup, free = min(found, key=lambda one: one[1].cost)
    if vehicle.gyro_filter_hz > 0.0 and is_fast(stretches[0].run.period_s):
        # Whether a log holds filtered rates depends on the firmware: its likelihood says, where it
        # does so clearly and rows are not so slow that the settings between them blur what is fast.
        problem = copy(setup.problem)
        problem.frame = replace(problem.frame, gyro_filter_hz=0.0)
        raw = replace(setup, problem=problem)
        other = fit_free(raw.linearise, free.point, raw.limits(), white=False)
        if other.cost < free.cost - CLEARLY:
            setup, free = raw, likeliest(raw)
    if doubt:
        motor = np.array([free.point[key] for key in MOTOR_KEYS])
        motor_covariance = doubt**2 * np.outer(motor, motor)
    flights = setup.problem.flights  # slow rows of a known motor tell at all frequencies
    noisy = blurred(flights) or (not motor_known and unseen(flights))
    outcome = _outcome(setup, free, acting, motor_covariance, noisy)
    return replace(outcome, pace=(math.exp(pace), doubt))


def _believed_pace(stretches: Sequence[Stretch], vehicle: Vehicle) -> tuple[float, float]:
    """What of ``motor_pace`` is believed, and its standard error.

    Where rows show every setting of the motors it is the estimate, if that is clearly another.
    Otherwise a setting's unseen delay is a bias that no likelihood tells: estimate and profile
    count by what either is worth.
    """
    pace, doubt = motor_pace(stretches, vehicle)
    if not (unseen_s := unseen_delay_s(stretches[0].run)):
        doubt = math.hypot(doubt, PACE_PER_UNSEEN_S * open_delay_s(stretches[0].run.period_s))
        return pace if abs(pace) > PACE_ERRORS * doubt else 0.0, doubt
    variance = doubt**2 + (PACE_PER_UNSEEN_S * unseen_s) ** 2
    share = PACE_OF_CRAFTS**2 / (PACE_OF_CRAFTS**2 + variance)
    return share * pace, math.sqrt(share * variance)


def motor_pace(stretches: Sequence[Stretch], vehicle: Vehicle) -> tuple[float, float]:
    """How much faster the motors reach their speeds than their constants say (logarithm), and its
    standard error, from roll and pitch: yaw answers to the change of speed itself."""
    whole = set_up(stretches, vehicle, vehicle.thrust_per_mass, ())
    nuisances = (*(one for one in whole.nuisances if one not in (SPIN_UP, PACE)), PACE)
    setup = replace(whole, start={**whole.start, PACE: 0.0}, nuisances=nuisances)
    least, most = PACE_BAND
    setup = replace(setup, channels=range(2), least_hz=least, most_share=most)
    free = likeliest(setup)
    place = setup.keys.index(PACE)
    return free.point[PACE], float(np.sqrt(inverse(free.normal)[place, place]))


def likeliest(setup: Setup) -> FreeFit:
    """The best of several starts: delays, from white noise and from the vehicle's geometry."""
    limits = setup.limits()
    starts = [setup.start]
    plain = limits.held(setup.keys, (SENSOR_LAG,))
    if DELAY in setup.keys:
        step = max(TRIAL_STEP_S, setup.problem.flights[0].period_s)
        least = limits.low[setup.keys.index(DELAY)]
        delays = np.arange(max(least, -step), TRIED_S, step).tolist()
        linear = setup.linearise(setup.start)
        trials = sorted((_trial(setup, linear, delay, plain), delay) for delay in delays)
        starts = [{**setup.start, DELAY: delay} for _, delay in trials[:FOLLOWED]]
    fits = [fit_free(setup.linearise, point, plain, white=False) for point in starts]
    fits.append(fit_free(setup.linearise, starts[0], plain))
    best = likeliest_that_turns(setup, fits)
    if SENSOR_LAG in setup.keys:
        later = best.point[DELAY] + TRIED_LAG_S if DELAY in setup.keys else 0.0
        point = {**best.point, SENSOR_LAG: TRIED_LAG_S, **({DELAY: later} if later else {})}
        lagging = fit_free(setup.linearise, point, limits, white=False)
        best = likeliest_that_turns(setup, [best, lagging])
    if not setup.tied:
        return best
    return replace(best, point={**best.point, "c1": best.point["c0"]})


def likeliest_that_turns(setup: Setup, fits: Sequence[FreeFit]) -> FreeFit:
    """The likeliest of those whose rotors turn the craft about roll and pitch, if there are any.

    Where rows are a row and more late against each other, each channel in its own way, no torque
    at all may be likelier than one that comes too early: the rest of its sizes is free then.
    """
    least = LEAST_SHARE * np.array(setup.problem.frame.vehicle.body_constants[:2])
    turning = [one for one in fits if one.point["c0"] > least[0] and one.point["c1"] > least[1]]
    return min(turning or fits, key=lambda one: one.cost)


def _trial(setup: Setup, linear: Linear, delay: float, limits: Limits) -> float:
    """-2 log L with the rotors' torques of the start point late by ``delay``, all else at its
    best; the shift is one of phase."""
    now = np.array([value(setup.start, key) for key in setup.keys])
    moved = np.array([key in (*CONSTANTS, SPIN_UP) for key in setup.keys])
    spectra = []
    for s in linear.spectra:
        late = moved[s.place]
        columns = s.columns.copy()
        turn = np.exp(-2j * np.pi * np.split(s.hz, 2)[0] * delay)
        real, imaginary = np.split(columns[late], 2, axis=1)
        shifted = (real + 1j * imaginary) * turn
        columns[late] = np.concatenate([shifted.real, shifted.imag], axis=1)
        residual = s.residual + now[s.place] @ s.columns - now[s.place] @ columns
        spectra.append(replace(s, residual=residual, columns=columns))
    held = limits.held(setup.keys, (DELAY, PACE), now)
    first = smoothed(spectra, [s.residual for s in spectra])
    change, _, powers = reweighted(
        replace(linear, spectra=spectra), first, held.low - now, held.high - now
    )
    left = [s.residual - change[s.place] @ s.columns for s in spectra]
    return cost_of(spectra, powers, left)


def fit_thrust(setup: Setup, point: Point) -> tuple[float, float]:
    """thrust_per_mass and its standard error.

    Plain least squares through the origin, so that the mean counts, which is known best; its
    error allows for slow disturbances (climbs, drag), which a noise model would take for signal.

    Raises BadInputError where no stretch has an accelerometer.
    """
    measured, squares = vertical(setup, point)
    if not len(measured):
        names = ", ".join(sorted({f.run.name for f in setup.problem.flights}))
        raise BadInputError(f"{names}: no accelerometer, so thrust_per_mass cannot be fitted")
    normal = float(squares @ squares)
    found = float(measured @ squares) / normal
    score = squares * (measured - found * squares)
    block = max(round(BLOCK_S / setup.problem.flights[0].period_s), 1)
    sums = np.add.reduceat(score, np.arange(0, len(score), block))
    covariance = sandwich(np.array([[normal]]), sums[:, None])
    return found, float(np.sqrt(covariance[0, 0]))


def vertical(setup: Setup, point: Point) -> tuple[Array, Array]:
    """Measured specific force along z (m/s^2) and the sum of squared rotor speeds behind it."""
    measured, modelled = [], []
    strength = np.array([1.0 + value(point, f"rotor_mismatch.{i}") for i in (1, 2, 3, 4)])
    for flight in setup.problem.flights:
        if flight.has_accelerometer:
            late = np.arange(flight.first, flight.last) - value(point, DELAY) / flight.period_s
            total = spin_rotors(flight, point, setup.problem.frame).end ** 2 @ strength
            measured.append(flight.run.accelerometer[flight.rows, 2])
            modelled.append(np.interp(late, np.arange(len(total)), total))
    if not measured:
        return np.empty(0), np.empty(0)
    return np.concatenate(measured), np.concatenate(modelled)


def _outcome(
    setup: Setup,
    free: FreeFit,
    effects: tuple[str, ...],
    motor_covariance: Array | None,
    noisy: bool,
) -> BodyFit:
    keys, size = setup.keys, len(setup.keys)
    if not noisy:  # a band tells where all frequencies may not
        require_told(setup, free.point, np.diag(inverse(free.normal)))
    known = certain(setup, free, noisy)
    require_told(setup, known.point, known.alone)
    whole, point, moves = free.point, known.point, known.moves
    if point != whole:  # the constants are others than where the likelihood is largest
        linear = setup.linearise(point)
        left, powers, cost = unfitted(linear)
        free = replace(free, point=point, cost=cost, linear=linear, powers=powers, left=left)
    covariance = np.zeros((size + 1, size + 1))
    covariance[:size, :size] = known.covariance
    thrust, thrust_error = fit_thrust(setup, point)
    missed = between_rows(setup)
    for key in missed.keys() & {*keys}:
        covariance[keys.index(key), keys.index(key)] += (missed[key] * point[key]) ** 2
    covariance[size, size] = thrust_error**2
    if motor_covariance is not None and not setup.problem.flights[0].rotor_measured:
        # How the estimates move with a0, a1, a2.
        normal, _ = setup.linearise(point, MOTOR_KEYS).equations(free.powers)
        moved = []
        for key in MOTOR_KEYS:
            step = BASE_STEPS[key] * point[key]
            there = fit_thrust(setup, {**point, key: point[key] + step})[0]
            moved.append((there - thrust) / step if step else 0.0)
        slopes = np.vstack([-inverse(normal[:size, :size]) @ normal[:size, size:], moved])
        covariance += slopes @ motor_covariance @ slopes.T
    nuisances = {
        key: (value(point, key), float(np.sqrt(covariance[keys.index(key), keys.index(key)])))
        for key in setup.nuisances
    }
    reported = [i for i, key in enumerate(keys) if key not in setup.nuisances] + [size]
    names, found, scale = _reported(setup, {**point, "thrust_per_mass": thrust})
    covariance = covariance[np.ix_(reported, reported)] * np.outer(scale, scale)
    rows = sum(f.last - f.first for f in setup.problem.flights)
    estimates = Estimates(names, found, covariance, rows - size)
    c2, flights, crossed = point["c2"], setup.problem.flights, cross_talk(setup, free)
    reasons = untold(estimates, moves, missed, flights)
    if "c2" in reasons:
        c2 = setup.problem.frame.vehicle.body_constants[2]
    return BodyFit(
        BodyConstants(point["c0"], point["c1"], c2, thrust),
        estimates,
        effects,
        nuisances,
        setup,
        replace(free, point={**point, "thrust_per_mass": thrust}),
        (
            *(
                f"{name} is not identified, because {reason}; the model has the profile's"
                for name, reason in reasons.items()
            ),
            *unused_speeds(flights),
            *given_way(whole, point, flights),
            *warnings_of(estimates, moves, missed),
            *slow_rows(flights[0].run, missed),
            *(line for lines in crossed.values() for line in lines),
        ),
        reasons,
        hints(setup, free, nuisances),
        crossed=tuple(crossed),
    )


def _reported(setup: Setup, point: Point) -> tuple[tuple[str, ...], Array, Array]:
    """Names and values as models hold them, and the derivative of each by the fit's own."""
    names = [key for key in setup.keys if key in CONSTANTS]
    found, scale = [point[key] for key in names], [1.0 for _ in names]
    for keys in setup.variants:
        values = to_values(keys, point)
        slopes = to_stderr(keys, point, {one.key: 1.0 for one in keys})
        for one in keys:
            names.append(f"{one.effect.name}.{one.parameter.name}")
            found.append(values[one.parameter.name])
            falls = one.parameter.unknown is not None
            scale.append(-slopes[one.parameter.name] if falls else slopes[one.parameter.name])
    names.append("thrust_per_mass")
    return tuple(names), np.array([*found, point[names[-1]]]), np.array([*scale, 1.0])


# What past errors of a body model foretell of those to come: trim, air, noise of the sensor.
#
# The sum of the next rows' errors is regressed on fading memories of the errors up to now. Flights
# differ in what they foretell (air, speed, balance), so the weights start as those of the flights
# that were fitted and are learnt on, every half a second, from the flight's own past; no row of
# the future counts.


Learnt = tuple[Array, Array]
"""Normal matrix (m, m) and right-hand side (m,) of the regression, sums over rows."""

MEMORIES_S = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 2.0)
"""Fading times; the first is the last row alone."""
EVERY_S = 0.5
FITTED_S = 2.0
"""The flights that were fitted count as so much of the flight's own past."""
RIDGE = 1e-4
"""Memories of similar length are alike."""


def learnt(series: Sequence[Array], rows: int, period_s: float) -> Learnt:
    """What whole flights' errors (n,) show, as ``FITTED_S`` of one flight."""
    size = len(MEMORIES_S)
    normal, score, seen = np.zeros((size, size)), np.zeros(size), 0
    for errors in series:
        memories, sums = _memories(errors, rows, period_s), _sums(errors, rows)
        normal += memories.T @ memories
        score += memories.T @ sums
        seen += len(sums)
    share = FITTED_S / (max(seen, 1) * period_s)
    return share * normal, share * score


def foretold(errors: Array, rows: int, period_s: float, before: Learnt) -> Array:
    """Sums (n + 1 - rows,) of the next ``rows`` errors, as they are expected before each of them
    (n,), and after the last that has as many to come."""
    memories, sums = _memories(errors, rows, period_s), _sums(errors, rows)
    normal, score = before
    block = max(1, round(EVERY_S / period_s))
    made = np.zeros(len(sums))
    for first in range(0, len(sums), block):
        made[first : first + block] = memories[first : first + block] @ _solved(normal, score)
        # By the next block these sums are over.
        over = slice(max(0, first - rows), max(0, first + block - rows))
        normal = normal + memories[over].T @ memories[over]
        score = score + memories[over].T @ sums[over]
    return made


def _solved(normal: Array, score: Array) -> Array:
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    ridge = RIDGE * np.eye(len(score))
    return np.linalg.solve(normal / np.outer(scale, scale) + ridge, score / scale) / scale


def _sums(errors: Array, rows: int) -> Array:
    total = np.concatenate([[0.0], np.cumsum(errors)])
    return total[rows:] - total[:-rows]


def _memories(errors: Array, rows: int, period_s: float) -> Array:
    """Fading means (n + 1 - rows, m) of the errors before each row, for as many as have
    ``rows`` to come."""
    from scipy.signal import lfilter

    found = np.zeros((len(errors) + 1, len(MEMORIES_S)))
    for i, memory in enumerate(MEMORIES_S):
        keep = math.exp(-period_s / memory) if memory else 0.0
        found[1:, i] = lfilter([1.0 - keep], [1.0, -keep], errors)
    return found[: len(errors) + 1 - rows]


HORIZONS_S = (0.02, 0.05)
SHAKEN_S = 0.05
"""The rotors shake the accelerometer by many times what the craft does: means are compared."""


def validate_body(stretches: Sequence[Stretch], fit: BodyFit) -> dict[str, float]:
    """Held-out figures: per axis the RMS errors at one row, 20 and 50 ms (rad/s) and the fit %
    at 20 and 50 ms, and both for the vertical specific force (m/s^2, means over 50 ms). They are
    those of the model that is saved: what was fitted along and left out does not help it."""
    figures: dict[str, float] = {}
    setup = on_other(fit.setup, stretches)
    for horizon in (0.0, *HORIZONS_S):
        label = f"{horizon * 1e3:.0f}ms" if horizon else "1row"
        pairs = predicted_rates(fit, setup, fit.saved, horizon)
        measured, modelled = map(np.vstack, zip(*pairs, strict=True))
        for axis, name in enumerate(AXES):
            figures[f"gyro_{name}_rms_{label}"] = rms(measured[:, axis] - modelled[:, axis])
            if horizon:
                share = fit_percent(measured[:, axis], modelled[:, axis])
                figures[f"gyro_{name}_fit_percent_{label}"] = share
    measured, squares = vertical(setup, fit.saved)
    rows = max(1, round(SHAKEN_S / stretches[0].run.period_s))
    if len(measured) >= 2 * rows:
        whole = len(measured) // rows * rows
        measured, squares = (
            one[:whole].reshape(-1, rows).mean(axis=1) for one in (measured, squares)
        )
        modelled = fit.body.thrust_per_mass * squares
        figures["accelerometer_z_rms"] = rms(measured - modelled)
        figures["accelerometer_z_fit_percent"] = fit_percent(measured, modelled)
    return figures


def predicted_rates(
    fit: BodyFit, setup: Setup, point: Point, horizon_s: float = 0.0
) -> list[tuple[Array, Array]]:
    """(measured, predicted) rates (k, 3) in rad/s of each flight, predicted ``horizon_s`` before.

    A prediction starts at a measured rate and knows nothing of the future but the motors' inputs:
    the air's moment stays as it is, and what has turned the craft beside the model goes on as
    ``foretold``. The shortest horizon is one row.
    """
    period = setup.problem.flights[0].period_s
    rows = max(1, round(horizon_s / period))
    fitted = fit.setup.residuals(point)
    before = [learnt([one[:, axis] for one in fitted], rows, period) for axis in range(3)]
    found = []
    lasting, residuals = setup.slow_moments(point), setup.residuals(point)
    for flight, left, slow in zip(setup.problem.flights, residuals, lasting, strict=True):
        measured = flight.run.gyro[flight.first - 1 : flight.last]
        expected = np.column_stack(
            [foretold(left[:, axis], rows, period, before[axis]) for axis in range(3)]
        )
        expected += rows * np.vstack([slow[:1], slow[:-1]])[: len(expected)]
        sums = np.vstack([np.zeros(3), np.cumsum(left + slow, axis=0)])
        wrong = sums[rows:] - sums[:-rows] - expected
        found.append((measured[rows:], measured[rows:] - period * wrong))
    return found


def prediction_residuals(stretch: Stretch, fit: BodyFit) -> Array:
    """One-step errors (n, 3) of a fit, whitened by the mean spectrum of the flights it was made
    on, in standard deviations; the first rows are NaN, all where the stretch is shorter than the
    whitener."""
    (left,) = on_other(fit.setup, [stretch]).residuals(fit.point)
    out = np.full(left.shape, np.nan)
    for axis in range(3):
        whitener = minimum_phase_whitener(fit.free, axis)
        if len(left) >= len(whitener):  # numpy exchanges the two where it is shorter
            out[len(whitener) - 1 :, axis] = np.convolve(left[:, axis], whitener, "valid")
    return out


AHEAD_S, DRAWN_S = 0.02, 3.0
KNOCK_G = 4.0
"""What no thrust gives a craft, and rotors that shake an unfiltered accelerometer hardly do."""
OF_THE_MOTORS = {effect.name for stage in ("supply", "motor") for effect in at_stage(stage)}
TESTED_ROWS = 50
"""Held-out residuals from which their correlations tell anything: twice the tests' lags."""
UNTESTED = "the residuals are not tested: the held-out stretch is no longer than their filter"


def identify_body(
    runs: Sequence[Run],
    held: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
    measured: bool = False,
    selection: Selection = EVERYTHING,
    progress: Progress = silent,
) -> Identified:
    """c0, c1, c2, thrust_per_mass and the effects fitted along, from flights.

    before: the motor, with its covariance where it was identified, and effects that act already:
    what this fit knows of them is fitted again. held: what no fit sees (none: ``divided``).
    measured: recorded rotor speeds instead of the motor model.
    """
    pointless = [name for name in effects if name in OF_THE_MOTORS]
    if pointless and measured:
        raise BadInputError(
            f"--with {', '.join(pointless)}: with measured rotor speeds it does not matter what"
            " drives the motors"
        )
    known = [name for name in FIT_WITH if not (measured and name in OF_THE_MOTORS)]
    names = fitted_effects(effects, before, known)
    supplied = [name for name in names if name in SUPPLY_EFFECTS]
    steered, saturated = (runs, []) if measured else by_saturation(runs)
    runs = steered or runs
    progress(0.0, "simulating the motors")
    stretches, supplies = _stretches(runs, before, vehicle, supplied, measured, selection)
    if held:
        fit_on, apart = stretches, ""
        validate_on, _ = _stretches(held, before, vehicle, supplied, measured, selection)
    else:
        fit_on, validate_on, apart = divided(stretches, vehicle.configuration)
    progress(0.2, "fitting the body")
    covariance = None if measured else stated_covariance(before, "motor", MOTOR_KEYS)
    known_motor = measured or "motor" in before.fit or before.motor != vehicle.motor
    fit = fit_body(fit_on, vehicle, names, tie_roll_pitch, covariance, known_motor)
    validate_on = [paced(one, fit.pace[0]) for one in validate_on]
    progress(0.8, "judging it on held-out data")
    rows = sum(len(stretch) for stretch in fit_on)
    traces, residuals = _pictures(validate_on, fit, rows)
    told = late_in(fit.nuisances, TOLD)
    told_not = fit.not_identified.keys()
    account: dict[str, Any] = {
        "what": "body",
        "method": "prediction error, each flight's own noise spectrum",
        "rotor_speed": "measured" if measured else "modelled",
        "samples": rows,
        "rate_hz": 1.0 / runs[0].period_s,
        "selection": str(selection),
        "held_out": apart,
        "estimates": fit.estimates.as_dict(),
        "fitted_along": {key: _stated(*found) for key, found in fit.nuisances.items()},
        "left_out": list(dict.fromkeys([*told, *fit.shown])),
        "motor_pace": _stated(*fit.pace),
        "not_identified": fit.not_identified,
        "record": dict.fromkeys(between_rows(fit.setup).keys() & told_not, EVERY_SETTING),
        "crossed": list(fit.crossed),
        "identification": validate_body(fit_on, fit),
        "validation": validate_body(validate_on, fit),
        "residual_tests": {one.channel: one.as_dict() for one in residuals},
        "supply": [one.as_dict() for one in supplies],
        "warnings": [
            *fit.warnings,
            *(f"{one.name}: left out, a motor is saturated in most rows" for one in saturated),
            *knocks([*fit_on, *validate_on]),
            *_of_the_motors(fit, exact=covariance is None and not measured),
            *([] if residuals else [UNTESTED]),
        ],
    }
    terms = supply_terms(supplied, supplies, _profile(before, vehicle))
    prepared = partial(flight_figures, max(fit_on, key=len), vehicle.configuration)
    evidence = Evidence({"body": fit.estimates}, traces, residuals, (), prepared)
    return Identified(_fitted(before, vehicle, fit, terms), account, evidence)


def knocks(stretches: Sequence[Stretch]) -> list[str]:
    """The hardest knock of each recording that the samples used do not hold, in words."""
    lines = []
    for name in dict.fromkeys(one.run.name for one in stretches):
        here = [one for one in stretches if one.run.name == name]
        hardest, at_s = 0.0, 0.0
        for run in {id(one.run): one.run for one in here}.values():
            force = np.linalg.norm(np.nan_to_num(run.accelerometer), axis=1) / STANDARD_GRAVITY
            for one in here:
                if one.run is run:
                    force[one.rows] = 0.0
            row = int(force.argmax())
            if force[row] > hardest:
                hardest, at_s = force[row], run.time_s[row] - run.recording_start_s
        if hardest > KNOCK_G:
            lines.append(
                f"{name}: a knock of {hardest:.1f} g at {at_s:.1f} s, a landing or a collision, is"
                " not fitted"
            )
    return lines


def _of_the_motors(fit: BodyFit, exact: bool) -> Iterator[str]:
    """Warnings of what was done with the motor's constants, or not known of them."""
    if fit.pace[0] != 1.0:
        percent, doubt = 100.0 * (fit.pace[0] - 1.0), 100.0 * fit.pace[1]
        both = unseen(fit.setup.problem.flights)
        beside = ", which counts as well where rows do not show every setting" if both else ""
        yield (
            f"the motors answer {abs(percent):.0f} +- {doubt:.1f} %"
            f" {'faster' if percent > 0 else 'slower'} than the profile's{beside}: a0, a1, a2 of"
            " the model are changed by as much, which leaves their steady speeds"
        )
    if exact:
        yield (
            "the motor's constants are taken as exact: give a --model whose motor was fitted, and"
            " its uncertainty counts as well"
        )


def _stated(value: float, stderr: float) -> dict[str, float]:
    return {"value": value, "stderr": stderr}


def _fitted(before: Model, vehicle: Vehicle, fit: BodyFit, supply: Sequence[EffectTerm]) -> Model:
    """The model before with what was fitted, the lag of the rotors' sensor among it, and with the
    filters on board that the fit used."""
    terms = [*_terms(fit), *supply]
    # With the lag that the motors' fit found their constants belong together, and PWM turns them.
    told = any(term.name == ALONG.effect for term in before.effects)
    if SENSOR_LAG in fit.nuisances and not told:
        terms += along_term(*fit.nuisances[SENSOR_LAG])
    if fit.setup.problem.frame.gyro_filter_hz > 0.0:
        terms += filter_terms(filters_of(vehicle, fit.setup.problem.flights))
    kept = tuple(term for term in before.effects if term.name not in ON_BOARD)
    return msgspec.structs.replace(
        with_motor(before, quicker(before.motor, fit.pace[0])),
        body=fit.body,
        effects=with_effects(msgspec.structs.replace(before, effects=kept), terms),
    )


def _stretches(
    runs: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    supplied: Sequence[str],
    measured: bool,
    selection: Selection,
) -> tuple[list[Stretch], list[SupplyEstimate]]:
    supplies: list[SupplyEstimate] = []
    if supplied:
        runs, supplies = undo_supply(
            runs, rotor_motors(before), _profile(before, vehicle), supplied
        )
    return stretches_of(runs, rotor_motors(before), measured, selection), supplies


def _profile(before: Model, vehicle: Vehicle) -> Vehicle:
    """The profile, with the wires' resistance of the model where it has one."""
    for term in before.effects:
        if term.name == SAG:
            ohm = term.parameters["resistance_ohm"].value
            battery = msgspec.structs.replace(vehicle.battery, supply_ohm=ohm)
            return msgspec.structs.replace(vehicle, battery=battery)
    return vehicle


def _terms(fit: BodyFit) -> list[EffectTerm]:
    """Effects as models hold them; a mismatched rotor by its number."""
    found = []
    for term in effect_terms(fit.estimates):
        if EFFECTS[term.name].choice is not None:
            (which,) = (keys[0].choice for keys in fit.setup.variants if keys[0].choice)
            rotor = Estimate(float(which), None, "")
            term = EffectTerm(term.name, {"rotor": rotor, **term.parameters})
        found.append(term)
    return found


def _pictures(
    stretches: Sequence[Stretch], fit: BodyFit, fitted_rows: int
) -> tuple[list[Trace], list[ResidualTest]]:
    """Rates predicted 20 ms ahead where they are liveliest, vertical force, and residuals."""
    stretch = max(stretches, key=len)
    period = stretch.run.period_s
    setup = on_other(fit.setup, [stretch])
    ((measured, predicted),) = predicted_rates(fit, setup, fit.saved, AHEAD_S)
    first = stretch.last - len(measured)
    time = stretch.run.time_s[first : stretch.last] - stretch.run.recording_start_s
    traces, residuals = [], []
    for axis, name in enumerate(AXES):
        rows = liveliest(measured[:, axis], period, DRAWN_S)
        shown, ahead = (np.degrees(one[rows, axis]) for one in (measured, predicted))
        note = f"predicted {AHEAD_S * 1e3:.0f} ms ahead"
        traces.append(Trace(f"{name} rate", "deg/s", time[rows], shown, ahead, note))
    force, squares = vertical(setup, fit.saved)
    if len(force):
        width = max(1, round(SHAKEN_S / period))
        force, squares = (
            np.convolve(one, np.ones(width) / width, "valid") for one in (force, squares)
        )
        times = stretch.run.time_s[stretch.rows][width // 2 :] - stretch.run.recording_start_s
        rows = liveliest(squares, period, 2 * DRAWN_S)
        modelled = fit.body.thrust_per_mass * squares[rows]
        note = "from the rotors alone; both averaged over 50 ms, as the rotors shake the sensor"
        series = times[rows], force[rows], modelled
        traces.append(Trace("vertical specific force", "m/s^2", *series, note))
    configuration = setup.problem.frame.vehicle.configuration
    torque = stretch.squares.mixed(configuration)[stretch.rows]
    left = prediction_residuals(stretch, fit)
    for axis, name in enumerate(AXES):
        good = np.isfinite(left[:, axis])
        if good.sum() >= TESTED_ROWS:
            unexplained, driven = left[good, axis], torque[good, axis]
            test = residual_test(f"{name} rate", unexplained, f"{name} u'", driven, fitted_rows)
            residuals.append(test)
    return traces, residuals
