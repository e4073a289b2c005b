"""Grey-box identification of the body from closed-loop flights (thesis 7.3.6).

A quadrotor flies in closed loop and its rates are the integral of torque: to simulate it freely
over a flight would compare a diverging integral with a stabilised one. Here each axis is
predicted one row ahead with an autoregressive noise model, which holds torque noise, sensor
noise and vibration. The initial rates drop out with the first difference. Gauss-Newton over
c0, c1, c2 and the effects fitted along, noise models re-estimated in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effects.catalogue import EFFECTS
from groundstation.dynamics.model import BodyConstants
from groundstation.dynamics.vehicle import MotorConstants, Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body_problem import AXES, BodyProblem, motor_steps
from groundstation.identification.body_terms import (
    SUPPLY_EFFECTS,
    BodyTerms,
    measured_acceleration,
    require_known,
)
from groundstation.identification.estimate import Estimates, inverse, sandwich
from groundstation.identification.noise_model import NoiseModel
from groundstation.identification.stretches import Stretch

Array = NDArray[np.float64]

CLEAR = 6.0
"""Standard errors from which an effect that was left out is worth a word."""
HINTS = (
    "dead_time",
    "inertia_coupling",
    "rotor_gyroscopic_torque",
    "rotor_acceleration_torque",
)
"""Effects that every craft has: a word where they show and were not fitted along."""
CROSS_TALK = 0.3
"""Share of an axis's own torque constant that another axis's torque may seem to have."""
TURNED, TURNED_ERRORS = 0.4, 10.0
"""The same where both axes do and the signs are those of a turn, and how many standard errors make
it certain: rotors 45 degrees away give 1."""
WELL_KNOWN, UNKNOWN = 0.05, 0.5
"""Standard errors over the value from which a constant is worth a warning, or a refusal."""
MOST_MOVES = 4
ALIKE = 0.97
"""Correlation beyond which two estimates are told only together."""
LEAST_LAG_S = 1e-5


@dataclass(frozen=True, slots=True)
class BodyFit:
    """Outcome of ``fit_body``.

    estimates: c0, c1, c2, thrust_per_mass and one ``effect.parameter`` for each effect.
    model, values: predict with the fit. noise: per axis. innovation: (3,) RMS of the gyro's
    one-step prediction error in rad/s. motor_share: (p,) of each estimate's variance that comes
    from the motor's.
    """

    body: BodyConstants
    estimates: Estimates
    effects: tuple[str, ...]
    model: BodyTerms
    values: dict[str, float]
    noise: tuple[NoiseModel, ...]
    innovation: Array
    motor_share: Array
    warnings: tuple[str, ...]

    @property
    def delay_s(self) -> float:
        """The dead time that was fitted, otherwise 0."""
        return self.values.get("dead_time.delay_s", 0.0)


def fit_body(
    stretches: Sequence[Stretch],
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
    motor_covariance: Array | None = None,
) -> BodyFit:
    """Estimate c0, c1, c2 and thrust_per_mass from all stretches together.

    effects: names in ``FITTED`` that are known to be there. tie_roll_pitch: c1 = c0, as in the
    thesis. vehicle: configuration, mass, arm, and the ratio of the inertias. motor_covariance:
    (3, 3) of a0, a1, a2; what the motor's uncertainty does to each estimate is added to theirs.

    Raises BadInputError for stretches without torque or motion. What the data hardly tell is
    named in ``warnings``.
    """
    require_known(effects)
    if not stretches:
        raise BadInputError("body fit: nothing to fit on; give a longer recording")
    require_usable(stretches, vehicle)
    acting = tuple(name for name in effects if name not in SUPPLY_EFFECTS)
    thrust, _ = fit_thrust(stretches, BodyTerms(vehicle, 1.0), {})
    problem, theta = _best_start(stretches, vehicle, thrust, acting, tie_roll_pitch)
    theta, normal, noise = _likeliest(problem, theta)
    _require_told(problem, theta, inverse(normal))
    return _outcome(problem, theta, normal, noise, motor_covariance)


def fit_thrust(
    stretches: Sequence[Stretch],
    model: BodyTerms,
    values: dict[str, float],
    motor: MotorConstants | None = None,
) -> tuple[float, float]:
    """thrust_per_mass and its standard error.

    Plain least squares through the origin, so that the mean counts, which is known best; its
    error allows for slow disturbances (climbs, drag), which a noise model would take for signal.

    Raises BadInputError where no stretch has an accelerometer.
    """
    measured, squares = vertical(stretches, model, values, motor)
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


def vertical(
    stretches: Sequence[Stretch],
    model: BodyTerms,
    values: dict[str, float],
    motor: MotorConstants | None = None,
) -> tuple[Array, Array]:
    """Measured specific force along z (m/s^2) and the sum of squared rotor speeds behind it."""
    measured, modelled = [], []
    for stretch in stretches:
        force = stretch.run.accelerometer[stretch.rows, 2]
        if np.isfinite(force).all():
            delay = values.get("dead_time.delay_s", 0.0)
            late = np.arange(stretch.first, stretch.last) - delay / stretch.run.period_s
            strength = np.ones(4)
            strength[model.rotor] += values.get("rotor_mismatch.excess", 0.0)
            total = model.squares(stretch, values, motor).end @ strength
            measured.append(force)
            modelled.append(np.interp(late, np.arange(len(total)), total))
    if not measured:
        return np.empty(0), np.empty(0)
    return np.concatenate(measured), np.concatenate(modelled)


def require_usable(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    """Raises BadInputError for mixed rates, and for a torque or a rate that never changes."""
    period = stretches[0].run.period_s
    model = BodyTerms(vehicle, 1.0)
    unit = {"c0": 1.0, "c1": 1.0, "c2": 1.0}
    for stretch in stretches:
        if abs(stretch.run.period_s / period - 1) > 0.01:
            raise BadInputError(
                f"{stretch.run.name}: {1 / stretch.run.period_s:.0f} rows a second, others"
                f" {1 / period:.0f}; the noise model needs one rate: fit them apart"
            )
        torque, turned = model.acceleration(stretch, unit), measured_acceleration(stretch)
        for axis, name in enumerate(AXES):
            if np.ptp(torque[:, axis]) == 0.0 or np.ptp(turned[:, axis]) == 0.0:
                raise BadInputError(
                    f"{stretch.run.name}: torque or rate about {name} is constant;"
                    " fly, and move all three axes"
                )


def _best_start(
    stretches: Sequence[Stretch],
    vehicle: Vehicle,
    thrust: float,
    effects: tuple[str, ...],
    tied: bool,
) -> tuple[BodyProblem, Array]:
    """The problem and where its search begins; a mismatched rotor is the one that fits best."""
    found = []
    for rotor in range(4 if "rotor_mismatch" in effects else 1):
        problem = BodyProblem(stretches, vehicle, thrust, effects, tied, rotor)
        theta = problem.start()
        found.append((problem, theta))
    if len(found) == 1:
        return found[0]
    noise = found[0][0].noise(found[0][1])  # one for all, or each would be judged by its own
    costs = [problem.cost(problem.minimise(theta, noise)[0], noise) for problem, theta in found]
    best = int(np.argmin(costs))
    return found[best]


def _likeliest(problem: BodyProblem, theta: Array) -> tuple[Array, Array, list[NoiseModel]]:
    """The settled fit, or a settled neighbour of it where that leaves less."""
    best = problem.settle(theta)
    for _ in range(MOST_MOVES):
        rivals = [problem.settle(one) for one in problem.neighbours(best[0], best[2])]
        rivals = [one for one in rivals if _left(one[2]) < _left(best[2])]
        if not rivals:
            break
        best = min(rivals, key=lambda one: _left(one[2]))
    return best


def _left(noise: Sequence[NoiseModel]) -> float:
    """Logarithm of what the one-step predictions leave, over all axes."""
    return sum(math.log(one.variance) for one in noise)


def _require_told(problem: BodyProblem, theta: Array, covariance: Array) -> None:
    """A constant that may as well be zero is no model."""
    for name, axis in zip(
        problem.names, ("roll and pitch", "yaw") if problem.tied else AXES, strict=False
    ):
        place = problem.names.index(name)
        error = float(np.sqrt(covariance[place, place]))
        if not np.isfinite(theta[place]) or error > UNKNOWN * abs(theta[place]):
            names = ", ".join(sorted({stretch.run.name for stretch in problem.stretches}))
            raise BadInputError(
                f"{names}: torque does not show in the rate about {axis} (its constant is"
                f" {theta[place]:.3g} +- {error:.2g}); was the craft free to turn, and is the"
                " vehicle profile the right one?"
            )


def _outcome(
    problem: BodyProblem,
    theta: Array,
    normal: Array,
    noise: Sequence[NoiseModel],
    motor_covariance: Array | None,
) -> BodyFit:
    values = problem.values(theta)
    size = len(theta)
    thrust, thrust_error = fit_thrust(problem.stretches, problem.model, values)
    covariance = np.zeros((size + 1, size + 1))
    covariance[:size, :size], covariance[size, size] = inverse(normal), thrust_error**2
    own = np.diag(covariance).copy()
    if motor_covariance is not None and problem.stretches[0].motor is not None:
        slopes = _by_motor(problem, theta, normal, noise)
        covariance += slopes @ motor_covariance @ slopes.T
    names, found, scale = _reported((*problem.names, "thrust_per_mass"), np.append(theta, thrust))
    rows = sum(len(stretch) for stretch in problem.stretches)
    estimates = Estimates(names, found, covariance * np.outer(scale, scale), rows - size)
    period = problem.stretches[0].run.period_s
    return BodyFit(
        BodyConstants(values["c0"], values["c1"], values["c2"], thrust),
        estimates,
        problem.effects,
        problem.model,
        values,
        tuple(noise),
        np.asarray(period * np.sqrt([one.variance for one in noise]), np.float64),
        1.0 - own / np.maximum(np.diag(covariance), 1e-300),
        (
            *_warnings(estimates, problem),
            *_cross_talk(problem, theta, noise),
            *_hints(problem, theta, noise),
        ),
    )


def _by_motor(
    problem: BodyProblem, theta: Array, normal: Array, noise: Sequence[NoiseModel]
) -> Array:
    """How the estimates (p + 1) move with the motor's a0, a1, a2: (p + 1, 3)."""
    motor = problem.stretches[0].motor
    assert motor is not None
    _, shift = problem.normal_equations(
        problem.slopes(theta), [-one for one in problem.motor_slopes(theta, motor)], noise
    )
    values = problem.values(theta)
    thrust = [
        (
            fit_thrust(problem.stretches, problem.model, values, one)[0]
            - fit_thrust(problem.stretches, problem.model, values, other)[0]
        )
        / step
        for one, other, step in motor_steps(motor)
    ]
    problem.model.forget()
    return np.vstack([inverse(normal) @ shift, thrust])


