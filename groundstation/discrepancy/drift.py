"""How likely a series is a first-order process beside white noise, and how large that then is.

Every lag counts: of a flight of ten seconds, whose half seconds are twenty numbers, neighbours
alone tell at most 4.5 standard errors, however plainly it drifts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from groundstation.telemetry.arrays import Array

SHARES = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97])
"""Of the variance that the process may have: steps that cost less than a tenth of -2 log L."""


def drift_of(series: Sequence[Array], step_s: float, paces_s: Sequence[float]) -> tuple[Array, ...]:
    """(drop of -2 log L against white noise, variance of the process), each (paces, channels).

    series: of each flight the values (n, channels), one every ``step_s``, NaN where unknown; what
    lasts is part of the process, whose mean is zero. The likelihood is exact (a Kalman filter,
    Harvey 1989, chapter 3), the total variance profiled out; 0 where white noise is likelier.
    """
    values = np.concatenate(series)
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=0), 1)
    total = np.where(known, values, 0.0)
    total = np.square(total).sum(axis=0) / count
    fades = np.exp(-step_s / np.asarray(paces_s))
    white = count * np.log(np.where(total > 0.0, total, 1.0))
    squares, logarithms = (
        np.sum(parts, axis=0)
        for parts in zip(*(_innovations(one, fades) for one in series), strict=True)
    )
    scale = squares / count
    fits = count * np.log(np.where(scale > 0.0, scale, 1.0)) + logarithms  # (paces, shares, c)
    best = fits.argmin(axis=1)
    drop = white - np.take_along_axis(fits, best[:, None], axis=1)[:, 0]
    drop = np.where(total > 0.0, drop, 0.0)
    size = np.take_along_axis(scale, best[:, None], axis=1)[:, 0] * SHARES[best]
    return np.maximum(drop, 0.0), np.where(drop > 0.0, size, 0.0)


def _innovations(series: Array, fades: Array) -> tuple[Array, Array]:
    """Sums (paces, shares, channels) of squared innovations over their variance, and of its
    logarithm, where the whole variance is 1."""
    shape = (len(fades), len(SHARES), series.shape[1])
    share = np.broadcast_to(SHARES[None, :, None], shape)
    fade = np.broadcast_to(fades[:, None, None], shape)
    mean, doubt = np.zeros(shape), share.copy()
    squares, logarithms = np.zeros(shape), np.zeros(shape)
    for value in series:
        known = np.isfinite(value)
        variance = doubt + 1.0 - share
        innovation = np.where(known, value, 0.0) - mean
        squares += known * innovation**2 / variance
        logarithms += known * np.log(variance)
        gain = known * doubt / variance
        mean = fade * (mean + gain * innovation)
        doubt = fade**2 * doubt * (1.0 - gain) + (1.0 - fade**2) * share
    return squares, logarithms


def spread_of(variance: float | Array, step_s: float, pace_s: float) -> Array:
    """Standard deviation of a first-order process whose means over ``step_s`` have this variance
    of their own (``drift_of``): neighbours share the integral of what fades between them."""
    ratio = pace_s / step_s
    shared = (ratio * (1.0 - math.exp(-1.0 / ratio))) ** 2
    return np.sqrt(variance * math.exp(-1.0 / ratio) / shared)
