"""Grey-box identification of the body from closed-loop flights (thesis 7.3.6).

A quadrotor flies in closed loop and its rates are the integral of torque: to simulate it freely
over a flight would compare a diverging integral with a stabilised one. Here each axis is
predicted one row ahead with an autoregressive noise model, which holds torque noise, sensor
noise and vibration. The initial rates drop out with the first difference. Gauss-Newton over
c0, c1, c2 and the effects fitted along, noise models re-estimated in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import BodyConstants
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body_terms import (
    FIT_WITH,
    Stretch,
    Terms,
    require_known,
    terms_of,
)
from groundstation.identification.estimate import Estimates, fit_percent, inverse, rms, sandwich
from groundstation.identification.noise_model import NoiseModel, estimate_noise

Array = NDArray[np.float64]

NOISE_ORDER = 60
NOISE_ROUNDS, STEPS = 10, 15
SETTLED = 0.05
"""Rounds end when no parameter moves by more than this share of its standard error."""
TRIAL_DELAYS_S = np.arange(0.0, 0.021, 0.004)
LONGEST_DELAY_S, LARGEST_STEP_S = 0.03, 0.001
CLEAR = 6.0
"""Standard errors from which an effect that was left out is worth a word."""
CROSS_TALK = 0.3
"""Share of an axis's own torque constant that another axis's torque may seem to have."""
WELL_KNOWN, UNKNOWN = 0.05, 0.5
"""Standard errors over the value from which a constant is worth a warning, or a refusal."""
HORIZONS_S = (0.02, 0.05)
AXES = ("roll", "pitch", "yaw")
PARAMETERS = {
    "dead_time": "delay_s",
    "inertia_coupling": "fraction",
    "rotor_gyroscopic_torque": "rotor_inertia_kg_m2",
    "rotor_acceleration_torque": "rotor_inertia_kg_m2",
}
"""The parameter of each effect that can be fitted along."""


@dataclass(frozen=True, slots=True)
class BodyFit:
    """Outcome of ``fit_body``.

    estimates: c0, c1, c2, thrust_per_mass and one ``effect.parameter`` for each effect.
    noise: per axis. innovation: (3,) RMS of the gyro's one-step
    prediction error in rad/s.
    """

    body: BodyConstants
    estimates: Estimates
    effects: tuple[str, ...]
    noise: tuple[NoiseModel, ...]
    innovation: Array
    warnings: tuple[str, ...]

    @property
    def delay_s(self) -> float:
        """The dead time that was fitted, otherwise 0."""
        return self.estimates["dead_time.delay_s"] if "dead_time" in self.effects else 0.0


def fit_body(
    stretches: Sequence[Stretch],
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
) -> BodyFit:
    """Estimate c0, c1, c2 and thrust_per_mass from all stretches together.

    effects: names in ``FIT_WITH`` that are known to be there. tie_roll_pitch: c1 = c0, as in the
    thesis. vehicle: configuration, and the inertias that scale the effects.

    Raises BadInputError for stretches without torque or motion. What the data hardly tell is
    named in ``warnings``.
    """
    require_known(effects)
    if not stretches:
        raise BadInputError("body fit: nothing to fit on; give a longer recording")
    _require_excited(stretches, vehicle)
    problem = _Problem(stretches, vehicle, tuple(effects), tie_roll_pitch)
    theta = problem.start()
    noise: list[NoiseModel] = []
    normal = np.zeros((len(theta), len(theta)))
    for _ in range(NOISE_ROUNDS):
        noise = problem.noise(theta)
        before = theta
        theta, normal = problem.minimise(theta, noise)
        if np.all(np.abs(theta - before) * np.sqrt(np.diag(normal)) < SETTLED):
            break
    _require_told(problem, theta, inverse(normal), stretches)
    thrust = _thrust(stretches, _delay(theta, problem))
    return _outcome(problem, theta, inverse(normal), thrust, noise)


def prediction_errors(
    stretches: Sequence[Stretch],
    body: BodyConstants,
    vehicle: Vehicle,
    delay_s: float = 0.0,
    horizon_s: float = 0.0,
) -> Array:
    """RMS errors (3,) in rad/s of rates predicted ``horizon_s`` ahead of a measured one.

    The shortest horizon is one row. Nothing is known of the future but the motors' inputs.
    """
    errors = []
    for stretch in stretches:
        terms = terms_of(stretch, vehicle, delay_s, ())
        step = terms.acceleration - terms.base * [body.c0, body.c1, body.c2]
        rows = max(1, round(horizon_s / stretch.run.period_s))
        sums = np.vstack([np.zeros(3), np.cumsum(step, axis=0)]) * stretch.run.period_s
        errors.append(sums[rows:] - sums[:-rows])
    return np.sqrt(np.mean(np.square(np.vstack(errors)), axis=0))


def validate_body(stretches: Sequence[Stretch], fit: BodyFit, vehicle: Vehicle) -> dict[str, float]:
    """Held-out figures: per axis the RMS errors at one row, 20 and 50 ms (rad/s), and the fit %
    of the vertical specific force (m/s^2)."""
    figures: dict[str, float] = {}
    for horizon in (0.0, *HORIZONS_S):
        label = f"{horizon * 1e3:.0f}ms" if horizon else "1row"
        errors = prediction_errors(stretches, fit.body, vehicle, fit.delay_s, horizon)
        for axis, error in zip(AXES, errors, strict=True):
            figures[f"gyro_{axis}_rms_{label}"] = float(error)
    measured, modelled = _vertical(stretches, fit.delay_s)
    if len(measured):
        error = measured - fit.body.thrust_per_mass * modelled
        figures["accelerometer_z_rms"] = rms(error)
        figures["accelerometer_z_fit_percent"] = fit_percent(
            measured, fit.body.thrust_per_mass * modelled
        )
    return figures


def fit_free_run(stretches: Sequence[Stretch], vehicle: Vehicle) -> Array:
    """c0, c1, c2 by simulating whole stretches and matching the rates: what not to do.

    Kept to be shown beside ``fit_body``: every torque disturbance stays in the integral for ever,
    and in closed loop the controller's answer to it is taken for the cause.
    """
    found = np.zeros(3)
    for axis in range(3):
        top, bottom = 0.0, 0.0
        for stretch in stretches:
            terms = terms_of(stretch, vehicle, 0.0, ())
            simulated = np.cumsum(terms.base[:, axis]) * stretch.run.period_s
            rate = stretch.run.gyro[stretch.rows, axis]
            simulated, rate = simulated - simulated.mean(), rate - rate.mean()
            top += float(simulated @ rate)
            bottom += float(simulated @ simulated)
        found[axis] = top / bottom
    return found


class _Problem:
    """The least-squares problem: parameters are c0, (c1,) c2, then one per effect."""

    def __init__(
        self,
        stretches: Sequence[Stretch],
        vehicle: Vehicle,
        effects: tuple[str, ...],
        tied: bool,
    ) -> None:
        self.stretches, self.vehicle, self.effects = stretches, vehicle, effects
        self.tied = tied
        self.base = (0, 0, 1) if tied else (0, 1, 2)
        """Place of each axis's constant among the parameters."""
        count = max(self.base) + 1
        self.names: tuple[str, ...] = ("c0", "c2") if tied else ("c0", "c1", "c2")
        self.names += tuple(f"{name}.{PARAMETERS[name]}" for name in effects)
        self.place = {name: count + i for i, name in enumerate(effects)}

    def start(self) -> Array:
        """A fit that trusts slow motion, at the best of some trial delays.

        The noise model must not come from a residual that still holds the torque: it would take
        the torque for noise and keep it. So the first one is a guess, sensor noise on a rate
        that is disturbed: A = 1 / (1 - 0.9 q^-1).
        """
        whitener = np.asarray(0.9 ** np.arange(NOISE_ORDER + 1), np.float64)
        noise = [
            NoiseModel(whitener, float(np.mean(np.square(np.concatenate(pieces)))))
            for pieces in self.residuals(np.zeros(len(self.names)))
        ]
        trials = []
        for delay in TRIAL_DELAYS_S if "dead_time" in self.effects else (0.0,):
            theta = np.zeros(len(self.names))
            if "dead_time" in self.effects:
                theta[self.place["dead_time"]] = delay
            theta, _ = self.minimise(theta, noise, hold_delay=True)
            trials.append((self.cost(theta, noise), theta))
        return min(trials, key=lambda one: one[0])[1]

    def cost(self, theta: Array, noise: Sequence[NoiseModel]) -> float:
        """Sum of squared one-step prediction errors over their variances."""
        return sum(
            float(np.square(one.whiten(piece)).sum()) / one.variance
            for pieces, one in zip(self.residuals(theta), noise, strict=True)
            for piece in pieces
        )

    def terms(self, theta: Array) -> list[Terms]:
        delay = float(theta[self.place["dead_time"]]) if "dead_time" in self.effects else 0.0
        return [terms_of(s, self.vehicle, delay, self.effects) for s in self.stretches]

    def residuals(self, theta: Array) -> list[list[Array]]:
        """Per axis, one residual acceleration (n,) per stretch."""
        every = self.terms(theta)
        return [
            [terms.acceleration[:, axis] - self.model(terms, theta, axis) for terms in every]
            for axis in range(3)
        ]

    def model(self, terms: Terms, theta: Array, axis: int) -> Array:
        value = theta[self.base[axis]] * terms.base[:, axis]
        for name, column in terms.effects.items():
            value = value + theta[self.place[name]] * column[:, axis]
        return value

    def noise(self, theta: Array) -> list[NoiseModel]:
        return [estimate_noise(pieces, NOISE_ORDER) for pieces in self.residuals(theta)]

    def minimise(
        self,
        theta: Array,
        noise: Sequence[NoiseModel],
        hold_delay: bool = False,
        steps: int = STEPS,
    ) -> tuple[Array, Array]:
        """Gauss-Newton for fixed noise models; returns the minimum and J^T W J there."""
        normal = np.zeros((len(theta), len(theta)))
        linear = hold_delay or "dead_time" not in self.effects
        most, direction = LARGEST_STEP_S, 0.0
        for _ in range(1 if linear else steps):
            normal[:], gradient = 0.0, np.zeros(len(theta))
            for terms in self.terms(theta):
                for axis in range(3):
                    jacobian = self.jacobian(terms, theta, axis, hold_delay)
                    error = terms.acceleration[:, axis] - self.model(terms, theta, axis)
                    white = noise[axis].whiten(np.column_stack([jacobian, error]))
                    normal += white[:, :-1].T @ white[:, :-1] / noise[axis].variance
                    gradient += white[:, :-1].T @ white[:, -1] / noise[axis].variance
            change = inverse(normal) @ gradient
            if not linear:
                place = self.place["dead_time"]
                if change[place] * direction < 0.0:
                    most *= 0.5  # it steps to and fro over the minimum
                direction = float(change[place])
                wanted = theta[place] + np.clip(change[place], -most, most)
                change[place] = np.clip(wanted, 0.0, LONGEST_DELAY_S) - theta[place]
            theta = theta + change
            if np.all(np.abs(change) * np.sqrt(np.diag(normal)) < 1e-3):
                break
        return theta, normal

    def cross_talk(self, theta: Array, noise: Sequence[NoiseModel]) -> list[str]:
        """Axes whose rate answers to another axis's torque as well: rotors in other places."""
        lines = []
        for axis, name in enumerate(AXES):
            normal, gradient = np.zeros((3, 3)), np.zeros(3)
            for terms in self.terms(theta):
                white = noise[axis].whiten(
                    np.column_stack([terms.base, terms.acceleration[:, axis]])
                )
                normal += white[:, :3].T @ white[:, :3] / noise[axis].variance
                gradient += white[:, :3].T @ white[:, 3] / noise[axis].variance
            covariance = inverse(normal)
            gain, error = covariance @ gradient, np.sqrt(np.diag(covariance))
            for other in {0, 1, 2} - {axis}:
                large = abs(gain[other]) > CROSS_TALK * abs(gain[axis])
                if large and abs(gain[other]) > 5 * error[other]:
                    lines.append(
                        f"{name} turns with the torque about {AXES[other]} as well"
                        f" ({gain[other] / gain[axis]:+.0%}): is the profile's configuration"
                        f" '{self.vehicle.configuration}' the craft's?"
                    )
        return lines

    def hints(self, theta: Array, noise: Sequence[NoiseModel]) -> list[str]:
        """Effects that were not fitted along although the prediction errors show them clearly."""
        lines = []
        for name in FIT_WITH:
            if name in self.effects:
                continue
            wider = _Problem(self.stretches, self.vehicle, (*self.effects, name), self.tied)
            start = np.append(theta, 0.0)
            after, normal = wider.minimise(start, noise, steps=1)
            error = float(np.sqrt(inverse(normal)[-1, -1]))
            if abs(after[-1]) > CLEAR * error:
                lines.append(f"the data clearly show {name}; fit it along: --with {name}")
        return lines

    def jacobian(self, terms: Terms, theta: Array, axis: int, hold_delay: bool) -> Array:
        columns = np.zeros((len(terms.base), len(theta)))
        columns[:, self.base[axis]] = terms.base[:, axis]
        for name, column in terms.effects.items():
            columns[:, self.place[name]] = column[:, axis]
        if "dead_time" in self.effects and not hold_delay:
            columns[:, self.place["dead_time"]] = theta[self.base[axis]] * terms.slope[:, axis]
        return columns


