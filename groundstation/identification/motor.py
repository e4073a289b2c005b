"""Grey-box identification of the motor, n' = a0 u - a1 n - a2 n^2 (thesis 7.2).

The motor is stable and the bench has no disturbance to speak of, so the prediction error is the
error of simulation: Levenberg-Marquardt on it with exact sensitivities, all runs together, each
with its own initial speed, and one delay of the readings for all. Inputs are held between rows,
as PWM is (interpolating them biases a2 by 14 %). What is left after the fit decides which
readings were glitches after all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.motor import armature_mv
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError
from groundstation.identification.estimate import Estimates, fit_percent, rms, sandwich
from groundstation.identification.rotor_speed import speed_from_gate
from groundstation.identification.runs import Run

Array = NDArray[np.float64]

NAMES = ("a0", "a1", "a2", "delay_s")
DELAY, SHARED = 3, 4
"""Places among the parameters: the common delay, and the first run's initial speed."""
LONGEST_DELAY_S = 0.03
OUTLIER = 4.5
"""Readings further from the model than so many robust standard deviations are glitches."""
LEAST_READINGS = 200
LEAST_SECONDS = 1.0
WELL_KNOWN = 0.10
"""A parameter less certain than this share of itself is worth a warning."""
ROUNDS, STEPS = 4, 50
SETTLED = 1e-3
"""Rounds end when no more than this share of the readings changes sides."""


@dataclass(frozen=True, slots=True)
class MotorRun:
    """One motor's data over one run.

    voltage_mv: (n,), row i acted from row i - 1 to row i. rev_s: (n,) measured speeds, NaN where
    there is none. age_s: (n,) how much older than its row each measurement is, and jitter_s: (n,)
    how uncertain that is. glitches: share of the readings that never came this far.
    """

    name: str
    period_s: float
    voltage_mv: Array
    rev_s: Array
    age_s: Array
    jitter_s: Array
    glitches: float = 0.0


@dataclass(frozen=True, slots=True)
class MotorFit:
    """Outcome of ``fit_motor``.

    fit_percent, rms_rev_s: per run, over the readings that were used. rejected: share of the
    readings taken for glitches, by the filter and by the fit. warnings: what makes the
    parameters less certain than they look.
    """

    motor: MotorConstants
    estimates: Estimates
    fit_percent: tuple[float, ...]
    rms_rev_s: tuple[float, ...]
    rejected: float
    warnings: tuple[str, ...]


def bench_run(run: Run, motor: int = 0) -> MotorRun:
    """A run of the motor bench: speeds from the gate's periods, voltage by eq. 3.84.

    motor: index of the motor that carries the gate.
    """
    reading = speed_from_gate(run)
    voltage = armature_mv(run.duty, run.supply_v)[:, motor]
    return MotorRun(
        run.name,
        run.period_s,
        voltage,
        reading.rev_s,
        reading.age_s,
        reading.jitter_s,
        reading.glitches,
    )


def measured_run(run: Run, motor: int) -> MotorRun:
    """A run with measured rotor speeds, one of its four motors.

    Raises BadInputError where the recording has no rotor speeds.
    """
    if not np.isfinite(run.rotor_rev_s[:, motor]).any():
        raise BadInputError(
            f"{run.name}: no measured speed of motor {motor + 1}; use a recording of a craft with"
            " a rotor-speed sensor, or of the motor bench"
        )
    voltage = armature_mv(run.duty, run.supply_v)[:, motor]
    return MotorRun(
        f"{run.name} M{motor + 1}",
        run.period_s,
        voltage,
        run.rotor_rev_s[:, motor],
        np.zeros(len(run)),
        np.zeros(len(run)),
    )


def fit_motor(runs: Sequence[MotorRun]) -> MotorFit:
    """Estimate a0, a1, a2 and the readings' delay from all runs together.

    ``estimates`` names a0, a1, a2 and delay_s: what the readings lag beyond their ``age_s``.

    Raises BadInputError for data that cannot tell: too short, not finite, constant voltage or
    speed. Parameters that the data hardly tell are named in ``warnings``.
    """
    if not runs:
        raise BadInputError("motor fit: no runs; give at least one recording")
    for run in runs:
        _require_excited(run)
    weights = [np.isfinite(run.rev_s).astype(np.float64) for run in runs]
    theta = np.array([*_first_constants(runs), 0.0, *[_first_speed(run) for run in runs]])
    rejected, readings = 0, sum(int(np.isfinite(run.rev_s).sum()) for run in runs)
    for attempt in range(ROUNDS):
        theta, normal = _minimise(runs, weights, theta, hold_delay=attempt == 0)
        weights, now_rejected = _weights(runs, theta)
        if attempt > 0 and abs(now_rejected - rejected) <= SETTLED * readings:
            break
        rejected = now_rejected
    return _outcome(runs, weights, theta, normal, rejected)


