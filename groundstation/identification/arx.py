"""ARX identification (thesis 7.3.7): from flights to polynomials, with its tables and tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import (
    SLOPE_ROWS,
    ArxAxis,
    Model,
    arx_ahead,
    model_vehicle,
    of_rates,
    rotor_motors,
    simulate_arx,
)
from groundstation.dynamics.rotations import body_rates, euler_rates
from groundstation.dynamics.vehicle import Configuration, MotorConstants, Motors, Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.estimate import (
    Estimates,
    Evidence,
    Identified,
    Progress,
    Step,
    Trace,
    cross_correlation_test,
    inverse,
    liveliest,
    residual_test,
    sandwich,
    silent,
)
from groundstation.identification.flight import LEAST_S, Stretch, divided, stretches_of
from groundstation.identification.runs import EVERYTHING, Run, Selection, rotor_squares
from groundstation.prediction.prediction import Ahead
from groundstation.telemetry.arrays import AXES, Array

LEAST_ROWS = 300
SETTLE_S = 0.6
SHOWN_LAGS = 10


@dataclass(frozen=True, slots=True)
class ArxData:
    """One run of one axis. inputs: (n,) u' in (rev/s)^2, outputs: (n,) rad or rad/s."""

    name: str
    period_s: float
    inputs: Array
    outputs: Array


def arx_data(
    run: Run,
    axis: str,
    motor: MotorConstants | Motors,
    configuration: Configuration = "plus",
    *,
    channel: str = "attitude",
    decimate: int = 1,
) -> ArxData:
    """The mixer's u' and the angle (or the body rate) of one axis of a run.

    u' of a row is the mean over the period that ends with the row, so a body without delay has
    nk = 0 on its rate. channel: ``attitude`` (as in the thesis) or ``gyro``. decimate: rows of
    which one is kept, with u' and gyro averaged over them all, and of the angle a fresh one.

    Raises BadInputError where a channel is missing.
    """
    index = AXES.index(axis)
    outputs = getattr(run, channel)[:, index]
    if not np.isfinite(outputs).all():
        raise BadInputError(f"{run.name}: {channel} is not in every row; ARX on {axis} needs it")
    # The motors' simulation starts settled, which they were not: leave its transient out.
    settled = round(SETTLE_S / run.period_s)
    inputs = rotor_squares(run, motor).mixed(configuration)[settled:, index]
    outputs = outputs[settled:]
    if decimate > 1:
        first = 0
        if channel == "attitude":  # from the row from which every so many-th is fresh
            changed = np.flatnonzero(np.diff(outputs)) + 1
            first = int(np.bincount(changed % decimate, minlength=decimate).argmax())
        kept = np.arange(first + decimate, len(outputs), decimate)
        inputs = _block_means(inputs, kept, decimate)
        outputs = outputs[kept] if channel == "attitude" else _block_means(outputs, kept, decimate)
    columns = np.ascontiguousarray(inputs), np.ascontiguousarray(outputs)  # one type to numba
    return ArxData(run.name, run.period_s * decimate, *columns)


