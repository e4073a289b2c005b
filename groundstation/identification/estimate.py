"""Numbers with their uncertainty, and how well a model fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.telemetry.arrays import Array

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
