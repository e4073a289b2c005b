"""Which generic signals clearly show in a channel's one-step errors, and how strongly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.autoregression import NoiseModel, estimate_noise
from groundstation.telemetry.arrays import Array

Pieces = Sequence[tuple[Array, Array]]
"""Stretches of signals (n, p) and of the errors (n, 3) of the channels they are for."""

CLEAR = 30.0
"""Drop of the weighted sum of squares from which a signal is let in: 5.5 standard deviations, as
a hundred are tried on nine channels."""
WEIGHT_ORDER = 10
"""Order of the spectrum that weights: the saturated fit takes some noise away where the signals
are strong, at low frequency; a long autoregression would follow it there and in closed loop that
is where the inputs mirror the disturbance."""
ROUNDS = 4


@dataclass(frozen=True, slots=True)
class ChannelPredictor:
    """What a black box learnt about one channel: chosen signals, and their weights."""

    columns: NDArray[np.int64]
    weights: Array


def fit_signals(pieces: Pieces) -> list[ChannelPredictor]:
    """One predictor for each of the three channels."""
    bands = _bands(pieces)
    return [
        _fit_channel([(errors[:, axis], signals) for signals, errors in pieces], bands, axis)
        for axis in range(3)
    ]


@dataclass(frozen=True, slots=True)
class _Bands:
    """Products of signals and errors of one kind, summed over narrow frequency bands.

    gram: (bands, p + 3, p + 3) of p signals, scaled by ``scale`` (p,), and three errors.
    frequency: (bands,) their middles in cycles per row.
    """

    gram: Array
    frequency: Array
    scale: Array

    def weighted(self, noise: NoiseModel, axis: int) -> Array:
        """R^T S^-1 R (p + 1, p + 1) of signals and one error, in units of the noise."""
        z = np.exp(-2j * np.pi * self.frequency)
        response = np.abs(np.polynomial.polynomial.polyval(z, noise.whitener)) ** 2
        total: Array = np.tensordot(response / noise.variance, self.gram, axes=1)
        keep = [*range(len(self.scale)), len(self.scale) + axis]
        return total[np.ix_(keep, keep)]


def _bands(parts: Pieces) -> _Bands:
    from scipy.fft import next_fast_len, rfft
    from scipy.signal.windows import tukey

    power = sum(np.square(signals).sum(axis=0) for signals, _ in parts)
    scale = np.sqrt(power / sum(len(signals) for signals, _ in parts))
    scale[scale == 0.0] = 1.0
    edges = np.concatenate([[0.0], np.geomspace(1e-3, 0.02, 15), np.linspace(0.026, 0.501, 80)])
    gram = np.zeros((len(edges) - 1, len(scale) + 3, len(scale) + 3))
    for signals, errors in parts:
        size = next_fast_len(len(signals), real=True)
        window = tukey(len(signals), 0.1)[:, None]
        stack = np.hstack([signals, errors])
        stack[:, : len(scale)] /= scale
        stack *= window
        spectrum = rfft(stack, size, axis=0, overwrite_x=True)
        spectrum *= np.sqrt(2.0 / size)
        spectrum[0] *= np.sqrt(0.5)
        if size % 2 == 0:
            spectrum[-1] *= np.sqrt(0.5)
        places = np.searchsorted(np.arange(len(spectrum)) / size, edges)
        for band, (low, high) in enumerate(pairwise(places)):
            part = spectrum[low:high]
            gram[band] += part.real.T @ part.real + part.imag.T @ part.imag
    return _Bands(gram, 0.5 * (edges[1:] + edges[:-1]), scale)


def _fit_channel(
    pieces: Sequence[tuple[Array, Array]], bands: _Bands, axis: int
) -> ChannelPredictor:
    """The signals that clearly show, weighted by the spectrum of what they leave.

    The first spectrum is that of a fit of all signals at once: one that still holds an effect
    would hide it. That fit takes away some noise too, so that later rounds use the residual of
    the chosen ones.
    """
    # From white noise: the spectrum of an error with an offset would forbid to see the offset.
    noise = NoiseModel(np.ones(1), 1.0)
    chosen = np.arange(len(bands.scale))
    weights, left = np.zeros(0), [error for error, _ in pieces]
    for turn in range(ROUNDS):
        if turn > 0:
            noise = estimate_noise(left, WEIGHT_ORDER)
            chosen = _select(bands.weighted(noise, axis))
        weights = _solve(bands.weighted(noise, axis), chosen) / bands.scale[chosen]
        every = np.zeros(len(bands.scale))  # a part of the columns would be a copy of them
        every[chosen] = weights
        left = [error - signals @ every for error, signals in pieces]
    return ChannelPredictor(chosen, weights)


def _solve(gram: Array, columns: NDArray[np.int64]) -> Array:
    if not len(columns):
        return np.zeros(0)
    normal = gram[np.ix_(columns, columns)]
    return np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ gram[columns, -1]


def _select(gram: Array) -> NDArray[np.int64]:
    """Forward selection: the strongest signal, given those before, until none is clear."""
    left = gram.copy()
    size = len(gram) - 1
    start = np.diag(gram)[:size].copy()
    chosen: list[int] = []
    while len(chosen) < size:
        diagonal = np.diag(left)[:size]
        usable = diagonal > 1e-6 * start
        drop = np.where(usable, left[:size, -1] ** 2 / np.where(usable, diagonal, 1.0), 0.0)
        drop[chosen] = 0.0
        best = int(np.argmax(drop))
        if drop[best] < CLEAR:
            break
        chosen.append(best)
        left -= np.outer(left[:, best], left[best]) / left[best, best]
    return np.array(chosen, np.int64)
