"""Is what a model leaves over noise? Whiteness and cross-correlation (thesis 7.3.7.5)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.telemetry.arrays import Array

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
