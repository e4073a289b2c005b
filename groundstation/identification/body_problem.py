"""The least-squares problem of the body fit: prediction errors, their slopes, their noise.

Parameters are c0, (c1,) c2, then those of the effects fitted along. Each axis's one-step errors
are whitened by its own autoregressive noise model. Slopes come from differences: what is linear
in a parameter, as most is, they give exactly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.vehicle import MotorConstants, Vehicle
from groundstation.identification.body_terms import FITTED, BodyTerms, measured_acceleration
from groundstation.identification.estimate import inverse
from groundstation.identification.noise_model import NoiseModel, estimate_noise
from groundstation.identification.stretches import Stretch

Array = NDArray[np.float64]

NOISE_ORDER = 60
STEPS = 15
TRIAL_DELAYS_S = np.arange(0.0, 0.021, 0.004)
NOISE_ROUNDS = 10
SETTLED = 0.05
"""Rounds end when no parameter moves by more than this share of its standard error."""
ABOUT = 0.01
SMALL = 1e-3
"""Steps end when no parameter moves by more than this share of its standard error."""
AXES = ("roll", "pitch", "yaw")


class BodyProblem:
    """vehicle, thrust_per_mass, effects, rotor: as ``BodyTerms``. tied: c1 is c0."""

    def __init__(
        self,
        stretches: Sequence[Stretch],
        vehicle: Vehicle,
        thrust_per_mass: float,
        effects: tuple[str, ...],
        tied: bool = False,
        rotor: int = 0,
    ) -> None:
        self.stretches, self.vehicle, self.effects, self.tied = stretches, vehicle, effects, tied
        self.model = BodyTerms(vehicle, thrust_per_mass, effects, rotor)
        self.rotor = rotor
        constants = vehicle.body_constants
        self.names: tuple[str, ...] = ("c0", "c2") if tied else ("c0", "c1", "c2")
        start = [constants[0], constants[2]] if tied else [*constants]
        step = [0.1 * value for value in start]
        low, high, most = [-np.inf] * len(start), [np.inf] * len(start), [np.inf] * len(start)
        for effect in effects:
            for one in FITTED[effect]:
                self.names += (f"{effect}.{one.name}",)
                start.append(one.start)
                step.append(one.step)
                low.append(one.low)
                high.append(one.high)
                most.append(one.most)
        self.first, self.step = np.array(start), np.array(step)
        self.low, self.high, self.most = np.array(low), np.array(high), np.array(most)
        self.measured = [measured_acceleration(stretch) for stretch in stretches]

    def values(self, theta: Array) -> dict[str, float]:
        """What ``BodyTerms`` takes."""
        values = {name: float(value) for name, value in zip(self.names, theta, strict=True)}
        return {**values, "c1": values["c0"]} if self.tied else values

    def start(self) -> Array:
        """A fit that trusts slow motion, at the best of some trial delays.

        The noise model must not come from a residual that still holds the torque: it would take
        the torque for noise and keep it. So the first one is a guess, sensor noise on a rate
        that is disturbed: A = 1 / (1 - 0.9 q^-1).
        """
        whitener = np.asarray(0.9 ** np.arange(NOISE_ORDER + 1), np.float64)
        noise = [
            NoiseModel(whitener, float(np.mean(np.square(np.concatenate(pieces)))))
            for pieces in zip(*[one.T for one in self.measured], strict=True)
        ]
        delay = np.array([name == "dead_time.delay_s" for name in self.names])
        held = self.most < np.inf
        trials = []
        for trial in TRIAL_DELAYS_S if delay.any() else (0.0,):
            theta = self.first.copy()
            theta[delay] = trial
            theta, _ = self.minimise(theta, noise, held=held, steps=1)
            trials.append((self.cost(theta, noise), theta))
        return min(trials, key=lambda one: one[0])[1]

    def settle(self, theta: Array) -> tuple[Array, Array, list[NoiseModel]]:
        """Minimum, J^T W J there and noise models, in turns until both stay."""
        noise: list[NoiseModel] = []
        normal = np.zeros((len(theta), len(theta)))
        for _ in range(NOISE_ROUNDS):
            noise = self.noise(theta)
            before = theta
            theta, normal = self.minimise(theta, noise)
            if np.all(np.abs(theta - before) * np.sqrt(np.diag(normal)) < SETTLED):
                break
        return theta, normal, noise

    def neighbours(self, theta: Array, noise: Sequence[NoiseModel]) -> list[Array]:
        """Where else to look: delays some rows away that predict about as well.

        What is recorded row by row, and vibration that the controller feeds back, make delays a
        row apart look alike: the search may have ended beside the best.
        """
        if "dead_time.delay_s" not in self.names:
            return []
        place = self.names.index("dead_time.delay_s")
        held = np.arange(len(theta)) == place
        reached, found = self.cost(theta, noise), []
        for rows in (-2, -1, 1, 2):
            other = theta.copy()
            other[place] += rows * self.stretches[0].run.period_s
            if self.low[place] <= other[place] <= self.high[place]:
                other, _ = self.minimise(other, noise, held=held, steps=1)
                if self.cost(other, noise) < (1 + ABOUT) * reached:
                    found.append(other)
        return found

    def residuals(self, theta: Array, motor: MotorConstants | None = None) -> list[Array]:
        """Measured less modelled acceleration, (n, 3) per stretch."""
        values = self.values(theta)
        return [
            measured - self.model.acceleration(stretch, values, motor)
            for measured, stretch in zip(self.measured, self.stretches, strict=True)
        ]

    def cost(self, theta: Array, noise: Sequence[NoiseModel]) -> float:
        """Sum of squared one-step prediction errors over their variances."""
        return sum(
            float(np.square(noise[axis].whiten(piece[:, axis])).sum()) / noise[axis].variance
            for piece in self.residuals(theta)
            for axis in range(3)
        )

    def noise(self, theta: Array) -> list[NoiseModel]:
        """The autoregression behind each axis's residuals."""
        pieces = self.residuals(theta)
        return [estimate_noise([p[:, axis] for p in pieces], NOISE_ORDER) for axis in range(3)]

    def slopes(self, theta: Array) -> list[Array]:
        """Derivatives of the modelled acceleration, (n, 3, p) per stretch."""
        columns: list[list[Array]] = [[] for _ in self.stretches]
        for i, step in enumerate(self.step):
            ahead, behind = theta.copy(), theta.copy()
            ahead[i] = min(theta[i] + step, self.high[i])
            behind[i] = max(theta[i] - step, self.low[i])
            one, other = self.values(ahead), self.values(behind)
            for stretch, column in zip(self.stretches, columns, strict=True):
                change = self.model.acceleration(stretch, one)
                change = change - self.model.acceleration(stretch, other)
                column.append(change / (ahead[i] - behind[i]))
        self.model.forget()
        return [np.stack(column, axis=2) for column in columns]

    def motor_slopes(self, theta: Array, motor: MotorConstants) -> list[Array]:
        """Derivatives of the modelled acceleration by a0, a1, a2, (n, 3, 3) per stretch."""
        values = self.values(theta)
        found: list[list[Array]] = [[] for _ in self.stretches]
        for one, other, step in motor_steps(motor):
            for stretch, columns in zip(self.stretches, found, strict=True):
                change = self.model.acceleration(stretch, values, one)
                change = change - self.model.acceleration(stretch, values, other)
                columns.append(change / step)
        self.model.forget()
        return [np.stack(columns, axis=2) for columns in found]

    def normal_equations(
        self, slopes: Sequence[Array], errors: Sequence[Array], noise: Sequence[NoiseModel]
    ) -> tuple[Array, Array]:
        """J^T W J and J^T W e, whitened; slopes (n, 3, p), errors (n, 3) or (n, 3, m)."""
        size = slopes[0].shape[2]
        normal, gradient = np.zeros((size, size)), np.zeros((size, *errors[0].shape[2:]))
        for slope, error in zip(slopes, errors, strict=True):
            for axis in range(3):
                both = np.column_stack([slope[:, axis], error[:, axis]])
                white = noise[axis].whiten(both)
                normal += white[:, :size].T @ white[:, :size] / noise[axis].variance
                right = white[:, size:] if error.ndim == 3 else white[:, size]
                gradient += white[:, :size].T @ right / noise[axis].variance
        return normal, gradient

    def minimise(
        self,
        theta: Array,
        noise: Sequence[NoiseModel],
        held: NDArray[np.bool_] | None = None,
        steps: int = STEPS,
    ) -> tuple[Array, Array]:
        """Gauss-Newton for fixed noise models; returns the minimum and J^T W J there.

        held: parameters that stay where they are.
        """
        free = np.ones(len(theta), np.bool_) if held is None else ~held
        most, direction = self.most.copy(), np.zeros(len(theta))
        normal = np.zeros((len(theta), len(theta)))
        for _ in range(steps):
            slopes = self.slopes(theta)
            normal, gradient = self.normal_equations(slopes, self.residuals(theta), noise)
            low, high = np.maximum(-most, self.low - theta), np.minimum(most, self.high - theta)
            change = bounded_step(normal, gradient, free, low, high)
            most = np.where(change * direction < 0.0, 0.5 * most, most)  # to and fro: shorter
            direction = change
            theta = theta + change
            if np.all(np.abs(change) * np.sqrt(np.diag(normal)) < SMALL):
                break
        return theta, normal


