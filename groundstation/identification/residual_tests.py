"""Is what a model leaves over noise? Whiteness and cross-correlation (thesis 7.3.7.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

LAGS = 25


@dataclass(frozen=True, slots=True)
class CorrelationTest:
    """Correlation coefficients at ``lags`` rows and the 99 % bound of each if there were none.

    A share of 1 % lies outside by chance: the test passes while no more do than 99 of 100 tests
    of uncorrelated signals would show.
    """

    lags: NDArray[np.int64]
    values: Array
    bound: float

    @property
    def outside(self) -> int:
        return int((np.abs(self.values) > self.bound).sum())

    @property
    def passes(self) -> bool:
        from scipy.stats import binom

        return bool(self.outside <= binom.ppf(0.99, len(self.lags), 0.01))


def whiteness_test(residual: ArrayLike, lags: int = LAGS) -> CorrelationTest:
    """Autocorrelation of residuals (n,) at 1..lags rows."""
    e = _centred(residual)
    values = np.array([e[k:] @ e[:-k] for k in range(1, lags + 1)]) / (e @ e)
    return CorrelationTest(np.arange(1, lags + 1), values, _quantile() / np.sqrt(len(e)))


def cross_correlation_test(
    residual: ArrayLike, inputs: ArrayLike, lags: int = LAGS, fitted_rows: int | None = None
) -> CorrelationTest:
    """Correlation of residuals with the input 0..lags rows before them.

    In closed loop later inputs do follow from residuals, through the controller: only
    non-negative lags speak about the model. The bound allows for colour in both signals.
    fitted_rows: where the residuals are of held-out data, how many rows the model was fitted on:
    what it does not know exactly for want of them is the input's part too, and widens the bound.
    """
    e, u = _centred(residual), _centred(inputs)
    if e.shape != u.shape:
        raise ValueError(f"residual {e.shape} and inputs {u.shape} differ in length")
    scale = np.sqrt((e @ e) * (u @ u))
    values = np.array([e[k:] @ u[: len(u) - k] for k in range(lags + 1)]) / scale
    span = min(len(e) - 1, 200)
    auto_e = np.array([e[k:] @ e[: len(e) - k] for k in range(span)]) / (e @ e)
    auto_u = np.array([u[k:] @ u[: len(u) - k] for k in range(span)]) / (u @ u)
    variance = 1.0 + 2.0 * float(auto_e[1:] @ auto_u[1:])
    if fitted_rows is not None:
        variance = max(variance, 0.05) * (1.0 + len(e) / fitted_rows)
    bound = _quantile() * np.sqrt(max(variance, 0.05) / len(e))
    return CorrelationTest(np.arange(lags + 1), values, float(bound))


def _centred(values: ArrayLike) -> Array:
    array = np.asarray(values, np.float64)
    return np.asarray(array - array.mean())


def _quantile() -> float:
    from scipy.stats import norm

    return float(norm.ppf(0.995))