def simulate_run(run: MotorRun, motor: MotorConstants, delay_s: float = 0.0) -> Array:
    """Modelled values of a run's measurements, (n,); NaN where there is no measurement.

    The simulation starts at the speed that fits the run best, and hears voltages only.
    """
    theta = np.array([motor.a0, motor.a1, motor.a2, delay_s, _first_speed(run)])
    weight = np.isfinite(run.rev_s).astype(np.float64)
    for _ in range(5):
        normal, gradient, _ = _system([run], [weight], theta, _buffers([run]))
        if normal[SHARED, SHARED] > 0:
            theta[SHARED] += gradient[SHARED] / normal[SHARED, SHARED]
    model = np.full(len(run.rev_s), np.nan)
    readings = np.isfinite(run.rev_s)
    model[readings] = _compare([run], theta)[0][1]
    return model


def validate_motor(
    run: MotorRun, motor: MotorConstants, delay_s: float = 0.0
) -> tuple[float, float]:
    """Fit % and RMS error in rev/s of a model on a run it has not seen.

    Readings beyond the fit's limit for glitches do not count, here as there.
    """
    model = simulate_run(run, motor, delay_s)
    readings = np.isfinite(run.rev_s)
    measured, modelled = run.rev_s[readings], model[readings]
    error = measured - modelled
    good = np.abs(error - np.median(error)) <= OUTLIER * _robust_spread(error - np.median(error))
    return fit_percent(measured[good], modelled[good]), rms(error[good])


def _require_excited(run: MotorRun) -> None:
    readings = np.isfinite(run.rev_s)
    if not np.isfinite(run.voltage_mv).all():
        raise BadInputError(
            f"{run.name}: the armature voltage is missing in some rows (no battery voltage or no"
            " PWM); the motor model needs both"
        )
    if readings.sum() < LEAST_READINGS or len(run.rev_s) * run.period_s < LEAST_SECONDS:
        raise BadInputError(
            f"{run.name}: {int(readings.sum())} speed readings in"
            f" {len(run.rev_s) * run.period_s:.1f} s are too few for a motor fit; record longer"
        )
    if run.voltage_mv.std() < 0.01 * max(float(run.voltage_mv.mean()), 1.0):
        raise BadInputError(
            f"{run.name}: the armature voltage is constant; vary the thrust while recording"
        )
    if run.rev_s[readings].mean() < 5.0:
        raise BadInputError(f"{run.name}: the rotor hardly turns; record with the motor running")


def _first_speed(run: MotorRun) -> float:
    readings = np.flatnonzero(np.isfinite(run.rev_s))[:15]
    return float(np.median(run.rev_s[readings]))


def _first_constants(runs: Sequence[MotorRun]) -> Array:
    """Least squares on eq. 3.82 integrated over tenths of a second: no guess needed.

    n(t + T) - n(t) = a0 int u - a1 int n - a2 int n^2, with measured speeds on the right.
    """
    rows, changes = [], []
    for run in runs:
        seen = np.flatnonzero(np.isfinite(run.rev_s))
        speed = np.interp(np.arange(len(run.rev_s)), seen, run.rev_s[seen])
        width = max(round(0.1 / run.period_s), 2)
        sums = np.cumsum(np.column_stack([run.voltage_mv, -speed, -(speed**2)]), axis=0)
        integrals = (sums[width::width] - sums[:-width:width]) * run.period_s
        rows.append(integrals)
        changes.append(speed[width::width] - speed[:-width:width])
    matrix, change = np.vstack(rows), np.concatenate(changes)
    constants, *_ = np.linalg.lstsq(matrix / np.array([1, 1, 100.0]), change, rcond=None)
    a0, a1, a2 = constants / np.array([1, 1, 100.0])
    # Noise on both sides can make one of them negative; the simulation needs a stable start.
    return np.array([a0, a1, a2]) if min(a0, a1, a2) > 0 else _settled_constants(runs)