def _reported(names: tuple[str, ...], theta: Array) -> tuple[tuple[str, ...], Array, Array]:
    """Names and values as models hold them, and the derivative of each by the fit's own."""
    found, scale = theta.copy(), np.ones(len(theta))
    if "gyro_low_pass.lag_s" in names:
        place = names.index("gyro_low_pass.lag_s")
        lag = max(float(theta[place]), LEAST_LAG_S)
        found[place] = 1 / (2 * math.pi * lag)
        scale[place] = -1 / (2 * math.pi * lag**2)
        names = tuple(
            "gyro_low_pass.bandwidth_hz" if i == place else n for i, n in enumerate(names)
        )
    return names, found, scale


def _warnings(estimates: Estimates, problem: BodyProblem) -> list[str]:
    lines = []
    moved = {"c0": "roll", "c1": "pitch", "c2": "yaw"}
    for name, value, error in zip(estimates.names, estimates.values, estimates.stderr, strict=True):
        effect, dot, parameter = name.partition(".")
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
        elif dot:
            known = EFFECTS[effect].parameter(parameter)
            outside = max(known.low - value, value - known.high, 0.0)
            if outside > 2 * error and abs(value - known.absent) > 2 * error:
                lines.append(
                    f"{name} is {value:.3g} +- {error:.2g} {known.unit}, outside the plausible"
                    f" {known.low:g} to {known.high:g}: something else may be missing"
                )
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