def _block_means(values: Array, kept: NDArray[np.intp], decimate: int) -> Array:
    """Means over the rows that end with each kept one."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return (sums[kept + 1] - sums[kept + 1 - decimate]) / decimate


def input_shows(fit: Sequence[ArxData]) -> float:
    """How clearly the input shows in the output: F of 11 lagged inputs beside 10 past outputs.

    About 1 where it does not show at all; beyond 3 it certainly does.
    """
    longest = SHOWN_LAGS
    outputs, inputs, targets = [], [], []
    for data in fit:
        rows = np.arange(longest, len(data.outputs))
        step = np.diff(data.outputs, prepend=data.outputs[0])
        targets.append(step[rows])
        outputs.append(np.column_stack([step[rows - i] for i in range(1, longest + 1)]))
        inputs.append(np.column_stack([data.inputs[rows - j] for j in range(longest + 1)]))
    target, past, driven = np.concatenate(targets), np.vstack(outputs), np.vstack(inputs)
    without = _left(np.column_stack([past, np.ones(len(past))]), target)
    both = np.column_stack([past, driven, np.ones(len(past))])
    left = _left(both, target)
    if left <= 0.0:
        return float("inf")
    return (without - left) / driven.shape[1] / (left / max(len(target) - both.shape[1], 1))


def _left(regressors: Array, target: Array) -> float:
    """Sum of squares that least squares leaves."""
    weights = inverse(regressors.T @ regressors) @ (regressors.T @ target)
    return float(np.square(target - regressors @ weights).sum())


def require_usable(data: ArxData, period_s: float, longest: int) -> None:
    """Raises BadInputError for data that no ARX model should see, with the reason."""
    if len(data.inputs) < LEAST_ROWS + longest:
        raise BadInputError(f"{data.name}: {len(data.inputs)} rows are too few for ARX models")
    if abs(data.period_s / period_s - 1) > 0.01:
        raise BadInputError(
            f"{data.name}: {1 / data.period_s:.1f} rows a second, others {1 / period_s:.1f};"
            " a discrete model needs one rate: fit them apart"
        )
    if not (np.isfinite(data.inputs).all() and np.isfinite(data.outputs).all()):
        raise BadInputError(f"{data.name}: input or output has holes; use a stretch without")
    if np.ptp(data.inputs) < 1e-9 * max(1.0, np.abs(data.inputs).max()) or not np.ptp(data.outputs):
        raise BadInputError(f"{data.name}: input or output is constant; excite the axis")


# ARX identification of one axis: every structure in a range at once (thesis 7.3.7).
#
# Least squares needs nothing of the data but sums of products of lagged inputs and outputs. They
# are the same for all structures, so one Gram matrix over the longest lags serves them all: each
# structure solves a few of its rows and columns. The models are then judged by free runs, which
# are restarted from measured outputs again and again: an unstable plant diverges in any long one.


MOST_POLES = 4
POLES, INPUTS, DELAYS = range(1, MOST_POLES + 1), range(1, 3), range(11)
GRID = (POLES, INPUTS, DELAYS)
"""The thesis's 88 structures (na, nb, nk)."""
MOST_BESIDE = 7
"""Colours that a figure has for lines."""
Order = tuple[int, int, int]
WINDOW_S = 2.0
"""Free runs start afresh from measured outputs after this long."""
PARSIMONY = 0.05
"""A simpler model wins unless a larger one is better by this share on validation data."""
STEP_S, SETTLE_STEP_S = 0.3, 0.02
BLOCK_S = 0.5
MOST_TESTED = 12
"""Structures whose residuals are tested, from the likeliest on."""


class Criterion(StrEnum):
    """What makes one structure better than another."""

    FREE_RUN = "free_run"
    """Free-run RMS on validation data, as in the thesis: among plausible models, the fewest
    coefficients within 5 % of the best. Judges slow behaviour; hardly sees delay or noise."""
    PREDICTION = "prediction"
    """One-step error on identification data with Schwarz's penalty for each coefficient: the
    first plausible structure whose residuals do not follow the input. Judges delay and noise
    model; what it chooses leaves white residuals where any structure does."""


@dataclass(frozen=True, slots=True)
class ArxCandidate:
    """One structure: the model, its standard errors (a then b), its free-run errors (RMS, unit
    of the output) on identification and validation data, its one-step error on identification
    data, and whether its step response is plausible (same sign as the input, never turning
    back)."""

    axis: ArxAxis
    stderr: Array
    rms_fit: float
    rms_validation: float
    rms_step: float
    plausible: bool

    @property
    def order(self) -> Order:
        return self.axis.na, self.axis.nb, self.axis.nk

    @property
    def label(self) -> str:
        return f"ARX({self.axis.na},{self.axis.nb},{self.axis.nk})"


@dataclass(frozen=True, slots=True)
class ArxSearch:
    """Outcome of ``search_arx``: candidates by validation error, and the one to use."""

    candidates: tuple[ArxCandidate, ...]
    chosen: ArxCandidate


