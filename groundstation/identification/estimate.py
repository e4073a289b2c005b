"""What an identification found, how certain it is, and whether it is a result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.meanings import POOR, is_unusual, profile_constants
from groundstation.dynamics.model import EffectTerm, Estimate, Model, with_origin
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.report.page import Result
from groundstation.telemetry.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


TRUSTED = (0.3, 10.0)
"""Share of Gauss-Newton's curvature that the slopes at the ends of a step may make of it: what
noise and bounds do to them is not to send the next step out of sight."""


@dataclass(frozen=True, slots=True)
class Estimates:
    """Jointly estimated parameters.

    names, values (p,), covariance (p, p); degrees_of_freedom behind the covariance.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    degrees_of_freedom: float

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    @property
    def stderr(self) -> Array:
        """Standard errors, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Correlation matrix, (p, p)."""
        scale = np.where(self.stderr > 0, self.stderr, 1.0)
        return self.covariance / np.outer(scale, scale)

    @property
    def rows(self) -> list[tuple[str, float, float]]:
        """Name, value and standard error of each."""
        return list(zip(self.names, self.values.tolist(), self.stderr.tolist(), strict=True))

    @property
    def of_effects(self) -> dict[str, float]:
        """The ``effect.parameter`` among them, by name."""
        return {name: value for name, value, _ in self.rows if "." in name}

    def error_of(self, name: str) -> float:
        """Standard error of one."""
        return float(self.stderr[self.names.index(name)])

    def interval(self, probability: float = 0.95) -> Array:
        """Confidence intervals (p, 2) by Student's distribution."""
        from scipy.stats import t

        half = self.stderr * t.ppf(0.5 + 0.5 * probability, self.degrees_of_freedom)
        return np.stack([self.values - half, self.values + half], axis=1)

    def as_dict(self) -> dict[str, object]:
        """For the model file: values, standard errors, covariance and correlation by name."""
        return {
            "names": list(self.names),
            "values": self.values.tolist(),
            "stderr": self.stderr.tolist(),
            "covariance": self.covariance.tolist(),
            "correlation": self.correlation.tolist(),
            "degrees_of_freedom": self.degrees_of_freedom,
        }


def fit_percent(measured: ArrayLike, modelled: ArrayLike) -> float:
    """100 (1 - |y - y'| / |y - mean y|): 100 is perfect, 0 no better than the mean."""
    y, model = np.asarray(measured, np.float64), np.asarray(modelled, np.float64)
    spread = float(np.linalg.norm(y - y.mean()))
    if spread == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.linalg.norm(y - model)) / spread)


def rms(values: ArrayLike) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, np.float64)))))


def sandwich(normal: Array, scores: Array) -> Array:
    """Covariance N^-1 S N^-1 of a least-squares estimate whose errors are correlated in time.

    normal: (p, p), J^T W J. scores: (blocks, p), J^T W e summed over blocks of rows longer than
    the errors' memory; S is their sum of outer products, scaled for p degrees of freedom.
    """
    blocks, count = scores.shape
    bread = inverse(normal)
    meat = scores.T @ scores * (blocks / max(blocks - count, 1))
    return bread @ meat @ bread