def _cross_talk(problem: BodyProblem, theta: Array, noise: Sequence[NoiseModel]) -> list[str]:
    """Axes whose rate answers to another axis's torque as well: rotors in other places.

    Raises BadInputError where roll and pitch answer to each other's torque in opposite senses, as
    they do when the rotors sit a part of a turn away from the profile's.
    """
    lines = []
    share, clear = np.zeros((3, 3)), np.zeros((3, 3), np.bool_)
    model = BodyTerms(problem.vehicle, problem.model.thrust_n / problem.vehicle.mass_kg)
    values = problem.values(theta)
    unit = dict.fromkeys(("c0", "c1", "c2"), 1.0)
    if "dead_time" in problem.effects:
        unit["dead_time.delay_s"] = values["dead_time.delay_s"]
    bases = [model.acceleration(stretch, unit) for stretch in problem.stretches]
    errors = problem.residuals(theta)
    for axis, name in enumerate(AXES):
        normal, gradient = np.zeros((3, 3)), np.zeros(3)
        for base, left in zip(bases, errors, strict=True):
            white = noise[axis].whiten(np.column_stack([base, left[:, axis]]))
            normal += white[:, :3].T @ white[:, :3] / noise[axis].variance
            gradient += white[:, :3].T @ white[:, 3] / noise[axis].variance
        covariance = inverse(normal)
        gain, error = covariance @ gradient, np.sqrt(np.diag(covariance))
        own = values[f"c{axis}"] + gain[axis]
        share[axis], clear[axis] = gain / own, np.abs(gain) > TURNED_ERRORS * error
        lines += [
            f"{name} turns with the torque about {AXES[other]} as well"
            f" ({gain[other] / own:+.0%}): is the profile's configuration"
            f" '{problem.vehicle.configuration}' the craft's?"
            for other in {0, 1, 2} - {axis}
            if abs(gain[other]) > max(CROSS_TALK * abs(own), 5 * error[other])
        ]
    crossed = share[0, 1] * share[1, 0] < 0 and min(abs(share[0, 1]), abs(share[1, 0])) > TURNED
    if crossed and clear[0, 1] and clear[1, 0]:
        names = ", ".join(sorted({one.run.name for one in problem.stretches}))
        raise BadInputError(
            f"{names}: not flown by a {problem.vehicle.name!r}: roll answers to pitch torque"
            f" ({share[0, 1]:+.0%}) and pitch to roll torque ({share[1, 0]:+.0%}); its rotors do"
            f" not sit in configuration '{problem.vehicle.configuration}': give the right --vehicle"
        )
    return lines


def _hints(problem: BodyProblem, theta: Array, noise: Sequence[NoiseModel]) -> list[str]:
    """Effects that were not fitted along although the prediction errors show them clearly."""
    lines = []
    for name in HINTS:
        if name in problem.effects:
            continue
        wider = BodyProblem(
            problem.stretches,
            problem.vehicle,
            problem.model.thrust_n / problem.vehicle.mass_kg,
            (*problem.effects, name),
            problem.tied,
            problem.rotor,
        )
        wider.most[:] = np.inf
        start = np.append(theta, wider.first[-1])
        after, normal = wider.minimise(start, noise, steps=1)
        error = float(np.sqrt(inverse(normal)[-1, -1]))
        if abs(after[-1]) > CLEAR * error:
            lines.append(f"the data clearly show {name}; fit it along: --with {name}")
    return lines
