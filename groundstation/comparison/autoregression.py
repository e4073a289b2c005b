"""The noise model of a prediction-error fit: autoregressive, estimated from what is left over.

e = A(q) v with white e: filtering data and regressors by A turns correlated errors v into
one-step prediction errors (thesis eq. 7.3-7.6 with H = 1/A). In closed loop this is what keeps
an estimate free of the noise that the controller feeds back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.telemetry.arrays import Array


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """whitener: (order + 1,) coefficients of A, the first 1. variance: of the white part."""

    whitener: Array
    variance: float


def estimate_noise(pieces: Sequence[Array], most: int) -> NoiseModel:
    """The autoregression behind residual pieces (n,), of the order that Akaike's rule likes.

    Yule-Walker on autocovariances pooled over the pieces; orders 0..most.
    """
    total = sum(len(piece) for piece in pieces)
    covariance = np.zeros(most + 1)
    for piece in pieces:
        size = 1 << int(np.ceil(np.log2(len(piece) + most + 1)))
        spectrum = np.abs(np.fft.rfft(piece, size)) ** 2
        covariance += np.fft.irfft(spectrum, size)[: most + 1]
    covariance /= total
    best, whitener = np.inf, np.ones(1)
    for order, coefficients, variance in _levinson(covariance):
        score = total * np.log(variance + 1e-300) + 2 * order
        if score < best:
            best, whitener, chosen = score, coefficients, variance
    return NoiseModel(whitener, float(chosen))


def _levinson(covariance: Array) -> list[tuple[int, Array, float]]:
    """Levinson-Durbin: (order, A, innovation variance) for every order."""
    a, variance = np.ones(1), float(covariance[0])
    found = [(0, a, variance)]
    for order in range(1, len(covariance)):
        reflection = -float(a @ covariance[order:0:-1]) / variance
        extended = np.concatenate([a, [0.0]])
        a = extended + reflection * extended[::-1]
        variance *= 1.0 - reflection**2
        if variance <= 0.0:
            break
        found.append((order, a, variance))
    return found