def inverse(normal: Array) -> Array:
    """Pseudo-inverse of J^T W J whatever the units of its parameters."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    unit = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True)
    return unit / np.outer(scale, scale)


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


def as_met(normal: Array, step: Array, fall: Array) -> Array:
    """A normal matrix (p, p) with the curvature along the last step (p,) that its ends tell.

    fall: (p,) by how much the gradient fell over the step. Where residuals are large and bent,
    Gauss-Newton's steps are too long, and go to and fro, or too short (a secant condition, as in
    Dennis, Gay and Welsch 1981, along one direction).
    """
    along = normal @ step
    expected = float(step @ along)
    if expected <= 0.0:
        return normal
    ratio = float(np.clip(fall @ step / expected, *TRUSTED))
    return normal + (ratio - 1.0) / expected * np.outer(along, along)


# Is what a model leaves over noise? (thesis 7.3.7.5)


LAGS = 25
DRAWS = 2000


@dataclass(frozen=True, slots=True)
class CorrelationTest:
    """Correlation coefficients at ``lags`` rows and the 99 % bound of each if there were none.

    passes: not worse than 99 of 100 tests of unrelated signals of the same colours: at the worst
    lag, or, for whiteness, by the number of lags outside.
    """

    lags: NDArray[np.int64]
    values: Array
    bound: float
    passes: bool

    @property
    def outside(self) -> int:
        return int((np.abs(self.values) > self.bound).sum())


def whiteness_test(residual: ArrayLike) -> CorrelationTest:
    """Autocorrelation of residuals (n,) at 1..``LAGS`` rows, of few rows at fewer."""
    from scipy.stats import binom

    e = _centred(residual)
    most = _lags(LAGS, len(e))
    values = np.array([e[k:] @ e[:-k] for k in range(1, most + 1)]) / (e @ e)
    bound = _quantile() / np.sqrt(len(e))
    outside = int((np.abs(values) > bound).sum())
    passes = bool(outside <= binom.ppf(0.99, most, 0.01))
    return CorrelationTest(np.arange(1, most + 1), values, bound, passes)


def cross_correlation_test(
    residual: ArrayLike, inputs: ArrayLike, lags: int = LAGS, fitted_rows: int | None = None
) -> CorrelationTest:
    """Correlation of residuals with the input 0..lags rows before them, of few rows fewer.

    In closed loop later inputs follow from residuals: only non-negative lags speak about the
    model. Bound and verdict allow for colour in both signals. fitted_rows: of held-out residuals,
    how many rows the model was fitted on: what it does not know for want of them widens the bound.
    """
    e, u = _centred(residual), _centred(inputs)
    if e.shape != u.shape:
        raise ValueError(f"residual {e.shape} and inputs {u.shape} differ in length")
    lags = _lags(lags, len(e))
    scale = np.sqrt((e @ e) * (u @ u))
    values = np.array([e[k:] @ u[: len(u) - k] for k in range(lags + 1)]) / scale
    span = min(len(e) - 1, 200)
    auto_e = np.array([e[k:] @ e[: len(e) - k] for k in range(span)]) / (e @ e)
    auto_u = np.array([u[k:] @ u[: len(u) - k] for k in range(span)]) / (u @ u)
    variance = 1.0 + 2.0 * float(auto_e[1:] @ auto_u[1:])
    if fitted_rows is not None:
        variance = max(variance, 0.05) * (1.0 + len(e) / fitted_rows)
    deviation = np.sqrt(max(variance, 0.05) / len(e))
    largest = float(np.abs(values).max()) / deviation
    passes = bool(largest <= _largest_by_chance(auto_e, auto_u, lags))
    return CorrelationTest(np.arange(lags + 1), values, float(_quantile() * deviation), passes)


def _largest_by_chance(auto_e: Array, auto_u: Array, lags: int) -> float:
    """What the largest of lags + 1 estimates, in deviations, stays below in 99 of 100 tests.

    Estimates k lags apart have the covariance sum_j r_e(j) r_u(j + k) (Bartlett).
    """
    span = len(auto_e)
    mirrored = np.concatenate([auto_u[:0:-1], auto_u])
    whole = np.concatenate([auto_e[:0:-1], auto_e])
    shared = np.array([whole[: len(whole) - k] @ mirrored[k:] for k in range(min(lags + 1, span))])
    shared = np.pad(shared, (0, lags + 1 - len(shared)))
    rows = np.arange(lags + 1)
    weights, vectors = np.linalg.eigh(shared[np.abs(rows[:, None] - rows)])
    spread = vectors * np.sqrt(np.maximum(weights, 0.0))
    spread /= np.maximum(np.linalg.norm(spread, axis=1, keepdims=True), 1e-12)
    return float(np.quantile(np.abs(_draws(lags + 1) @ spread.T).max(axis=1), 0.99))


def _lags(wanted: int, rows: int) -> int:
    """As many as so few rows tell something of: a quarter of them (Box and Jenkins 1970)."""
    return max(1, min(wanted, rows // 4))


@lru_cache(maxsize=4)
def _draws(size: int) -> Array:
    return np.random.default_rng(0).normal(size=(DRAWS, size))


def _centred(values: ArrayLike) -> Array:
    array = np.asarray(values, np.float64)
    return array - array.mean()


def _quantile() -> float:
    from scipy.stats import norm

    return float(norm.ppf(0.995))


TOLD = 3.0
"""Standard errors from which a lag is told from none."""
Progress = Callable[[float, str], None]
"""(share done, what is being done)."""


Figures = list[tuple["Figure", str]]
"""Figures with what one sees in them."""


def silent(_share: float, _what: str) -> None:
    """No progress shown."""


@dataclass(frozen=True, slots=True)
class Trace:
    """A measured channel and what the model says of it, on data that no fit has seen.

    time_s, measured, modelled: (n,). note: how the model was run.
    """

    channel: str
    unit: str
    time_s: Array
    measured: Array
    modelled: Array
    note: str


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """Residuals of one channel, scaled to standard deviations, against themselves and an input."""

    channel: str
    against: str
    whiteness: CorrelationTest
    cross: CorrelationTest

    def as_dict(self) -> dict[str, Any]:
        """For the model file."""
        return {
            "whiteness": {"passes": self.whiteness.passes, "outside": self.whiteness.outside},
            "cross_correlation": {
                "against": self.against,
                "passes": self.cross.passes,
                "outside": self.cross.outside,
            },
        }


@dataclass(frozen=True, slots=True)
class Step:
    """Response of an ARX model to a unit step of u'."""

    axis: str
    label: str
    time_s: Array
    output: Array
    plausible: bool
    chosen: bool


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the report draws. estimates: by title. preparation: what was made of the recordings
    before the fit."""

    estimates: Mapping[str, Estimates] = field(default_factory=dict)
    traces: Sequence[Trace] = ()
    residuals: Sequence[ResidualTest] = ()
    steps: Sequence[Step] = ()
    preparation: Callable[[], Figures] | None = None

    @classmethod
    def of_all(cls, parts: Sequence[Evidence]) -> Evidence:
        """One after the other; without what was made of recordings."""
        return cls(
            {title: found for one in parts for title, found in one.estimates.items()},
            [trace for one in parts for trace in one.traces],
            [test for one in parts for test in one.residuals],
            [step for one in parts for step in one.steps],
        )


@dataclass(frozen=True, slots=True, repr=False)
class Identified(Result):
    """A model with what was identified in it, the account that its file keeps, the arrays behind.

    account: ``what``, ``method``, ``samples``, ``estimates``, ``identification``, ``validation``,
    ``warnings`` and what else the kind of fit has.
    """

    model: Model
    account: dict[str, Any]
    evidence: Evidence
    SHOWN_BY: ClassVar[str] = "groundstation.identification.report:identified"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful, in words."""
        return tuple(self.account["warnings"])

    def _what(self) -> str:
        found = numbers_of(self.account)
        numbers = ", ".join(f"{name} {value:.4g} +- {error:.1g}" for name, value, error in found)
        return f"{self.account['what']} of {self.model.vehicle}" + f": {numbers}" * bool(numbers)

    def documented(self, **provenance: Any) -> Model:
        """The model with the account under ``fit``, as later fits and designs need it.

        provenance: ``recordings``, ``held_out`` or whatever else belongs into the account.
        """
        account = {**self.account, **provenance}
        fit = {**self.model.fit, account["what"]: account}
        return with_origin(msgspec.structs.replace(self.model, fit=fit))


