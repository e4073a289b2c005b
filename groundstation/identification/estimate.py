"""Numbers with their uncertainty, how well a model fits, and whether what it leaves over is
noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.telemetry.arrays import Array

# Numbers with their uncertainty, and how well a model fits.


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
    the errors' memory; S is their sum of outer products, scaled for the p degrees of freedom
    that the fit took from them.
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


# Is what a model leaves over noise? Whiteness and cross-correlation (thesis 7.3.7.5).


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

    In closed loop later inputs do follow from residuals, through the controller: only
    non-negative lags speak about the model. The bound allows for colour in both signals. So does
    the verdict: with a slow input neighbouring lags say the same, and leave the bound together.
    fitted_rows: where the residuals are of held-out data, how many rows the model was fitted on:
    what it does not know exactly for want of them is the input's part too, and widens the bound.
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