def _settled_constants(runs: Sequence[MotorRun]) -> Array:
    """A linear motor with a time constant of 0.1 s that reaches the mean speed."""
    volts = np.concatenate([run.voltage_mv[np.isfinite(run.rev_s)] for run in runs])
    speeds = np.concatenate([run.rev_s[np.isfinite(run.rev_s)] for run in runs])
    return np.array([10.0 * speeds.mean() / volts.mean(), 10.0, 0.0])


def _minimise(
    runs: Sequence[MotorRun], weights: list[Array], theta: Array, hold_delay: bool
) -> tuple[Array, Array]:
    """Levenberg-Marquardt; returns the minimum and J^T W J there."""
    damping, buffers = 1e-6, _buffers(runs)
    tolerance = 1e-4 if hold_delay else 1e-8  # the first round only finds the readings' weights
    free = np.array([not (hold_delay and i == DELAY) for i in range(len(theta))])
    normal, gradient, cost = _system(runs, weights, theta, buffers)
    for _ in range(STEPS):
        damped = normal + damping * np.diag(np.maximum(np.diag(normal), 1e-12))
        step = np.zeros(len(theta))
        step[free] = np.linalg.solve(damped[np.ix_(free, free)], gradient[free])
        if float(step @ gradient) <= tolerance * cost:
            break
        trial = theta + step
        new_normal, new_gradient, new_cost = _system(runs, weights, trial, buffers)
        within = abs(trial[DELAY]) <= LONGEST_DELAY_S
        if within and np.isfinite(new_cost) and new_cost <= cost:
            theta, normal, gradient, cost = trial, new_normal, new_gradient, new_cost
            damping = max(damping * 0.1, 1e-12)
        else:
            damping *= 10.0
            if damping > 1e9:
                break
    return theta, normal


Buffers = list[tuple[Array, Array]]
"""Room for each run's speeds and sensitivities, reused from step to step."""


def _buffers(runs: Sequence[MotorRun]) -> Buffers:
    return [(np.empty(len(run.rev_s)), np.empty((len(run.rev_s), 4))) for run in runs]


def _system(
    runs: Sequence[MotorRun], weights: list[Array], theta: Array, buffers: Buffers
) -> tuple[Array, Array, float]:
    from groundstation.identification.motor_kernel import motor_normal_equations

    normal, gradient = np.zeros((len(theta), len(theta))), np.zeros(len(theta))
    cost = 0.0
    for index, (run, weight) in enumerate(zip(runs, weights, strict=True)):
        speed, sensitivity = _simulate(run, theta, SHARED + index, buffers[index])
        scale = np.ones(len(theta))
        scale[DELAY] = 1 / run.period_s
        part, slope = np.zeros_like(normal), np.zeros_like(gradient)
        cost += motor_normal_equations(
            speed,
            sensitivity,
            run.rev_s,
            weight,
            run.age_s / run.period_s,
            theta[DELAY] / run.period_s,
            SHARED + index,
            part,
            slope,
        )
        normal += part * np.outer(scale, scale)
        gradient += slope * scale
    return normal, gradient, cost


def _weights(runs: Sequence[MotorRun], theta: Array) -> tuple[list[Array], int]:
    """Inverse variances of the readings, zero for glitches, and how many of these there are.

    While the speed changes, a reading's uncertain age makes it less certain; what remains at
    steady speed is the reading's own noise.
    """
    errors, timing = [], []
    for index, (run, (measured, modelled)) in enumerate(
        zip(runs, _compare(runs, theta), strict=True)
    ):
        rows = np.flatnonzero(np.isfinite(run.rev_s))
        slope = np.gradient(_simulate(run, theta, SHARED + index)[0], run.period_s)
        errors.append(measured - modelled)
        timing.append(_at_age(run, rows, slope, theta[DELAY]) * run.jitter_s[rows])
    error, jitter = np.concatenate(errors), np.abs(np.concatenate(timing))
    steady = jitter <= np.median(jitter)
    noise = _robust_spread(error[steady])
    rejected, weights = 0, []
    for run, one, late in zip(runs, errors, timing, strict=True):
        variance = noise**2 + late**2
        good = one**2 <= OUTLIER**2 * variance
        weight = np.zeros(len(run.rev_s))
        weight[np.isfinite(run.rev_s)] = good / variance
        rejected += int((~good).sum())
        weights.append(weight)
    return weights, rejected


