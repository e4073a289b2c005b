"""Grey-box identification of the motor, n' = a0 u - a1 n - a2 n^2 (thesis 7.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.registry import EFFECTS as LISTED
from groundstation.dynamics.simulation import armature_mv
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError
from groundstation.identification.estimate import (
    Estimates,
    ResidualTest,
    Trace,
    fit_percent,
    implausible,
    liveliest,
    residual_test,
    rms,
    sandwich,
)
from groundstation.identification.runs import Run, require_known
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

    def __getitem__(self, rows: slice) -> MotorRun:
        """Some consecutive rows as a run of its own."""
        names = ("voltage_mv", "rev_s", "age_s", "jitter_s")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @property
    def read(self) -> NDArray[np.intp]:
        """Rows with a measurement."""
        return np.flatnonzero(np.isfinite(self.rev_s))

    @property
    def bridged(self) -> Array:
        """Measured speeds (n,), on straight lines where there is none."""
        return np.interp(np.arange(len(self.rev_s)), self.read, self.rev_s[self.read])

    @property
    def seconds(self) -> float:
        return len(self.rev_s) * self.period_s


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
        speeds = [float(np.median(run.rev_s[run.read[:15]])) for run in self.runs]
        return np.array([*np.asarray(constants, np.float64), delay_s, *absent, *speeds])

    def simulate(self, theta: Array, index: int) -> tuple[Array, Array]:
        """Speed (n,) of a run and its derivatives (n, m): a0, a1, a2, initial speed, effects.

        The arrays are reused by the next call for the same run.
        """
        from groundstation.identification.likelihood.kernels import motor_sensitivities

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
            rows = run.read
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
                np.sqrt(weight[run.read]) * (measured - modelled)
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
            pairs.append((run.rev_s[run.read], at_age(run, run.read, speed, theta[DELAY])))
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
            slope = np.gradient(self.simulate(theta, index)[0], run.period_s)
            errors.append(measured - modelled)
            timing.append(at_age(run, run.read, slope, theta[DELAY]) * run.jitter_s[run.read])
        error, jitter = np.concatenate(errors), np.abs(np.concatenate(timing))
        steady = jitter <= np.median(jitter)
        noise = robust_spread(error[steady])
        rejected, weights = 0, []
        for run, one, late in zip(self.runs, errors, timing, strict=True):
            variance = noise**2 + late**2
            good = one**2 <= OUTLIER**2 * variance
            weight = np.zeros(len(run.rev_s))
            weight[run.read] = good / variance
            rejected += int((~good).sum())
            weights.append(weight)
        return weights, rejected

    def scores(self, weights: Sequence[Array], theta: Array) -> Array:
        """J^T W e (blocks, p) over blocks of half a second, longer where these would be many."""
        found, first = [], 0
        every = -self.jacobian(weights, theta) * self.errors(weights, theta)[:, None]
        for run in self.runs:
            rows = run.read
            length = max(round(BLOCK_S / run.period_s), len(run.rev_s) // MOST_BLOCKS)
            begins = np.flatnonzero(np.diff(rows // length, prepend=-1))
            found.append(np.add.reduceat(every[first : first + len(rows)], begins))
            first += len(rows)
        return np.vstack(found)


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


# Rotor speed as sensors show it: the bench's optical gate (thesis 7.2.2), a deck in flight.


WINDOW = 11
"""Fresh readings around each one that it is compared with."""
TOLERANCE = 0.10
"""A reading that differs from the median around it by more than this share is a glitch."""
LONGEST_PERIOD_S = 0.1
"""Half a revolution slower than this (5 rev/s) is a rotor that stands."""
LEAST_FRESH = 0.2
"""Share of rows with a new reading from which a sensor works: one that reads once a revolution
renews every second row at 250 rev/s."""
FEWEST_BLADES, MOST_BLADES = 0.6, 1.7
"""A sensor off by more than this from what the others show at their voltages counts passages
wrongly: rotors that fly one craft differ by some percent, a missed blade is a factor of two."""


@dataclass(frozen=True, slots=True)
class GateReading:
    """Speeds behind a run's gate.

    rev_s: (n,), NaN in rows without a fresh, credible reading. Each is the mean speed of the half
    revolution whose middle lies ``age_s`` (n,) before the row, give or take ``jitter_s`` (n,;
    standard deviation).
    glitches: share of the fresh readings that were rejected; rejected: (n,) these rows.
    """

    rev_s: Array
    age_s: Array
    jitter_s: Array
    glitches: float
    rejected: NDArray[np.bool_]


def speed_from_gate(run: Run) -> GateReading:
    """Speeds from the times between blade passages, without the gate's glitches.

    A missed passage doubles a period, a bounce cuts it: both differ from the readings around
    them, which a rotor's inertia keeps together. The passage that ended a period lay, on
    average, half a row (or half a period, where shorter) before the row that first shows it.

    Raises BadInputError where the rotor never turned.
    """
    period = run.debug_s
    fresh = np.concatenate([[False], np.diff(period) != 0])
    # An unchanged value is a new passage too, where the rotor is fast enough for one each row.
    fresh |= (period > 0) & (period <= run.period_s)
    fresh &= (period > 0) & (period < LONGEST_PERIOD_S)
    rows = np.flatnonzero(fresh)
    if len(rows) < WINDOW:
        raise BadInputError(
            f"{run.name}: the debug field holds no rotor periods; fit the motor on a recording of"
            " the motor bench, or on one with measured rotor speed; without either, give 'fit body'"
            " the profile's motors"
        )
    credible = _credible(period[rows])
    speed, age, jitter = np.full(len(run), np.nan), np.zeros(len(run)), np.zeros(len(run))
    kept = rows[credible]
    window = np.minimum(period[kept], run.period_s)
    speed[kept] = 0.5 / period[kept]
    age[kept] = 0.5 * period[kept] + 0.5 * window
    jitter[kept] = window / np.sqrt(12)
    rejected = np.zeros(len(run), np.bool_)
    rejected[rows[~credible]] = True
    return GateReading(speed, age, jitter, float(1 - credible.mean()), rejected)


def rotor_readings(run: Run) -> tuple[Array, list[str]]:
    """Speeds (n, 4) rev/s of a run's rotors in flight, NaN where there is no new, credible reading,
    and in words which sensors do not work: theirs are all NaN.

    A reading that repeats the one before is none: the rotor has not passed the sensor since.
    """
    shown = run.rotor_rev_s
    fresh = np.isfinite(shown) & (shown > 0.5 / LONGEST_PERIOD_S)
    fresh[1:] &= shown[1:] != shown[:-1]
    found, left_out = np.full_like(shown, np.nan), []
    for rotor in range(4):
        rows = np.flatnonzero(fresh[:, rotor])
        if len(rows) < max(LEAST_FRESH * len(run), WINDOW):
            said = _silence(shown[:, rotor])
            left_out.append(f"rotor {rotor + 1}: its sensor {said} of {run.name}: left out")
            continue
        kept = rows[_credible(shown[rows, rotor])]
        found[kept, rotor] = shown[kept, rotor]
    working = np.flatnonzero(np.isfinite(found).any(axis=0))
    if len(working) > 2:
        each = np.nanmedian(found[:, working], axis=0) / np.nanmean(run.duty[:, working], axis=0)
        for place, share in zip(working, each / np.median(each), strict=True):
            rotor = int(place)
            if not FEWEST_BLADES < share < MOST_BLADES:
                found[:, rotor] = np.nan
                left_out.append(
                    f"rotor {rotor + 1}: its sensor shows {share:.2f} of what the others show at"
                    f" the same duty in {run.name}: left out"
                )
    return found, left_out


def _silence(shown: Array) -> str:
    """What a sensor shows that does not work, and in how many of the rows."""
    missing, stands = np.isnan(shown), shown <= 0.5 / LONGEST_PERIOD_S
    if missing.mean() > 0.5:
        return f"shows nothing in {100 * missing.mean():.0f} % of the rows"
    if stands.mean() > 0.5:
        return f"shows a rotor that stands in {100 * stands.mean():.0f} % of the rows"
    same = np.concatenate([[False], shown[1:] == shown[:-1]])
    return f"repeats its last value in {100 * same.mean():.0f} % of the rows"


def _credible(period: Array) -> NDArray[np.bool_]:
    """Which readings agree with the median of those around them (twice: glitches come in pairs)."""
    good = np.ones(len(period), bool)
    for _ in range(2):
        values = period[good]
        half = min(WINDOW // 2, (len(values) - 1) // 2)
        padded = np.pad(values, half, mode="reflect")
        around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
        places = np.flatnonzero(good)
        good[places[np.abs(values / around - 1) > TOLERANCE]] = False
    return good


# Grey-box identification of the motor, n' = a0 u - a1 n - a2 n^2 (thesis 7.2).
#
# The motor is stable and the bench has no disturbance to speak of, so the prediction error is the
# error of simulation: least squares on it with exact sensitivities, all runs together, each
# with its own initial speed, and one delay of the readings for all. Inputs are held between rows,
# as PWM is (interpolating them biases a2 by 14 %). What is left after the fit decides which
# readings were glitches after all.


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


def bench_run(run: Run, motor: int = 0) -> MotorRun:
    """A run of the motor bench: speeds from the gate's periods, voltage by eq. 3.84.

    motor: index of the motor that carries the gate.
    """
    require_known(run, ("duty", "supply_v"), "the motor model needs both")
    reading = speed_from_gate(run)
    voltage = armature_mv(run.duty, run.supply_v)[:, motor]
    shown = reading.rev_s, reading.age_s, reading.jitter_s, reading.glitches
    return MotorRun(run.name, run.period_s, voltage, *shown)


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
    names = ", ".join(dict.fromkeys(run.name for run in runs))
    for name, value in zip(("a0", "a1"), theta, strict=False):
        if value <= 0.0:
            raise BadInputError(
                f"{names}: {name} is not identified, because the voltage hardly varies or the speed"
                f" does not follow it (it would be {value:.3g}, and no motor has that); vary the"
                " thrust between 30 and 90 % duty, and see that the sensor is on the motor fitted"
            )
    found = _outcome(problem, weights, theta, rejected)
    for name, value, error in found.estimates.rows[:2]:
        if error > UNKNOWN * value:
            raise BadInputError(
                f"{names}: {name} is not identified, because the voltage hardly varies: uncertain"
                f" by {100 * error / value:.0f} %; vary the thrust over a wider range, from 30 to"
                " 90 % duty"
            )
    return found


def first_constants(runs: Sequence[MotorRun]) -> Array:
    """Least squares on eq. 3.82 integrated over tenths of a second: no guess needed.

    n(t + T) - n(t) = a0 int u - a1 int n - a2 int n^2, with measured speeds on the right.
    """
    rows, changes = [], []
    for run in runs:
        speed = run.bridged
        width = max(round(0.1 / run.period_s), 2)
        sums = np.cumsum(np.column_stack([run.voltage_mv, -speed, -(speed**2)]), axis=0)
        integrals = (sums[width::width] - sums[:-width:width]) * run.period_s
        rows.append(integrals)
        changes.append(speed[width::width] - speed[:-width:width])
    matrix, change = np.vstack(rows), np.concatenate(changes)
    constants, *_ = np.linalg.lstsq(matrix / np.array([1, 1, 100.0]), change, rcond=None)
    a0, a1, a2 = constants / np.array([1, 1, 100.0])
    if min(a0, a1, a2) > 0:
        return np.array([a0, a1, a2])
    # Noise on both sides can make one of them negative; the simulation needs a stable start: a
    # linear motor with a time constant of 0.1 s that reaches the mean speed.
    volts = np.concatenate([run.voltage_mv[run.read] for run in runs])
    speeds = np.concatenate([run.rev_s[run.read] for run in runs])
    return np.array([10.0 * speeds.mean() / volts.mean(), 10.0, 0.0])


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
    model[run.read] = problem.compare(theta)[0][1]
    return model


def delay_in_words(estimates: Estimates) -> str:
    """What the estimated delay of the readings says: readings cannot be ahead of what they show."""
    value, error = estimates["delay_s"], estimates.error_of("delay_s")
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
    rows = run.read
    error = run.rev_s[rows] - model[rows]
    centred = error - np.median(error)
    return rows[np.abs(centred) <= OUTLIER * robust_spread(centred)]


def require_usable(runs: Sequence[MotorRun]) -> None:
    """Raises BadInputError for runs that no fit should see, each with its reason."""
    if not runs:
        raise BadInputError("motor fit: no runs; give at least one recording")
    for run in runs:
        if not np.isfinite(run.voltage_mv).all():
            raise BadInputError(
                f"{run.name}: the armature voltage is missing in some rows (no battery voltage or"
                " no PWM); the motor model needs both"
            )
        if len(run.read) < LEAST_READINGS or run.seconds < LEAST_SECONDS:
            raise BadInputError(
                f"{run.name}: {len(run.read)} speed readings in {run.seconds:.1f} s are too few for"
                " a motor fit; record longer"
            )
        if run.voltage_mv.std() < 0.01 * max(float(run.voltage_mv.mean()), 1.0):
            raise BadInputError(
                f"{run.name}: the armature voltage is constant; vary the thrust while recording"
            )
        if run.rev_s[run.read].mean() < 5.0:
            raise BadInputError(
                f"{run.name}: the rotor hardly turns; record with the motor running"
            )


def _outcome(
    problem: MotorProblem, weights: Sequence[Array], theta: Array, rejected: int
) -> MotorFit:
    fits, errors, readings = [], [], 0
    for run, weight, (measured, modelled) in zip(
        problem.runs, weights, problem.compare(theta), strict=True
    ):
        used = weight[run.read] > 0
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
    figures = tuple(fits), tuple(errors), share
    return MotorFit(motor, estimates, problem.effects, *figures, _warnings(estimates, share))


def _warnings(estimates: Estimates, rejected: float) -> tuple[str, ...]:
    lines = []
    for name, value, error in estimates.rows:
        if "." in name:
            lines += implausible(name, value, error)
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


DRAWN_S = 6.0


def motor_pictures(
    modelled: Sequence[tuple[MotorRun, NDArray[np.float64]]], fitted_rows: int
) -> tuple[list[Trace], list[ResidualTest]]:
    """Measured and simulated speed (n,), and the residuals, of runs."""
    traces, residuals = [], []
    for run, model in modelled:
        name, rows = f"rotor speed, {run.name}", liveliest(run.voltage_mv, run.period_s, DRAWN_S)
        here = run.read[(run.read >= rows.start) & (run.read < rows.stop)]
        series = run.period_s * here, run.rev_s[here], model[here]
        traces.append(Trace(name, "rev/s", *series, "simulated from the voltage alone"))
        good = credible_rows(run, model)
        left, driven = run.rev_s[good] - model[good], run.voltage_mv[good]
        residuals.append(residual_test(name, left, "armature voltage", driven, fitted_rows))
    return traces, residuals
