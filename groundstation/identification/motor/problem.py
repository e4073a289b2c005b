"""The least-squares problem of the motor fit: simulated readings, their slopes, their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.registry import EFFECTS as LISTED

Array = NDArray[np.float64]

DELAY, SHARED = 3, 4
"""Places among the parameters: the common delay, and what comes after a0, a1, a2 and it: the
effects', then each run's initial speed."""
COASTING = "motor_coasting"
EFFECTS = {
    name: LISTED[name].sizes[0]
    for name in ("motor_dead_voltage", COASTING, "motor_braking_asymmetry")
}
"""Effects that can be fitted along and their parameter, in the order of the kernel's arguments."""
ABSENT = {name: one.absent for name, one in EFFECTS.items()}
LONGEST_DELAY_S = 0.03
OUTLIER = 4.5
"""Readings further from the model than so many robust standard deviations are glitches."""
STEPS = 50
WITHIN_NOISE = 0.01
"""Gain, in squared standard deviations of one reading, that is not worth another try."""
BLOCK_S, MOST_BLOCKS = 0.5, 100


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


class MotorProblem:
    """All runs together. Parameters: a0, a1, a2, the readings' delay, one per effect, and each
    run's initial speed."""

    def __init__(self, runs: Sequence[MotorRun], effects: Sequence[str] = ()) -> None:
        self.runs, self.effects = runs, tuple(effects)
        self.starts = SHARED + len(self.effects)
        self.size = self.starts + len(runs)
        columns = 4 + len(EFFECTS) if self.effects else 4
        self._room = [
            (np.empty(len(run.rev_s)), np.empty((len(run.rev_s), columns))) for run in runs
        ]
        # A view of a column is another type to numba, and would compile each kernel once more.
        self._voltage_mv = [np.ascontiguousarray(run.voltage_mv) for run in runs]
        self.first_order = False
        """a2 stays what it is in ``minimise``."""
        self._simulated: list[bytes] = [b""] * len(runs)
        """The parameters behind what each room holds."""
        self._used = [0, 1, 2, 3, *(4 + list(EFFECTS).index(name) for name in self.effects)]

    def theta(self, constants: ArrayLike, delay_s: float = 0.0) -> Array:
        """Where a search begins: effects absent, runs at their first readings."""
        absent = [ABSENT[name] for name in self.effects]
        speeds = [first_speed(run) for run in self.runs]
        return np.array([*np.asarray(constants, np.float64), delay_s, *absent, *speeds])

    def simulate(self, theta: Array, index: int) -> tuple[Array, Array]:
        """Speed (n,) of a run and its derivatives (n, m): a0, a1, a2, initial speed, effects.

        The arrays are reused by the next call for the same run.
        """
        from groundstation.identification.motor.kernel import (
            flawed_sensitivities,
            motor_sensitivities,
        )

        run, (speed, sensitivity) = self.runs[index], self._room[index]
        voltage_mv = self._voltage_mv[index]
        start = theta[self.starts + index]
        asked = theta.tobytes()
        if asked == self._simulated[index]:
            return speed, sensitivity[:, self._used] if self.effects else sensitivity
        self._simulated[index] = asked
        if not self.effects:
            motor_sensitivities(theta[:3], voltage_mv, run.period_s, start, speed, sensitivity)
            return speed, sensitivity
        values = dict(zip(self.effects, theta[SHARED : self.starts], strict=True))
        constants = np.array([*theta[:3], *({**ABSENT, **values}[name] for name in EFFECTS)])
        flawed_sensitivities(constants, voltage_mv, run.period_s, start, speed, sensitivity)
        return speed, sensitivity[:, self._used]

    def places(self, index: int) -> NDArray[np.int64]:
        """Where the columns of ``simulate``, and then the delay, belong among the parameters."""
        effects = range(SHARED, self.starts)
        return np.array([0, 1, 2, self.starts + index, *effects, DELAY], np.int64)

    def system(self, weights: Sequence[Array], theta: Array) -> tuple[Array, Array, float]:
        """J^T W J, J^T W e and the weighted sum of squared errors."""
        from groundstation.identification.motor.kernel import motor_normal_equations

        normal, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        cost = 0.0
        for index, (run, weight) in enumerate(zip(self.runs, weights, strict=True)):
            speed, sensitivity = self.simulate(theta, index)
            scale = np.ones(self.size)
            scale[DELAY] = 1 / run.period_s
            part, slope = np.zeros_like(normal), np.zeros_like(gradient)
            cost += motor_normal_equations(
                speed,
                np.ascontiguousarray(sensitivity),
                run.rev_s,
                weight,
                run.age_s / run.period_s,
                theta[DELAY] / run.period_s,
                self.places(index),
                part,
                slope,
            )
            normal += part * np.outer(scale, scale)
            gradient += slope * scale
        return normal, gradient, cost

    def minimise(
        self, weights: Sequence[Array], theta: Array, coarse: bool = False
    ) -> tuple[Array, Array]:
        """Levenberg-Marquardt; returns the minimum and J^T W J there.

        coarse: delay and effects are held, and less precision will do.
        """
        damping, tolerance = 1e-6, 1e-4 if coarse else 1e-7
        free = np.ones(self.size, np.bool_)
        free[2] = not self.first_order
        if coarse:
            free[DELAY : self.starts] = False
        readings = sum(int(np.count_nonzero(one)) for one in weights)
        normal, gradient, cost = self.system(weights, theta)
        for _ in range(STEPS):
            damped = normal + damping * np.diag(np.maximum(np.diag(normal), 1e-12))
            step = np.zeros(self.size)
            step[free] = np.linalg.solve(damped[np.ix_(free, free)], gradient[free])
            gain = float(step @ gradient)
            if gain <= tolerance * cost:
                break
            trial = theta + step
            if self._within(trial):
                new_normal, new_gradient, new_cost = self.system(weights, trial)
            else:
                new_cost = np.inf
            if np.isfinite(new_cost) and new_cost <= cost:
                theta, normal, gradient, cost = trial, new_normal, new_gradient, new_cost
                damping = max(damping * 0.1, 1e-12)
            else:
                damping *= 10.0
            # Readings between rows make the cost rough at the scale of their noise.
            if damping > 1e9 or gain <= WITHIN_NOISE * cost / readings:
                break
        return theta, normal

    def compare(self, theta: Array) -> list[tuple[Array, Array]]:
        """(measured, modelled) of each run's readings."""
        pairs = []
        for index, run in enumerate(self.runs):
            speed, _ = self.simulate(theta, index)
            rows = np.flatnonzero(np.isfinite(run.rev_s))
            pairs.append((run.rev_s[rows], at_age(run, rows, speed, theta[DELAY])))
        return pairs

    def weights(self, theta: Array) -> tuple[list[Array], int]:
        """Inverse variances of the readings, zero for glitches, and how many of these there are.

        While the speed changes, a reading's uncertain age makes it less certain; what remains at
        steady speed is the reading's own noise.
        """
        errors, timing = [], []
        for index, (run, (measured, modelled)) in enumerate(
            zip(self.runs, self.compare(theta), strict=True)
        ):
            rows = np.flatnonzero(np.isfinite(run.rev_s))
            slope = np.gradient(self.simulate(theta, index)[0], run.period_s)
            errors.append(measured - modelled)
            timing.append(at_age(run, rows, slope, theta[DELAY]) * run.jitter_s[rows])
        error, jitter = np.concatenate(errors), np.abs(np.concatenate(timing))
        steady = jitter <= np.median(jitter)
        noise = robust_spread(error[steady])
        rejected, weights = 0, []
        for run, one, late in zip(self.runs, errors, timing, strict=True):
            variance = noise**2 + late**2
            good = one**2 <= OUTLIER**2 * variance
            weight = np.zeros(len(run.rev_s))
            weight[np.isfinite(run.rev_s)] = good / variance
            rejected += int((~good).sum())
            weights.append(weight)
        return weights, rejected

    def scores(self, weights: Sequence[Array], theta: Array) -> Array:
        """J^T W e (blocks, p) over blocks of half a second, longer where these would be many."""
        found = []
        pairs = self.compare(theta)
        for index, (run, weight, (measured, modelled)) in enumerate(
            zip(self.runs, weights, pairs, strict=True)
        ):
            rows = np.flatnonzero(np.isfinite(run.rev_s))
            speed, sensitivity = self.simulate(theta, index)
            jacobian = np.zeros((len(rows), self.size))
            series = (*sensitivity.T, -np.gradient(speed, run.period_s))
            for place, values in zip(self.places(index), series, strict=True):
                jacobian[:, place] = at_age(run, rows, values, theta[DELAY])
            score = jacobian * ((measured - modelled) * weight[rows])[:, None]
            length = max(round(BLOCK_S / run.period_s), len(run.rev_s) // MOST_BLOCKS)
            begins = np.flatnonzero(np.diff(rows // length, prepend=-1))
            found.append(np.add.reduceat(score, begins))
        return np.vstack(found)

    def _within(self, theta: Array) -> bool:
        limits = [EFFECTS[name].bounds for name in self.effects]
        within = [
            low <= size <= high
            for size, (low, high) in zip(theta[SHARED : self.starts], limits, strict=True)
        ]
        return bool(abs(theta[DELAY]) <= LONGEST_DELAY_S) and all(within)


def first_speed(run: MotorRun) -> float:
    """Median of a run's first readings, rev/s."""
    readings = np.flatnonzero(np.isfinite(run.rev_s))[:15]
    return float(np.median(run.rev_s[readings]))


def at_age(run: MotorRun, rows: NDArray[np.intp], series: Array, delay_s: float) -> Array:
    """A modelled series at the time each reading was taken."""
    place = np.clip(rows - (run.age_s[rows] + delay_s) / run.period_s, 0, len(series) - 1)
    return np.interp(place, np.arange(len(series)), series)


def robust_spread(errors: ArrayLike) -> float:
    """Standard deviation by the median of absolute values."""
    return 1.4826 * float(np.median(np.abs(errors))) + 1e-9