def _simulate(
    run: MotorRun, theta: Array, initial: int, buffers: tuple[Array, Array] | None = None
) -> tuple[Array, Array]:
    from groundstation.identification.motor_kernel import motor_sensitivities

    speed, sensitivity = buffers or _buffers([run])[0]
    motor_sensitivities(theta[:3], run.voltage_mv, run.period_s, theta[initial], speed, sensitivity)
    return speed, sensitivity


def _compare(runs: Sequence[MotorRun], theta: Array) -> list[tuple[Array, Array]]:
    """(measured, modelled) of each run's readings."""
    pairs = []
    for index, run in enumerate(runs):
        speed, _ = _simulate(run, theta, SHARED + index)
        rows = np.flatnonzero(np.isfinite(run.rev_s))
        pairs.append((run.rev_s[rows], _at_age(run, rows, speed, theta[DELAY])))
    return pairs


def _at_age(run: MotorRun, rows: NDArray[np.intp], series: Array, delay_s: float) -> Array:
    """A modelled series at the time each reading was taken."""
    place = np.clip(rows - (run.age_s[rows] + delay_s) / run.period_s, 0, len(series) - 1)
    return np.interp(place, np.arange(len(series)), series)


def _robust_spread(errors: ArrayLike) -> float:
    return 1.4826 * float(np.median(np.abs(errors))) + 1e-9


def _outcome(
    runs: Sequence[MotorRun],
    weights: list[Array],
    theta: Array,
    normal: Array,
    rejected: int,
) -> MotorFit:
    scores, fits, errors, readings = [], [], [], 0
    for index, (run, weight, (measured, modelled)) in enumerate(
        zip(runs, weights, _compare(runs, theta), strict=True)
    ):
        rows = np.flatnonzero(np.isfinite(run.rev_s))
        used = weight[rows] > 0
        speed, sensitivity = _simulate(run, theta, SHARED + index)
        slope = -np.gradient(speed, run.period_s)
        jacobian = np.zeros((len(rows), len(theta)))
        for target, series in zip(
            (0, 1, 2, SHARED + index, DELAY), (*sensitivity.T, slope), strict=True
        ):
            jacobian[:, target] = _at_age(run, rows, series, theta[DELAY])
        score = jacobian * ((measured - modelled) * weight[rows])[:, None]
        scores.append(_block_sums(score, rows, run))
        fits.append(fit_percent(measured[used], modelled[used]))
        errors.append(rms((measured - modelled)[used]))
        readings += len(rows)
    blocks = np.vstack(scores)
    covariance = sandwich(normal, blocks)
    estimates = Estimates(
        NAMES, theta[:SHARED], covariance[:SHARED, :SHARED], max(len(blocks) - len(theta), 1)
    )
    filtered = float(np.mean([run.glitches for run in runs]))
    share = filtered + (1 - filtered) * rejected / readings
    motor = MotorConstants(*(float(value) for value in theta[:3]))
    return MotorFit(
        motor, estimates, tuple(fits), tuple(errors), share, _warnings(estimates, share)
    )


def _block_sums(score: Array, rows: NDArray[np.intp], run: MotorRun) -> Array:
    """Sums over blocks of half a second, longer where that would be too many to be independent."""
    length = max(round(0.5 / run.period_s), len(run.rev_s) // 100)
    block = rows // length
    sums = np.zeros((int(block.max()) + 1, score.shape[1]))
    np.add.at(sums, block, score)
    return sums


def _warnings(estimates: Estimates, rejected: float) -> tuple[str, ...]:
    lines = []
    for name, value, error in zip(estimates.names, estimates.values, estimates.stderr, strict=True):
        if name == "delay_s":
            continue
        if error > WELL_KNOWN * abs(value):
            share = 100 * error / abs(value) if value else np.inf
            lines.append(
                f"{name} is hardly excited: uncertain by {share:.0f} %; vary the voltage more"
            )
        elif name != "a2" and value < 0:
            lines.append(f"{name} is negative: the data do not come from this kind of motor")
    if rejected > 0.3:
        lines.append(f"{100 * rejected:.0f} % of the readings were rejected as glitches")
    return tuple(lines)