def _require_excited(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    period = stretches[0].run.period_s
    for stretch in stretches:
        if abs(stretch.run.period_s / period - 1) > 0.01:
            raise BadInputError(
                f"{stretch.run.name}: {1 / stretch.run.period_s:.0f} rows a second, others"
                f" {1 / period:.0f}; the noise model needs one rate: fit them apart"
            )
        terms = terms_of(stretch, vehicle, 0.0, ())
        for axis, name in enumerate(AXES):
            if np.ptp(terms.base[:, axis]) == 0.0 or np.ptp(terms.acceleration[:, axis]) == 0.0:
                raise BadInputError(
                    f"{stretch.run.name}: torque or rate about {name} is constant;"
                    " fly, and move all three axes"
                )


def _require_told(
    problem: _Problem, theta: Array, covariance: Array, stretches: Sequence[Stretch]
) -> None:
    """A constant that may as well be zero is no model."""
    for axis, place in zip(AXES, problem.base, strict=True):
        error = float(np.sqrt(covariance[place, place]))
        if not np.isfinite(theta[place]) or error > UNKNOWN * abs(theta[place]):
            names = ", ".join(sorted({stretch.run.name for stretch in stretches}))
            raise BadInputError(
                f"{names}: torque does not show in the rate about {axis} (its constant is"
                f" {theta[place]:.3g} +- {error:.2g}); was the craft free to turn, and is the"
                " vehicle profile the right one?"
            )


def _delay(theta: Array, problem: _Problem) -> float:
    place = problem.place.get("dead_time")
    return 0.0 if place is None else float(theta[place])


def _vertical(stretches: Sequence[Stretch], delay_s: float) -> tuple[Array, Array]:
    """Measured specific force along z (m/s^2) and the sum of squared rotor speeds behind it."""
    measured, modelled = [], []
    for stretch in stretches:
        force = stretch.run.accelerometer[stretch.rows, 2]
        if np.isfinite(force).all():
            late = np.arange(stretch.first, stretch.last) - delay_s / stretch.run.period_s
            total = stretch.squares.end.sum(axis=1)
            measured.append(force)
            modelled.append(np.interp(late, np.arange(len(total)), total))
    if not measured:
        return np.empty(0), np.empty(0)
    return np.concatenate(measured), np.concatenate(modelled)


def _thrust(stretches: Sequence[Stretch], delay_s: float) -> tuple[float, float]:
    """thrust_per_mass and its standard error.

    Plain least squares through the origin, so that the mean counts, which is known best; its
    error allows for slow disturbances (climbs, drag), which a noise model would take for signal.
    """
    measured, squares = _vertical(stretches, delay_s)
    if not len(measured):
        names = ", ".join(sorted({s.run.name for s in stretches}))
        raise BadInputError(f"{names}: no accelerometer, so thrust_per_mass cannot be fitted")
    normal = float(squares @ squares)
    value = float(measured @ squares) / normal
    score = squares * (measured - value * squares)
    block = max(round(0.5 / stretches[0].run.period_s), 1)
    sums = np.add.reduceat(score, np.arange(0, len(score), block))
    covariance = sandwich(np.array([[normal]]), sums[:, None])
    return value, float(np.sqrt(covariance[0, 0]))


def _outcome(
    problem: _Problem,
    theta: Array,
    covariance: Array,
    thrust: tuple[float, float],
    noise: Sequence[NoiseModel],
) -> BodyFit:
    value, stderr = thrust
    c0, c1, c2 = (float(theta[place]) for place in problem.base)
    size = len(theta)
    total = np.zeros((size + 1, size + 1))
    total[:size, :size], total[size, size] = covariance, stderr**2
    names = (*problem.names, "thrust_per_mass")
    rows = sum(len(stretch) for stretch in problem.stretches)
    estimates = Estimates(names, np.append(theta, value), total, rows - size)
    period = problem.stretches[0].run.period_s
    innovation = np.asarray(period * np.sqrt([one.variance for one in noise]), np.float64)
    return BodyFit(
        BodyConstants(c0, c1, c2, value),
        estimates,
        problem.effects,
        tuple(noise),
        innovation,
        (
            *_warnings(estimates),
            *problem.cross_talk(theta, noise),
            *problem.hints(theta, noise),
        ),
    )


def _warnings(estimates: Estimates) -> tuple[str, ...]:
    lines = []
    moved = {"c0": "roll", "c1": "pitch", "c2": "yaw"}
    for name, value, error in zip(estimates.names, estimates.values, estimates.stderr, strict=True):
        if name in moved and error > WELL_KNOWN * abs(value):
            lines.append(
                f"{moved[name]} is hardly excited: {name} is uncertain by"
                f" {100 * error / abs(value):.0f} %; move that axis more"
            )
        elif name in moved and value <= 0:
            lines.append(
                f"{name} came out negative: motors, axes or configuration are not those of the"
                " vehicle profile"
            )
    return tuple(lines)
