"""ARX identification of one axis: every structure in a range at once (thesis 7.3.7).

Least squares needs nothing of the data but sums of products of lagged inputs and outputs. They
are the same for all structures, so one Gram matrix over the longest lags serves them all: each
structure solves a few of its rows and columns. The models are then judged by free runs, which
are restarted from measured outputs again and again: an unstable plant diverges in any long one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.model import ArxAxis, simulate_arx
from groundstation.errors import BadInputError
from groundstation.identification.arx.data import ArxData, require_usable
from groundstation.identification.arx.residual_tests import cross_correlation_test
from groundstation.identification.estimate import Estimates, sandwich
from groundstation.telemetry.arrays import Array

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
    """Structures as a user types them, ``na,nb,nk`` each, once.

    Raises BadInputError where one is none of the 88, or for more than can be told apart in one
    figure.
    """
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
        candidates.append(
            ArxCandidate(
                axis,
                errors[s][0],
                float(rms_fit[s]),
                float(rms_validation[s]),
                errors[s][1],
                plausible_step(axis),
            )
        )
    candidates.sort(key=lambda c: c.rms_validation)
    pool = [c for c in candidates if c.order in among] if among else candidates
    chosen = _simplest(pool) if criterion is Criterion.FREE_RUN else _likeliest(pool, rows, fit)
    return ArxSearch(tuple(candidates), chosen)


def arx_estimates(axis: ArxAxis, fit: Sequence[ArxData]) -> Estimates:
    """The model's coefficients a1.. and b1.. with a covariance that allows for coloured errors.

    Least squares takes them for white, which they are not where the structure is too small or
    the angle is held: scores are summed over half a second here.
    """
    first = max(MOST_POLES, axis.nk + axis.nb)
    size = axis.na + axis.nb
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
    order = np.array([[axis.na, axis.nb, axis.nk]])
    a, b = np.zeros((1, MOST_POLES)), np.array([axis.b])
    a[0, : axis.na] = axis.a
    longest = max(MOST_POLES, axis.nk + axis.nb)
    for one in data:
        require_usable(one, axis.ts, longest)
    return float(_free_run_rms(order, a, b, data, window_s, longest)[0])


def prediction_rms(axis: ArxAxis, data: Sequence[ArxData], steps: int) -> float:
    """RMS error of predictions ``steps`` rows ahead, over every row."""
    errors = []
    for one in data:
        predicted, first = predictions(axis, one, steps)
        errors.append((one.outputs - predicted)[first:])
    return float(np.sqrt(np.mean(np.square(np.concatenate(errors)))))


def predictions(axis: ArxAxis, data: ArxData, steps: int) -> tuple[Array, int]:
    """Outputs (n,) predicted ``steps`` rows ahead, and the first row that is a prediction."""
    from groundstation.identification.arx.kernel import steps_ahead

    a = np.zeros(MOST_POLES)
    a[: axis.na] = axis.a
    first = max(MOST_POLES, axis.nk + axis.nb)
    predicted = np.zeros(len(data.outputs))
    steps_ahead(a, np.array(axis.b), axis.nk, data.inputs, data.outputs, steps, first, predicted)
    return predicted, first + steps - 1


def residuals(axis: ArxAxis, data: ArxData) -> Array:
    """One-step prediction errors e = A y - B u, without the first rows that lack a past."""
    predicted, first = predictions(axis, data, 1)
    return (data.outputs - predicted)[first:]


def plausible_step(axis: ArxAxis) -> bool:
    """Whether a positive step of torque turns the axis the positive way for good (7.3.7.4).

    After the delay and 20 ms in which fast poles may settle, the response must be positive and
    must not turn back within 0.3 s, as that of a free body does not.
    """
    from groundstation.identification.arx.kernel import step_turns_one_way

    a = np.zeros(MOST_POLES)
    a[: axis.na] = axis.a
    settled, rows = round(SETTLE_STEP_S / axis.ts), round(STEP_S / axis.ts)
    return bool(step_turns_one_way(a, np.array(axis.b), axis.nk, settled, rows))


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
    from groundstation.identification.arx.kernel import free_run_errors

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