def numbers_of(account: Mapping[str, Any]) -> list[tuple[str, float, float]]:
    """Name, value and standard error of each estimate of an account; none where it has none."""
    found = account.get("estimates") or {}
    columns = (found.get(key, ()) for key in ("names", "values", "stderr"))
    return list(zip(*columns, strict=True))


def residual_test(
    channel: str, left: Array, against: str, inputs: Array, fitted_rows: int
) -> ResidualTest:
    """Both tests of held-out residuals (n,) and the input (n,) behind them."""
    cross = cross_correlation_test(left, inputs, fitted_rows=fitted_rows)
    return ResidualTest(channel, against, whiteness_test(left), cross)


def effect_terms(estimates: Estimates) -> list[EffectTerm]:
    """The effects among ``effect.parameter`` estimates, as models hold them."""
    found: dict[str, dict[str, Estimate]] = {}
    for name, value, error in estimates.rows:
        effect, dot, parameter = name.partition(".")
        if dot:
            estimate = Estimate(value, error, EFFECTS[effect].parameter(parameter).unit)
            found.setdefault(effect, {})[parameter] = estimate
    return [EffectTerm(name, parameters) for name, parameters in found.items()]


def along_term(value: float, stderr: float) -> list[EffectTerm]:
    """The lag of the sensor of rotor speeds, in s, as models hold it; nothing where none is told.

    A fit without a model of the motors (``fit body``) says it after the motors' and in its place.
    """
    from groundstation.identification.likelihood.motion import ALONG

    (size,) = ALONG.definition.sizes
    if not (value > TOLD * stderr and size.low <= value <= size.high):
        return []
    return [EffectTerm(ALONG.effect, {size.name: Estimate(value, stderr, size.unit)})]


