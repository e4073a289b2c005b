"""Grey-box identification of the motor, n' = a0 u - a1 n - a2 n^2 (thesis 7.2).

The motor is stable and the bench has no disturbance to speak of, so the prediction error is the
error of simulation: least squares on it with exact sensitivities, all runs together, each
with its own initial speed, and one delay of the readings for all. Inputs are held between rows,
as PWM is (interpolating them biases a2 by 14 %). What is left after the fit decides which
readings were glitches after all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.registry import EFFECTS as CATALOGUE
from groundstation.dynamics.simulation import armature_mv
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError
from groundstation.identification.estimate import Estimates, fit_percent, rms, sandwich
from groundstation.identification.motor.problem import (
    EFFECTS,
    OUTLIER,
    SHARED,
    MotorProblem,
    MotorRun,
    robust_spread,
)
from groundstation.identification.motor.rotor_speed import speed_from_gate
from groundstation.identification.runs import Run, require_known
from groundstation.telemetry.arrays import Array

NAMES = ("a0", "a1", "a2", "delay_s")
LEAST_READINGS = 200
LEAST_SECONDS = 1.0
WELL_KNOWN, UNKNOWN = 0.10, 0.60
"""Standard error over the value from which a parameter is worth a warning, and from which a0 or a1
is not identified."""
ALIKE = 0.995
CLEAR = 2.0
"""Standard errors from which a delay is told from none."""
ROUNDS = 4
SETTLED = 1e-3
"""Rounds end when no more than this share of the readings changes sides."""


@dataclass(frozen=True, slots=True)
class MotorFit:
    """Outcome of ``fit_motor``.

    estimates: a0, a1, a2, delay_s (what the readings lag beyond their ``age_s``), and one
    ``effect.parameter`` for each effect. fit_percent, rms_rev_s: per run, over the readings that
    were used. rejected: share of the readings taken for glitches, by the filter and by the fit.
    warnings: what makes the parameters less certain than they look.
    """

    motor: MotorConstants
    estimates: Estimates
    effects: tuple[str, ...]
    fit_percent: tuple[float, ...]
    rms_rev_s: tuple[float, ...]
    rejected: float
    warnings: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        """``effect.parameter`` of the effects that were fitted along."""
        return {name: self.estimates[name] for name in self.estimates.names if "." in name}


def bench_run(run: Run, motor: int = 0) -> MotorRun:
    """A run of the motor bench: speeds from the gate's periods, voltage by eq. 3.84.

    motor: index of the motor that carries the gate.
    """
    require_known(run, ("duty", "supply_v"), "the motor model needs both")
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


def fit_motor(runs: Sequence[MotorRun], effects: Sequence[str] = ()) -> MotorFit:
    """Estimate a0, a1, a2 and the readings' delay from all runs together.

    effects: of ``motor_dead_voltage`` and ``motor_braking_asymmetry``, what is known to be there.

    A negative a2 is none: it is set to zero then, a motor of first order, and the rest fitted anew.

    Raises BadInputError for data that cannot tell: too short, not finite, constant voltage or
    speed, a0 or a1 that would not be positive or are not identified. Parameters that the data
    hardly tell are named in ``warnings``.
    """
    require_usable(runs)
    problem = MotorProblem(runs, effects)
    weights = [np.isfinite(run.rev_s).astype(np.float64) for run in runs]
    theta = problem.theta(first_constants(runs))
    rejected, readings = 0, sum(int(np.isfinite(run.rev_s).sum()) for run in runs)
    for attempt in range(ROUNDS):
        theta = problem.minimise(weights, theta, coarse=attempt == 0)
        weights, now_rejected = problem.weights(theta)
        if attempt > 0 and abs(now_rejected - rejected) <= SETTLED * readings:
            break
        rejected = now_rejected
    if theta[2] < 0.0:
        problem.first_order, theta[2] = True, 0.0
        theta = problem.minimise(weights, theta)
    _require_motor(theta, runs)
    found = _outcome(problem, weights, theta, rejected)
    _require_certain(found.estimates, runs)
    return found


def first_constants(runs: Sequence[MotorRun]) -> Array:
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


def simulate_run(
    run: MotorRun,
    motor: MotorConstants,
    delay_s: float = 0.0,
    effects: Mapping[str, float] | None = None,
) -> Array:
    """Modelled values of a run's measurements, (n,); NaN where there is no measurement.

    The simulation starts at the speed that fits the run best, and hears voltages only.
    effects: ``effect.parameter`` and value.
    """
    given = {name.partition(".")[0]: value for name, value in (effects or {}).items()}
    problem = MotorProblem([run], tuple(given))
    theta = problem.theta([motor.a0, motor.a1, motor.a2], delay_s)
    theta[SHARED : problem.starts] = list(given.values())
    weight = np.isfinite(run.rev_s).astype(np.float64)
    for _ in range(5):
        slope = problem.jacobian([weight], theta)[:, -1]
        if slope.any():
            theta[-1] -= slope @ problem.errors([weight], theta) / (slope @ slope)
    model = np.full(len(run.rev_s), np.nan)
    model[np.isfinite(run.rev_s)] = problem.compare(theta)[0][1]
    return model


def delay_in_words(estimates: Estimates) -> str:
    """What the estimated delay of the readings says: readings cannot be ahead of what they show."""
    value = estimates["delay_s"]
    error = float(estimates.stderr[estimates.names.index("delay_s")])
    if value > CLEAR * error:
        return f"the readings are {1e3 * value:.2g} ms late, beyond their own age"
    most = f"less than {1e3 * (max(value, 0.0) + CLEAR * error):.2g} ms, if any"
    if value >= -CLEAR * error:
        return f"delay_s: no delay of the readings can be told ({most})"
    return (
        f"delay_s would put the readings {-1e3 * value:.2g} ms ahead of what they show: stamps or"
        " voltage are late in the recording, or something else is missing"
    )


def validate_motor(
    run: MotorRun,
    motor: MotorConstants,
    delay_s: float = 0.0,
    effects: Mapping[str, float] | None = None,
) -> tuple[float, float]:
    """Fit % and RMS error in rev/s of a model on a run it has not seen.

    Readings beyond the fit's limit for glitches do not count, here as there.
    """
    model = simulate_run(run, motor, delay_s, effects)
    rows = credible_rows(run, model)
    return fit_percent(run.rev_s[rows], model[rows]), rms(run.rev_s[rows] - model[rows])


def credible_rows(run: MotorRun, model: Array) -> NDArray[np.intp]:
    """The rows with readings that are no glitches, seen from a model of them (n,)."""
    rows = np.flatnonzero(np.isfinite(run.rev_s))
    error = run.rev_s[rows] - model[rows]
    centred = error - np.median(error)
    return rows[np.abs(centred) <= OUTLIER * robust_spread(centred)]


def require_usable(runs: Sequence[MotorRun]) -> None:
    """Raises BadInputError for runs that no fit should see, each with its reason."""
    if not runs:
        raise BadInputError("motor fit: no runs; give at least one recording")
    for run in runs:
        readings = np.isfinite(run.rev_s)
        if not np.isfinite(run.voltage_mv).all():
            raise BadInputError(
                f"{run.name}: the armature voltage is missing in some rows (no battery voltage or"
                " no PWM); the motor model needs both"
            )
        if readings.sum() < LEAST_READINGS or len(run.rev_s) * run.period_s < LEAST_SECONDS:
            raise BadInputError(
                f"{run.name}: {int(readings.sum())} speed readings in"
                f" {len(run.rev_s) * run.period_s:.1f} s are too few for a motor fit; record"
                " longer"
            )
        if run.voltage_mv.std() < 0.01 * max(float(run.voltage_mv.mean()), 1.0):
            raise BadInputError(
                f"{run.name}: the armature voltage is constant; vary the thrust while recording"
            )
        if run.rev_s[readings].mean() < 5.0:
            raise BadInputError(
                f"{run.name}: the rotor hardly turns; record with the motor running"
            )


def _require_motor(theta: Array, runs: Sequence[MotorRun]) -> None:
    """Raises BadInputError where a0 or a1 would not be those of a motor."""
    for name, value in zip(("a0", "a1"), theta, strict=False):
        if value <= 0.0:
            names = ", ".join(dict.fromkeys(run.name for run in runs))
            raise BadInputError(
                f"{names}: {name} is not identified, because the voltage hardly varies or the speed"
                f" does not follow it (it would be {value:.3g}, and no motor has that); vary the"
                " thrust between 30 and 90 % duty, and see that the sensor is on the motor fitted"
            )


def _require_certain(estimates: Estimates, runs: Sequence[MotorRun]) -> None:
    """Raises BadInputError where a0 or a1 is known to its own size only."""
    for name, value, error in zip(("a0", "a1"), estimates.values, estimates.stderr, strict=False):
        if error > UNKNOWN * value:
            names = ", ".join(dict.fromkeys(run.name for run in runs))
            raise BadInputError(
                f"{names}: {name} is not identified, because the voltage hardly varies: uncertain"
                f" by {100 * error / value:.0f} %; vary the thrust over a wider range, from 30 to"
                " 90 % duty"
            )


def _settled_constants(runs: Sequence[MotorRun]) -> Array:
    """A linear motor with a time constant of 0.1 s that reaches the mean speed."""
    volts = np.concatenate([run.voltage_mv[np.isfinite(run.rev_s)] for run in runs])
    speeds = np.concatenate([run.rev_s[np.isfinite(run.rev_s)] for run in runs])
    return np.array([10.0 * speeds.mean() / volts.mean(), 10.0, 0.0])


def _outcome(
    problem: MotorProblem,
    weights: Sequence[Array],
    theta: Array,
    rejected: int,
) -> MotorFit:
    fits, errors, readings = [], [], 0
    for run, weight, (measured, modelled) in zip(
        problem.runs, weights, problem.compare(theta), strict=True
    ):
        used = weight[np.isfinite(run.rev_s)] > 0
        fits.append(fit_percent(measured[used], modelled[used]))
        errors.append(rms((measured - modelled)[used]))
        readings += len(measured)
    blocks = problem.scores(weights, theta)
    shared, jacobian = problem.starts, problem.jacobian(weights, theta)
    normal = jacobian.T @ jacobian
    covariance = sandwich(normal, blocks)[:shared, :shared]
    names = (*NAMES, *(f"{name}.{EFFECTS[name].name}" for name in problem.effects))
    freedom = max(len(blocks) - len(theta), 1)
    estimates = Estimates(names, theta[:shared], covariance, freedom)
    filtered = float(np.mean([run.glitches for run in problem.runs]))
    share = filtered + (1 - filtered) * rejected / readings
    motor = MotorConstants(*(float(value) for value in theta[:3]))
    return MotorFit(
        motor,
        estimates,
        problem.effects,
        tuple(fits),
        tuple(errors),
        share,
        _warnings(estimates, share),
    )


def _warnings(estimates: Estimates, rejected: float) -> tuple[str, ...]:
    lines = []
    for name, value, error in zip(estimates.names, estimates.values, estimates.stderr, strict=True):
        effect, dot, parameter = name.partition(".")
        if dot:
            known = CATALOGUE[effect].parameter(parameter)
            outside = max(known.low - value, value - known.high, 0.0)
            if outside > 2 * error and abs(value - known.absent) > 2 * error:
                lines.append(
                    f"{name} is {value:.3g} +- {error:.2g} {known.unit}, outside the plausible"
                    f" {known.low:g} to {known.high:g}: something else may be missing"
                )
        elif name == "a2" and value == 0.0:
            lines.append(f"a2 would be negative and is 0 +- {error:.2g}: a motor of first order")
        elif name != "delay_s" and error > WELL_KNOWN * abs(value):
            share = 100 * error / abs(value)
            lines.append(
                f"{name} is hardly excited: uncertain by {share:.0f} %; vary the voltage more"
            )
    if abs(estimates.correlation[1, 2]) > ALIKE:
        lines.append(
            f"a1 and a2 are told only together (correlation {estimates.correlation[1, 2]:+.3f});"
            " record a wider range of speeds"
        )
    if rejected > 0.3:
        lines.append(f"{100 * rejected:.0f} % of the readings were rejected as glitches")
    return tuple(lines)
