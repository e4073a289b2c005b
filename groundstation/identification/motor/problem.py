"""The least-squares problem of the motor fit: simulated readings, their slopes, their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.registry import EFFECTS as LISTED
from groundstation.telemetry.arrays import Array

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
MOST_EVALUATIONS = 50
PRECISION, COARSE = 1e-7, 1e-4
"""Relative gains of the cost that are not worth another step."""
WITHIN_NOISE = 0.01
"""The same in squared standard deviations of one reading: readings between rows make the cost rough
at the scale of their noise."""
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
        from groundstation.identification.motor.kernel import motor_sensitivities

        run, (speed, sensitivity) = self.runs[index], self._room[index]
        voltage_mv = self._voltage_mv[index]
        start = theta[self.starts + index]
        asked = theta.tobytes()
        if asked != self._simulated[index]:
            self._simulated[index] = asked
            values = dict(zip(self.effects, theta[SHARED : self.starts], strict=True))
            constants = np.array([*theta[:3], *({**ABSENT, **values}[name] for name in EFFECTS)])
            motor_sensitivities(constants, voltage_mv, run.period_s, start, speed, sensitivity)
        return speed, sensitivity[:, self._used] if self.effects else sensitivity

    def places(self, index: int) -> NDArray[np.int64]:
        """Where the columns of ``simulate``, and then the delay, belong among the parameters."""
        effects = range(SHARED, self.starts)
        return np.array([0, 1, 2, self.starts + index, *effects, DELAY], np.int64)

    def jacobian(self, weights: Sequence[Array], theta: Array) -> Array:
        """Derivatives (readings, p) of ``errors``."""
        found = []
        for index, (run, weight) in enumerate(zip(self.runs, weights, strict=True)):
            speed, sensitivity = self.simulate(theta, index)
            rows = np.flatnonzero(np.isfinite(run.rev_s))
            row, share = _places(run, rows, theta[DELAY])
            columns = np.zeros((len(rows), self.size))
            below = sensitivity[row]
            columns[:, self.places(index)[:-1]] = below + share[:, None] * (
                sensitivity[row + 1] - below
            )
            columns[:, DELAY] = (speed[row] - speed[row + 1]) / run.period_s
            found.append(-np.sqrt(weight[rows])[:, None] * columns)
        return np.vstack(found)

    def errors(self, weights: Sequence[Array], theta: Array) -> Array:
        """Measured less modelled readings of all runs, by the roots of their weights."""
        return np.concatenate(
            [
                np.sqrt(weight[np.isfinite(run.rev_s)]) * (measured - modelled)
                for run, weight, (measured, modelled) in zip(
                    self.runs, weights, self.compare(theta), strict=True
                )
            ]
        )

    def minimise(self, weights: Sequence[Array], theta: Array, coarse: bool = False) -> Array:
        """The least squares from a start.

        coarse: delay and effects are held, and less precision will do.
        """
        from scipy.optimize import least_squares

        free = np.ones(self.size, np.bool_)
        free[2] = not self.first_order
        if coarse:
            free[DELAY : self.starts] = False
        low, high = np.full((2, self.size), [[-np.inf], [np.inf]])
        low[DELAY], high[DELAY] = -LONGEST_DELAY_S, LONGEST_DELAY_S
        for place, name in enumerate(self.effects, start=SHARED):
            low[place], high[place] = EFFECTS[name].bounds
        readings = sum(int(np.count_nonzero(one)) for one in weights)

        def whole(point: Array) -> Array:
            full = theta.copy()
            full[free] = point
            return full

        with np.errstate(invalid="ignore", over="ignore"):  # a trial may diverge: it is not taken
            found = least_squares(
                lambda point: self.errors(weights, whole(point)),
                theta[free],
                jac=lambda point: self.jacobian(weights, whole(point))[:, free],
                bounds=(low[free], high[free]),
                x_scale="jac",
                ftol=COARSE if coarse else max(PRECISION, WITHIN_NOISE / readings),
                xtol=1e-12,
                gtol=None,
                max_nfev=MOST_EVALUATIONS,
            )
        return whole(found.x)

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
        found, first = [], 0
        every = -self.jacobian(weights, theta) * self.errors(weights, theta)[:, None]
        for run in self.runs:
            rows = np.flatnonzero(np.isfinite(run.rev_s))
            length = max(round(BLOCK_S / run.period_s), len(run.rev_s) // MOST_BLOCKS)
            begins = np.flatnonzero(np.diff(rows // length, prepend=-1))
            found.append(np.add.reduceat(every[first : first + len(rows)], begins))
            first += len(rows)
        return np.vstack(found)


def first_speed(run: MotorRun) -> float:
    """Median of a run's first readings, rev/s."""
    readings = np.flatnonzero(np.isfinite(run.rev_s))[:15]
    return float(np.median(run.rev_s[readings]))


def at_age(run: MotorRun, rows: NDArray[np.intp], series: Array, delay_s: float) -> Array:
    """A modelled series at the time each reading was taken."""
    row, share = _places(run, rows, delay_s)
    return series[row] + share * (series[row + 1] - series[row])


def _places(
    run: MotorRun, rows: NDArray[np.intp], delay_s: float
) -> tuple[NDArray[np.intp], Array]:
    """Between which rows readings were taken: the first of the two, and how far behind it."""
    last = len(run.rev_s) - 1
    place = np.clip(rows - (run.age_s[rows] + delay_s) / run.period_s, 0, last)
    row = np.minimum(place.astype(np.intp), last - 1)
    return row, place - row


def robust_spread(errors: ArrayLike) -> float:
    """Standard deviation by the median of absolute values."""
    return 1.4826 * float(np.median(np.abs(errors))) + 1e-9