def bounded_step(
    normal: Array, gradient: Array, free: NDArray[np.bool_], low: Array, high: Array
) -> Array:
    """The Gauss-Newton step whose parts stay within low..high; only ``free`` ones move.

    A part that meets its limit stays there and the others are found anew: cut off afterwards,
    they would answer to a step that was never taken.
    """
    step, open_ = np.zeros(len(gradient)), free.copy()
    while open_.any():
        right = gradient - normal @ np.where(open_, 0.0, step)
        step[open_] = inverse(normal[np.ix_(open_, open_)]) @ right[open_]
        outside = open_ & ((step < low) | (step > high))
        if not outside.any():
            break
        step[outside] = np.clip(step, low, high)[outside]
        open_ &= ~outside
    return step


def motor_steps(
    motor: MotorConstants,
) -> list[tuple[MotorConstants, MotorConstants, float]]:
    """For each of a0, a1, a2: a larger and a smaller motor, and the difference between them."""
    found = []
    for name in ("a0", "a1", "a2"):
        value = getattr(motor, name)
        step = 1e-3 * max(abs(value), 1e-4)
        pair = [
            MotorConstants(**{**_constants(motor), name: value + sign * step}) for sign in (1, -1)
        ]
        found.append((pair[0], pair[1], 2 * step))
    return found


def _constants(motor: MotorConstants) -> dict[str, float]:
    return {"a0": motor.a0, "a1": motor.a1, "a2": motor.a2}