def parse_orders(texts: Sequence[str]) -> list[Order]:
    """Structures as a user types them, ``na,nb,nk`` each, once. Raises BadInputError where one is
    none of the 88, or for more than can be told apart in one figure."""
    found: list[Order] = []
    for text in texts:
        parts = text.split(",")
        given = tuple(int(part) if part.strip().isdecimal() else -1 for part in parts)
        if len(given) != 3 or any(g not in r for g, r in zip(given, GRID, strict=True)):
            raise BadInputError(
                f"--order {text}: must be na,nb,nk with na 1..{MOST_POLES}, nb 1..{INPUTS[-1]}, nk"
                f" 0..{DELAYS[-1]}, for example 2,1,8"
            )
        if given not in found:
            found.append(given)
    if len(found) > MOST_BESIDE:
        raise BadInputError(f"--order: {len(found)} structures, at most {MOST_BESIDE} at once")
    return found


def search_arx(
    fit: Sequence[ArxData],
    validation: Sequence[ArxData],
    na: Iterable[int] = POLES,
    nb: Iterable[int] = INPUTS,
    nk: Iterable[int] = DELAYS,
    criterion: Criterion = Criterion.FREE_RUN,
    among: Sequence[Order] = (),
) -> ArxSearch:
    """Fit and judge every structure, and choose one by ``criterion``. Orders up to 4 poles.

    among: the structures (na, nb, nk) that may be chosen; all of them where it is empty.

    Raises BadInputError for data that cannot tell: too short, constant, not finite, uneven rates.
    """
    orders = np.array([(p, q, d) for p in na for q in nb for d in nk], np.int64)
    longest = int(max(MOST_POLES, (orders[:, 1] + orders[:, 2]).max()))
    for data in (*fit, *validation):
        require_usable(data, fit[0].period_s, longest)
    gram, rows = _gram(fit, longest)
    a, b = np.zeros((len(orders), MOST_POLES)), np.zeros((len(orders), int(orders[:, 1].max())))
    errors = []
    for s, order in enumerate(orders):
        theta, stderr, rms_step = _solve(gram, rows, order)
        a[s, : order[0]], b[s, : order[1]] = theta[: order[0]], theta[order[0] :]
        errors.append((stderr, rms_step))
    period = fit[0].period_s
    rms_fit = _free_run_rms(orders, a, b, fit, WINDOW_S, longest)
    rms_validation = _free_run_rms(orders, a, b, validation, WINDOW_S, longest)
    candidates = []
    for s, (p, q, d) in enumerate(orders.tolist()):
        axis = ArxAxis(p, q, d, tuple(a[s, :p].tolist()), tuple(b[s, :q].tolist()), period)
        (stderr, step), free = errors[s], (float(rms_fit[s]), float(rms_validation[s]))
        candidates.append(ArxCandidate(axis, stderr, *free, step, plausible_step(axis)))
    candidates.sort(key=lambda c: c.rms_validation)
    pool = [c for c in candidates if c.order in among] if among else candidates
    chosen = _simplest(pool) if criterion is Criterion.FREE_RUN else _likeliest(pool, rows, fit)
    return ArxSearch(tuple(candidates), chosen)


def arx_estimates(axis: ArxAxis, fit: Sequence[ArxData]) -> Estimates:
    """The model's coefficients a1.. and b1.. with a covariance that allows for coloured errors.

    They are where the structure is too small or the angle is held: scores are summed over
    ``BLOCK_S``.
    """
    first, size = _longest(axis), axis.na + axis.nb
    normal, scores = np.zeros((size, size)), []
    for data in fit:
        rows = np.arange(first, len(data.outputs))
        regressors = np.column_stack(
            [-data.outputs[rows - i] for i in range(1, axis.na + 1)]
            + [data.inputs[rows - axis.nk - j] for j in range(axis.nb)]
        )
        error = residuals(axis, data)
        normal += regressors.T @ regressors
        blocks = np.arange(0, len(rows), max(round(BLOCK_S / data.period_s), 1))
        scores.append(np.add.reduceat(regressors * error[-len(rows) :, None], blocks))
    blocks_of_all = np.vstack(scores)
    names = [f"a{i}" for i in range(1, axis.na + 1)] + [f"b{j}" for j in range(1, axis.nb + 1)]
    return Estimates(
        tuple(names),
        np.array([*axis.a, *axis.b]),
        sandwich(normal, blocks_of_all),
        max(len(blocks_of_all) - size, 1),
    )