def implausible(name: str, value: float, error: float) -> list[str]:
    """A warning where an effect's size is clearly outside what the catalogue says it may be."""
    effect, _, parameter = name.partition(".")
    known = EFFECTS[effect].parameter(parameter)
    outside = max(known.low - value, value - known.high, 0.0)
    if outside <= 2 * error or abs(value - known.absent) <= 2 * error:
        return []
    return [
        f"{name} is {value:.3g} +- {error:.2g} {known.unit}, outside the plausible"
        f" {known.low:g} to {known.high:g}: something else may be missing"
    ]


def with_effects(model: Model, terms: Sequence[EffectTerm]) -> tuple[EffectTerm, ...]:
    """A model's effects, those of the same name replaced and the rest kept."""
    new = {term.name for term in terms}
    return (*(term for term in model.effects if term.name not in new), *terms)


def fitted_effects(names: Sequence[str], model: Model, known: Sequence[str]) -> tuple[str, ...]:
    """The effects to fit: those that were asked for, then those of the starting model that this
    fit knows (a base that was fitted beside an effect is wrong without it)."""
    wanted = [*names, *(term.name for term in model.effects if term.name in known)]
    return tuple(dict.fromkeys(wanted))


def liveliest(signal: Array, period_s: float, seconds: float) -> slice:
    """The rows of ``seconds`` in which a signal (n,) varies most: what is worth drawing.

    Vibration, which is everywhere, does not count: changes of the mean over 50 ms do.
    """
    smooth = max(1, round(0.05 / period_s))
    sums = np.concatenate([[0.0], np.cumsum(signal)])
    means = (sums[smooth:] - sums[:-smooth]) / smooth if len(signal) >= smooth else signal
    width = min(len(means), max(2, round(seconds / period_s)))
    moved = np.concatenate([[0.0], np.cumsum(np.square(np.diff(means, prepend=means[:1])))])
    first = int(np.argmax(moved[width:] - moved[:-width]))
    return slice(first, first + width)


# Is this estimate a result? One set of rules for every fit.
#
# An estimate that stands where it began, one that no error is known of, one that no craft of the
# profile can have, and a model that predicts what it has not seen worse than the mean does, are
# what a fit leaves that could not fit: they are never passed on as a result. A body alone that only
# predicts badly is written, as a poor one: what it lacks may be an effect, and a search needs a
# model to begin with.


UNLIKE = 5.0
"""Times the profile's value, or one over it, that no craft of the profile has; one beyond
``meanings.UNUSUAL`` is worth a word."""
FREE = ("c2", "a1", "a2")
"""Constants that differ more from craft to craft, with the propellers and what drags on them: they
are worth a word where others are none, and the rest of the model stands."""
USELESS = -100.0
"""Per cent of fit, errors of twice the mean's, from which a model is none, or a poor one."""
TILT = ("roll", "pitch")
AWAY = 1e-9
"""Relative distance from its start by which an estimate has moved."""


