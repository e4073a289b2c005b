"""How far the reported angles wander off the gyro's integral.

An estimator that knows positions (motion capture, a deck) corrects its angles by them: these then
turn, over tenths of a second, as no rate does, and what follows the gyro alone is left behind. The
size is read off a flight without a model: a filter that turns by the gyro and is corrected by the
angles is tried for several walks.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import body_rates
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import filled

Mask = NDArray[np.bool_]
Walk = tuple[float, float, float]

NONE: Walk = (0.0, 0.0, 0.0)
WALKS = (0.0, *(2.5e-4 * 2**k for k in range(9)))
"""rad in a second; from what adds to a gyro's own noise in still air to one at which nothing but
the newest angles counts."""
AHEAD_S = 0.02
WORTH = 0.9
"""A walk counts where the squared error ``AHEAD_S`` ahead falls below this share: it is no constant
that has to be known to a per cent."""
LEAST_ROWS = 200
LONGEST = 3
"""New angles so many times their usual distance apart: over a longer gap nobody knows the turn."""


def walk_of(
    attitude: Array, gyro: Array, used: Mask, period_s: float, *, angle: float, rate: float
) -> Walk:
    """About the body's axes, rad in a second (its square root for other times).

    attitude: (n, 3) rad, NaN where it is not new; gyro: (n, 3) rad/s. used: (n,) rows in the air.
    angle (rad) and rate (rad/s): white noise of a sample of either. A constant difference of rates
    is no walk: that is the gyro's bias.
    """
    rows = np.flatnonzero(used & np.isfinite(attitude).all(axis=1))
    if len(rows) < LEAST_ROWS:
        return NONE
    spacing = np.diff(rows)
    every = int(np.median(spacing))
    off = _off(attitude[rows], gyro, rows, period_s)
    told = np.isfinite(off).all(axis=1) & (spacing <= LONGEST * every)
    ahead = max(round(AHEAD_S / (every * period_s)), 1)
    judged = told[ahead:]
    if np.count_nonzero(judged) < LEAST_ROWS:
        return NONE
    places = np.cumsum(np.where(told[:, None], off - off[told].mean(axis=0), 0.0), axis=0)
    seconds = every * period_s
    own = rate**2 * period_s * seconds
    gains = [_gain(own + walk**2 * seconds, angle**2) for walk in WALKS]
    errors = np.array([_squared_error(places, gain, ahead, judged) for gain in gains])
    worth = errors.min(axis=0) < WORTH * errors[0]
    x, y, z = np.where(worth, np.array(WALKS)[errors.argmin(axis=0)], 0.0).tolist()
    return x, y, z


def _off(angles: Array, gyro: Array, rows: NDArray[np.int64], period_s: float) -> Array:
    """What the angles (m + 1, 3) turned from each of ``rows`` to the next less what the gyro did,
    (m, 3) rad about the body's axes."""
    turned = np.angle(np.exp(1j * np.diff(angles, axis=0)))
    rates = filled(gyro)
    steps = 0.5 * (rates[1:] + rates[:-1]) * period_s
    whole = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return body_rates(angles[:-1] + 0.5 * turned, turned) - np.diff(whole[rows], axis=0)


def _gain(process: float, measured: float) -> float:
    """Of a Kalman filter of a random walk, variances per row of the walk and of a measurement."""
    ratio = process / measured
    return 0.5 * (math.sqrt(ratio**2 + 4.0 * ratio) - ratio)


def _squared_error(places: Array, gain: float, ahead: int, judged: Mask) -> Array:
    """Mean squared error (3,) of a filter's estimate of places (m, 3) some rows ahead."""
    from scipy.signal import lfilter

    followed = lfilter([gain], [1.0, gain - 1.0], places, axis=0)
    error = places[ahead:] - followed[:-ahead]
    return (error[judged] ** 2).mean(axis=0)