def step_response(axis: ArxAxis, seconds: float = 0.5) -> tuple[Array, Array]:
    """(time in s, output) of a unit step of u'; a model of rates is integrated by the caller."""
    rows = round(seconds / axis.ts)
    time = np.asarray(axis.ts * np.arange(rows), np.float64)
    return time, simulate_arx(axis, np.ones(rows))


def free_run_rms(axis: ArxAxis, data: Sequence[ArxData], window_s: float = WINDOW_S) -> float:
    """Free-run RMS error of any model on any data: also one axis's model on another's."""
    order, longest = np.array([[axis.na, axis.nb, axis.nk]]), _longest(axis)
    for one in data:
        require_usable(one, axis.ts, longest)
    b = np.array([axis.b])
    return float(_free_run_rms(order, _poles(axis)[None], b, data, window_s, longest)[0])


def prediction_rms(axis: ArxAxis, data: Sequence[ArxData], steps: int) -> float:
    """RMS error of predictions ``steps`` rows ahead, over every row."""
    errors = []
    for one in data:
        predicted, first = predictions(axis, one, steps)
        errors.append((one.outputs - predicted)[first:])
    return float(np.sqrt(np.mean(np.square(np.concatenate(errors)))))


def predictions(axis: ArxAxis, data: ArxData, steps: int) -> tuple[Array, int]:
    """Outputs (n,) predicted ``steps`` rows ahead, and the first row that is a prediction."""
    from groundstation.identification.likelihood.kernels import steps_ahead

    a, b, first = _poles(axis), np.array(axis.b), _longest(axis)
    predicted = np.zeros(len(data.outputs))
    steps_ahead(a, b, axis.nk, data.inputs, data.outputs, steps, first, predicted)
    return predicted, first + steps - 1


def _longest(axis: ArxAxis) -> int:
    """Rows that a model looks back."""
    return max(MOST_POLES, axis.nk + axis.nb)


def _poles(axis: ArxAxis) -> Array:
    """a, (``MOST_POLES``,) with 0 behind its last."""
    return np.pad(np.array(axis.a, np.float64), (0, MOST_POLES - axis.na))


def residuals(axis: ArxAxis, data: ArxData) -> Array:
    """One-step prediction errors e = A y - B u, without the first rows that lack a past."""
    predicted, first = predictions(axis, data, 1)
    return (data.outputs - predicted)[first:]


def plausible_step(axis: ArxAxis) -> bool:
    """Whether a positive step of torque turns the axis the positive way for good (7.3.7.4).

    After the delay and 20 ms in which fast poles may settle, the response must be positive and
    must not turn back within 0.3 s, as that of a free body does not.
    """
    from groundstation.identification.likelihood.kernels import step_turns_one_way

    settled, rows = round(SETTLE_STEP_S / axis.ts), round(STEP_S / axis.ts)
    return bool(step_turns_one_way(_poles(axis), np.array(axis.b), axis.nk, settled, rows))


DIFFERENCES = np.array([[1, 0, 0, 0], [1, -1, 0, 0], [1, -2, 1, 0], [1, -3, 3, -1]], np.float64)
"""Differences of order 0..3 of y(t-1), over y(t-1) .. y(t-4): past outputs that are nearly equal
to each other would leave a Gram matrix of the outputs themselves without correct digits."""