def require_results(
    account: dict[str, Any], before: Model, vehicle: Vehicle, of_recordings: Sequence[str] = ()
) -> list[str]:
    """What is doubtful of a fit, in words. of_recordings: what is wrong with what it was made on.
    The account of a body that predicts badly gets its ``quality``: a search begins with it.

    Raises BadInputError, with the reasons, where estimates of it are no results.
    """
    reasons, poor, doubts = no_results(account, before, vehicle)
    if of_recordings:  # then they are why
        reasons += poor
    if reasons:
        raise BadInputError(
            f"{account['what']} not identified, because {'; '.join(reasons)}"
            + (f" ({'; '.join(of_recordings)})" if of_recordings else "")
            + ": look at the recordings with 'groundstation inspect', and is --vehicle the craft?"
        )
    if poor:
        account["quality"] = POOR
    return [*poor, *doubts]


def no_results(
    account: Mapping[str, Any], before: Model, vehicle: Vehicle
) -> tuple[list[str], list[str], list[str]]:
    """Why estimates of a fit are none, why those of a body are poor, and what else is doubtful, in
    words.

    account: what a workflow says of its fit. before: the model it began with.
    """
    reasons: list[str] = []
    poor: list[str] = []
    doubts: list[str] = []
    for name, value, error in numbers_of(account):
        if "." in name or name in account.get("not_identified", {}):
            continue  # an effect's own range is judged by who fits it
        start = _starts(before, vehicle).get(name)
        usual = profile_constants(vehicle).get(name, 0.0)
        stands = start is not None and abs(value - start) <= AWAY * abs(start)
        line = f"{name} is {value:.3g}, and {usual:.3g} by the profile {vehicle.name!r}"
        if not np.isfinite(value) or not np.isfinite(error):
            reasons.append(f"{name} is {value:.3g} +- {error:.2g}")
        elif error == 0.0:
            at = " where it began" if stands else ""
            reasons.append(f"{name} stands at {value:.4g}{at} and nothing tells its error")
        elif stands:
            reasons.append(f"{name} did not move from where it began, {value:.4g}")
        elif usual and is_unusual(value, usual, UNLIKE):
            (doubts if name in FREE else reasons).append(line)
        elif usual and is_unusual(value, usual):
            doubts.append(line)
    for name, percent, decides in _fits(account.get("validation")):
        if percent < 0.0:
            line = (
                f"{name} on unseen data is predicted worse than by its mean (fit {percent:.0f} %)"
            )
            useless = decides and percent < USELESS
            worst = poor if account["what"] == "body" else reasons
            (worst if useless else doubts).append(line)
    return reasons, poor, doubts


def _fits(validation: Any) -> Iterator[tuple[str, float, bool]]:
    """Name and per cent of what was predicted of unseen data, and whether it decides.

    Of a body roll and pitch do, where neither is predicted better than by its mean: a flight may
    hardly turn about one axis, or hardly climb.
    """
    if isinstance(validation, Mapping):
        percents = {k: float(v) for k, v in validation.items() if "fit_percent" in k}
        for name, percent in percents.items():
            both = (name.replace("roll", "pitch"), name.replace("pitch", "roll"))
            decides = any(one in name for one in TILT) and all(percents[one] < 0.0 for one in both)
            yield name.replace("_fit_percent", "").replace("_", " "), percent, decides
    elif isinstance(validation, Sequence):
        yield from (
            (f"rotor speed of {one['recording']}", float(one["rotor_fit_percent"]), True)
            for one in validation
            if "rotor_fit_percent" in one
        )


def _starts(before: Model, vehicle: Vehicle) -> dict[str, float]:
    """Where a fit began: the model's constants, or else the profile's."""
    found = profile_constants(vehicle) | msgspec.structs.asdict(before.motor)
    return found if before.body is None else found | msgspec.structs.asdict(before.body)