def _gram(fit: Sequence[ArxData], longest: int) -> tuple[Array, int]:
    """Sums of products of (y(t) - y(t-1), differences of y(t-1), u lagged), and how many rows."""
    size = 1 + MOST_POLES + longest
    gram, rows = np.zeros((size, size)), 0
    for data in fit:
        count = len(data.inputs) - longest
        lagged = np.empty((size, count))
        change = np.diff(data.outputs, prepend=0.0)
        lagged[0] = change[longest:]
        signal = data.outputs
        for i in range(MOST_POLES):
            lagged[1 + i] = signal[longest - 1 : longest - 1 + count]
            signal = np.diff(signal, prepend=0.0)
        for j in range(longest):
            lagged[1 + MOST_POLES + j] = data.inputs[longest - j : longest - j + count]
        gram += lagged @ lagged.T
        rows += count
    return gram, rows


def _solve(gram: Array, rows: int, order: NDArray[np.int64]) -> tuple[Array, Array, float]:
    """Coefficients (a then b) of one structure, their standard errors, the one-step RMS error."""
    na, nb, nk = (int(value) for value in order)
    inputs = 1 + MOST_POLES + nk
    chosen = np.array([*range(1, na + 1), *range(inputs, inputs + nb)])
    scale = np.sqrt(gram[chosen, chosen])
    matrix = gram[chosen[:, None], chosen] / (scale[:, None] * scale)
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:  # inputs that are copies of each other
        inverse = np.linalg.pinv(matrix, hermitian=True)
    theta = inverse @ (gram[chosen, 0] / scale)
    left = max(float(gram[0, 0] - theta @ (gram[chosen, 0] / scale)), 0.0)
    variance = left / max(rows - len(chosen), 1)
    # From differences back to y(t) + a1 y(t-1) + ...
    back = np.eye(na + nb)
    back[:na, :na] = -DIFFERENCES[:na, :na].T
    back = back / scale
    coefficients = back @ theta
    coefficients[0] -= 1.0
    stderr = np.sqrt(variance * np.maximum(((back @ inverse) * back).sum(axis=1), 0.0))
    return coefficients, stderr, float(np.sqrt(left / rows))


def _free_run_rms(
    orders: NDArray[np.int64],
    a: Array,
    b: Array,
    data: Sequence[ArxData],
    window_s: float,
    first: int,
) -> Array:
    from groundstation.identification.likelihood.kernels import free_run_errors

    sums, rows = np.zeros(len(orders)), 0
    for one in data:
        window = max(1, round(window_s / one.period_s))
        free_run_errors(orders, a, b, one.inputs, one.outputs, window, first, sums)
        rows += len(one.inputs) - first
    return np.sqrt(sums / max(rows, 1))


def _simplest(candidates: Sequence[ArxCandidate]) -> ArxCandidate:
    """The parsimony rule of ``Criterion.FREE_RUN``; candidates by validation error."""
    usable = [c for c in candidates if c.plausible and np.isfinite(c.rms_validation)]
    pool = usable or list(candidates)
    limit = (1 + PARSIMONY) * pool[0].rms_validation
    good = [c for c in pool if c.rms_validation <= limit] or list(pool[:1])
    return min(good, key=lambda c: (c.axis.na + c.axis.nb, c.rms_validation))


def _likeliest(
    candidates: Sequence[ArxCandidate], rows: int, fit: Sequence[ArxData]
) -> ArxCandidate:
    """The smallest Schwarz criterion n ln(s^2) + p ln(n), as ``Criterion.PREDICTION`` says."""

    def schwarz(candidate: ArxCandidate) -> float:
        count = candidate.axis.na + candidate.axis.nb
        return float(2 * rows * np.log(candidate.rms_step + 1e-300) + count * np.log(rows))

    ranked = sorted(candidates, key=schwarz)
    pool = [one for one in ranked if one.plausible] or ranked
    longest = max(fit, key=lambda data: len(data.outputs))
    for one in pool[:MOST_TESTED]:
        left = residuals(one.axis, longest)
        if cross_correlation_test(left, longest.inputs[-len(left) :]).passes:
            return one
    return pool[0]


# A model whose attitude is its ARX polynomials, on recorded inputs (thesis eq. 7.32-7.34).
#
# The polynomials say how the craft turns, with their delay; thrust, and the kinematics between
# angles and body rates, are those of the body.


PART = 20_000
"""Starts flown at once, which bounds the memory."""


def with_arx_attitude(body: Ahead, model: Model, run: Run) -> Ahead:
    """What the body predicts of a run, with rates and angles by the model's ARX polynomials.

    Each prediction starts from the outputs that were measured until its first row. run: without
    holes in duty, supply, gyro and attitude.

    Raises BadInputError where the rows of the run and those of the model do not fit together.
    """
    polynomials = model.arx or {}
    every = _rows_per_step(model, run)
    inputs = rotor_squares(run, rotor_motors(model)).mixed(model_vehicle(model).configuration)
    inputs = _means(inputs, every)
    rates = of_rates(model)
    attitude = np.unwrap(run.attitude, axis=0)
    outputs = _means(run.gyro, every) if rates else attitude
    middle = 0.5 * (every - 1) if rates else 0.0  # a mean over rows is of the time between them
    longest = int(body.horizons[-1]) + int(np.ceil(middle))
    gyro, angles = body.gyro.copy(), body.attitude.copy()
    for first in range(0, len(body.rows), PART):
        part = slice(first, first + PART)
        starts = body.rows[part]
        each = [
            arx_ahead(polynomials[axis], inputs[:, i], outputs[:, i], starts, longest, every)
            for i, axis in enumerate(AXES)
        ]
        flown = np.stack(each, axis=-1)
        if rates:
            flown = _at(flown, middle, int(body.horizons[-1]))
            turned = _integrated(flown, attitude[starts], run.period_s)
            gyro[part], angles[part] = flown[:, body.horizons], turned[:, body.horizons]
        else:
            # Rates are what the angles turned lately.
            span = max(SLOPE_ROWS, every)
            before = np.maximum(starts[:, None] + np.arange(-span, 0), 0)
            whole = np.concatenate([attitude[before], flown], axis=1)
            turned = whole[:, body.horizons + span] - whole[:, body.horizons]
            angles[part] = flown[:, body.horizons]
            gyro[part] = body_rates(flown[:, body.horizons], turned / (span * run.period_s))
    return replace(body, gyro=gyro, attitude=angles)


def _rows_per_step(model: Model, run: Run) -> int:
    (ts, *others) = {one.ts for one in (model.arx or {}).values()}
    every = round(ts / run.period_s)
    if others or every < 1 or abs(ts / (every * run.period_s) - 1.0) > 0.01:
        raise BadInputError(
            f"{run.name}: {1 / run.period_s:.1f} rows a second, the model's ARX polynomials make"
            f" {1 / ts:.1f} steps; fit them on recordings of this rate, or use --attitude body"
        )
    return every


def _means(values: Array, every: int) -> Array:
    """Means over the ``every`` rows that end with each row, (n, 3)."""
    sums = np.vstack([np.zeros((1, 3)), np.cumsum(values, axis=0)])
    last = np.arange(1, len(values) + 1)
    first = np.maximum(last - every, 0)
    return (sums[last] - sums[first]) / (last - first)[:, None]


def _at(flown: Array, later: float, longest: int) -> Array:
    """Values (m, longest + 1, 3) some rows later in (m, rows + 1, 3), on straight lines."""
    rows = later + np.arange(longest + 1.0)
    before = np.floor(rows).astype(np.int64)
    after = np.minimum(before + 1, flown.shape[1] - 1)
    share = (rows - before)[:, None]
    return (1.0 - share) * flown[:, before] + share * flown[:, after]


def _integrated(rates: Array, attitude: Array, period_s: float) -> Array:
    """Angles (m, rows + 1, 3) of body rates over rows, from angles (m, 3) (eq. 3.11)."""
    turned = np.empty_like(rates)
    turned[:, 0] = attitude
    for row in range(1, rates.shape[1]):
        mean = 0.5 * (rates[:, row - 1] + rates[:, row])
        turned[:, row] = turned[:, row - 1] + period_s * euler_rates(turned[:, row - 1], mean)
    return turned


STEPS_DRAWN = 4
AHEAD_S = (0.02, 0.05)
DRAWN_S = 3.0
LEAST_F = 3.0
LONGEST_ROWS = 12
"""Rows that the largest structure looks back."""
UNITS = {"attitude": ("rad", "angle"), "gyro": ("rad/s", "rate")}


def identify_arx(
    runs: Sequence[Run],
    held: Sequence[Run],
    before: Model,
    vehicle: Vehicle,
    criterion: Criterion = Criterion.FREE_RUN,
    channel: str = "attitude",
    decimate: int = 1,
    selection: Selection = EVERYTHING,
    orders: Sequence[Order] = (),
    progress: Progress = silent,
) -> Identified:
    """One ARX polynomial per axis, angle (or rate) from u', with the table of all structures.

    held: what no fit sees (none: ``divided``). channel, decimate: as in ``arx_data``. orders:
    structures to choose from and to show beside each other, instead of all.
    """
    motors, configuration = rotor_motors(before), vehicle.configuration
    fit_on, apart = stretches_of(runs, motors, selection=selection), ""
    if held:
        validate_on = stretches_of(held, motors, selection=selection)
    else:
        least_s = (LEAST_ROWS + LONGEST_ROWS) * decimate * fit_on[0].run.period_s
        fit_on, validate_on, apart = divided(fit_on, configuration, max(least_s, LEAST_S))

    def rows_of(part: Sequence[Stretch], axis: str) -> list[ArxData]:
        how: dict[str, Any] = {"channel": channel, "decimate": decimate}
        return [arx_data(one.run[one.rows], axis, motors, configuration, **how) for one in part]

    data = {axis: (rows_of(fit_on, axis), rows_of(validate_on, axis)) for axis in AXES}
    for one, other in data.values():
        for part in (*one, *other):
            require_usable(part, one[0].period_s, LONGEST_ROWS)
    found: dict[str, _Found] = {}
    for number, (axis, parts) in enumerate(data.items()):
        progress(number / 3, f"searching models of {axis}")
        found[axis] = _found(axis, channel, criterion, orders, *parts)
    account = {
        "what": "arx",
        "method": f"least squares, chosen by {criterion.value.replace('_', ' ')}",
        "channel": channel,
        "decimate": decimate,
        "samples": sum(len(one) for one in fit_on),
        "selection": str(selection),
        "held_out": apart,
        "orders": [list(order) for order in orders],
        "axes": {axis: one.report for axis, one in found.items()},
        "other_axis": {
            "roll_model_on_pitch": free_run_rms(found["roll"].chosen, data["pitch"][1]),
            "pitch_model_on_roll": free_run_rms(found["pitch"].chosen, data["roll"][1]),
        },
        "warnings": [line for one in found.values() for line in one.warnings],
    }
    model = msgspec.structs.replace(before, arx={axis: one.chosen for axis, one in found.items()})
    return Identified(model, account, Evidence.of_all([one.evidence for one in found.values()]))


@dataclass(frozen=True, slots=True)
class _Found:
    """The model of one axis. report: its part of the account."""

    chosen: ArxAxis
    report: dict[str, Any]
    warnings: list[str]
    evidence: Evidence


def _found(
    axis: str,
    channel: str,
    criterion: Criterion,
    orders: Sequence[Order],
    fit_on: Sequence[ArxData],
    validate_on: Sequence[ArxData],
) -> _Found:
    """The search of one axis; what is shown of it has the chosen structure first."""
    shown = input_shows(fit_on)
    if shown < LEAST_F:
        names = ", ".join(sorted({one.name for one in fit_on}))
        raise BadInputError(
            f"{names}: torque does not show in {axis} (F = {shown:.1f}, at least {LEAST_F:.0f} is"
            " needed); excite that axis"
        )
    search = search_arx(fit_on, validate_on, criterion=criterion, among=orders)
    chosen, (unit, name) = search.chosen, UNITS[channel]
    named = [one for one in search.candidates if one.order in orders and one is not chosen]
    beside, data = [chosen, *named], validate_on[0]
    estimates = arx_estimates(chosen.axis, fit_on)
    tests, traces, rows_fitted = [], [], sum(len(part.outputs) for part in fit_on)
    for one in beside:
        left, title = residuals(one.axis, data), f"{axis} {name}, {one.label}"
        inputs = data.inputs[-len(left) :]
        tests.append(residual_test(title, left, f"{axis} u'", inputs, rows_fitted))
        predicted, first = predictions(one.axis, data, max(1, round(AHEAD_S[1] / one.axis.ts)))
        drawn = first + np.arange(len(data.outputs) - first)
        drawn = drawn[liveliest(data.outputs[first:], data.period_s, DRAWN_S)]
        time = np.asarray(data.period_s * drawn, np.float64)
        turned, modelled = (180.0 / np.pi * rows[drawn] for rows in (data.outputs, predicted))
        note = f"predicted {1e3 * AHEAD_S[1]:.0f} ms ahead by {one.label}"
        degrees = unit.replace("rad", "deg")
        traces.append(Trace(f"{axis} {name}", degrees, time, turned, modelled, note))
    others = {one.label: test.as_dict() for one, test in zip(named, tests[1:], strict=True)}
    report = {
        "chosen": chosen.label,
        "input_shows_f": shown,
        "estimates": estimates.as_dict(),
        **_ahead("identification", chosen.axis, fit_on, unit),
        **_ahead("validation", chosen.axis, validate_on, unit),
        "table": _table(search, fit_on, validate_on, unit),
        **tests[0].as_dict(),
        **({"beside": others} if others else {}),
    }
    warnings = []
    if not chosen.plausible:
        warnings.append(f"{axis}: the step response of the chosen model is not plausible")
    if not tests[0].cross.passes:
        warnings.append(f"{axis}: the residuals of the chosen model follow its input")
    steps = _steps(axis, search, beside)
    evidence = Evidence({f"{axis} {chosen.label}": estimates}, traces, tests, steps)
    return _Found(chosen.axis, report, warnings, evidence)


def _ahead(part: str, axis: ArxAxis, data: Sequence[ArxData], unit: str) -> dict[str, float]:
    unit = unit.replace("/", "_")
    return {
        f"rms_{1e3 * horizon:.0f}ms_{part}_{unit}": prediction_rms(
            axis, data, max(1, round(horizon / axis.ts))
        )
        for horizon in AHEAD_S
    }


def _table(
    search: ArxSearch, one: Sequence[ArxData], other: Sequence[ArxData], unit: str
) -> list[dict[str, Any]]:
    """Every structure, the best by free run first, as the thesis's tables 7.3 and 7.5."""
    name = unit.replace("/", "_")
    return [
        {
            "model": candidate.label,
            f"rms_identification_{name}": candidate.rms_fit,
            f"rms_validation_{name}": candidate.rms_validation,
            f"rms_1row_identification_{name}": candidate.rms_step,
            **_ahead("identification", candidate.axis, one, unit),
            **_ahead("validation", candidate.axis, other, unit),
            "plausible_step": candidate.plausible,
        }
        for candidate in search.candidates
    ]


def _steps(axis: str, search: ArxSearch, beside: Sequence[ArxCandidate]) -> list[Step]:
    """Step responses of the structures that are shown, of the best by validation where only one
    is."""
    best = [one for one in search.candidates[:STEPS_DRAWN] if one is not search.chosen]
    return [
        Step(axis, one.label, *step_response(one.axis), one.plausible, one is search.chosen)
        for one in (beside if beside[1:] else (search.chosen, *best))
    ]
