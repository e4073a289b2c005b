"""How strongly each rotor shakes a craft: vibration that follows its speed, whatever its phase.

Nobody knows the angle of a rotor for longer than some tenths of a second. In windows of that
length it is left free: the expected power of a window's spectrum is that of noise and, with the
squared size of each rotor's imbalance as the unknown, that of a line which turns as the rotor did,
sampled as the craft was and so folded by itself. Noise is any spectrum times any level of each
window; what stands still in frequency, or rises with everything else, is no rotor's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.effect import FAR_M, SPIN, Body, Craft, Role, power_passed
from groundstation.dynamics.registry import EFFECTS
from groundstation.identification.estimate import bounded_step
from groundstation.identification.flight import Flight
from groundstation.telemetry.arrays import Array

IMBALANCE = next(effect for effect in EFFECTS.values() if effect.role is Role.UNPHASED)
SIZES = tuple(one.name for one in IMBALANCE.sizes)
WINDOW_S = 0.2
"""A rotor whose speed is off by 1 rev/s has lost a fifth of a turn by then."""
BLOCK_S = 1.0
"""Scores of neighbouring windows share rows and manoeuvres; those of seconds do not."""
SLOWEST_HZ = 30.0
"""Below, the craft itself moves."""
LEAST_RATE_HZ = 120.0
"""Rows further apart show nothing but the craft's motion, whatever is folded into it."""
COMMON = np.linspace(-0.04, 0.04, 21)
NEAR = np.linspace(-0.01, 0.01, 9)
"""By which shares speeds may be off: all alike (a clock, a motor model), then each by itself."""
LEAST_WINDOWS, LEVEL_ROUNDS = 30, 5
LINES_KEPT = 8
"""Of four rotors, as they turn and as they are tried."""
LINE_BINS = 5
"""Width of a line behind Hann's taper."""
ROUNDED = 1e-20
"""Of a square, what a sine of pi leaves."""


@dataclass(frozen=True, slots=True)
class Windows:
    """A flight in windows. line: power (w, k) of a vibration of unit amplitude and any phase at the
    speed of a rotor that turned faster by a share; the latest are kept, for a rotor's share is
    tried beside the others as they were.
    power: (6, w, k) of gyro and accelerometer in the bins that are used, over that of noise, less
    what a bin has at all times and what a window has in all bins. weight: (6, w, k), one over the
    noise's power.
    per_size: (w, 2, 6, 4), what one squared unit of each size adds to a channel's power, over that
    of noise, spread over bins by the line. block: (w,)."""

    line: Callable[[int, float], Array]
    power: Array
    weight: Array
    per_size: Array
    block: NDArray[np.int64]
    measured: bool


@dataclass(frozen=True, slots=True)
class Shaking:
    """Squared sizes (2, 4) of each rotor's imbalance, their covariance (2, 4, 4) from blocks of
    time, and what a weighted fit saw of them: normal (2, 4, 4) and right (2, 4)."""

    squares: Array
    covariance: Array
    normal: Array
    right: Array

    def size(self, kind: int, rotor: int) -> tuple[float, float]:
        """A size and its standard error."""
        square = float(self.squares[kind, rotor])
        error = math.sqrt(float(self.covariance[kind, rotor, rotor]))
        if square <= error:
            return math.sqrt(max(square, 0.0)), math.sqrt(error)
        return math.sqrt(square), 0.5 * error / math.sqrt(square)

    def t(self, kind: int, rotor: int) -> float:
        """Standard errors by which a squared size is above zero."""
        error = math.sqrt(float(self.covariance[kind, rotor, rotor]))
        return float(self.squares[kind, rotor]) / max(error, 1e-300)

    def over_others(self, kind: int, rotor: int, most: Array) -> float:
        """Standard errors by which a rotor's square is above ``most`` (2, 4) of all the others
        together."""
        signs = np.where(np.arange(4) == rotor, 1.0, -1.0)
        error = math.sqrt(float(signs @ self.covariance[kind] @ signs))
        others = float(most[kind].sum() - most[kind, rotor])
        return (float(self.squares[kind, rotor]) - others) / max(error, 1e-300)

    def beside_others(self, kind: int, rotor: int) -> tuple[float, float]:
        """(slope, curvature) of -2 log L, halved, along one squared size, the others fitted."""
        others = [one for one in range(4) if one != rotor]
        cross = self.normal[kind][rotor, others]
        inner = np.linalg.pinv(self.normal[kind][np.ix_(others, others)])
        slope = self.right[kind, rotor] - cross @ inner @ self.right[kind, others]
        return float(slope), float(self.normal[kind, rotor, rotor] - cross @ inner @ cross)


def windows_of(
    flight: Flight, speed: Array, craft: Craft, corners: tuple[float, float]
) -> Windows | None:
    """A flight in windows; None where its rows are too slow or too few.

    speed: (n, 4) rev/s of all rows. corners: Hz, of the on-board filters behind gyro and
    accelerometer.
    """
    run, period = flight.run, flight.period_s
    rows = 2 * round(0.5 * WINDOW_S / period)
    starts = np.arange(flight.first, flight.last - rows + 1, rows // 2)
    at = starts[:, None] + np.arange(rows)
    starts, at = (part[flight.known[at].all(axis=1)] for part in (starts, at))
    if period * LEAST_RATE_HZ > 1.0 or len(at) < LEAST_WINDOWS:
        return None
    taper = np.hanning(rows + 2)[1:-1]
    taper /= math.sqrt(float(taper @ taper))
    bins = np.flatnonzero(np.fft.rfftfreq(rows, period) >= SLOWEST_HZ)
    felt = np.column_stack([run.gyro, run.accelerometer])[at]
    felt = (felt - felt.mean(axis=1, keepdims=True)) * taper[None, :, None]
    power = np.abs(np.fft.rfft(felt, axis=1))[:, bins] ** 2
    told = np.isfinite(power).all(axis=(0, 1)) & (power > 0.0).any(axis=(0, 1))
    noise = np.where(told, _noise(np.where(told, power, 1.0)), 1.0)
    steps = 0.5 * (speed[at[:, 1:]] + speed[at[:, :-1]]) * (2.0 * math.pi * period)
    turned = np.concatenate([np.zeros((len(at), 1, 4)), np.cumsum(steps, axis=1)], axis=1)
    per_size = _per_size(craft, speed[at].mean(axis=1), corners) * told[None, None, :, None]
    block = np.asarray((starts - starts[0]) * period // BLOCK_S, np.int64)
    weight = np.ascontiguousarray(np.moveaxis(1.0 / noise, 2, 0))
    power = _without_means(np.moveaxis(np.where(told, power, 0.0), 2, 0) * weight)
    line = lru_cache(LINES_KEPT)(partial(_line, turned, taper, bins))
    return Windows(line, power, weight, per_size, block, flight.rotor_measured)


def shares_of(flights: Sequence[Windows], worth: float) -> Array:
    """By which share (4,) the rotors turned faster than was thought: where most power is.

    worth: drop of -2 log L below which nothing is there that rotors could be told apart by.
    """

    def explained(shares: Array) -> float:
        normal, right = _summed(flights, shares)
        found = _solved(normal, right)
        return float((2.0 * found * right).sum() - np.einsum("pi,pij,pj->", found, normal, found))

    best = max((np.full(4, share) for share in COMMON.tolist()), key=explained)
    if explained(best) < worth:
        return best
    for rotor in range(4):
        best = max(_beside(flights, best, rotor), key=explained)
    return best


def _beside(flights: Sequence[Windows], shares: Array, rotor: int) -> list[Array]:
    """Shares of which one rotor's is another; where speeds were recorded, only a clock can be off,
    and none is."""
    if all(one.measured for one in flights):
        return [shares]
    return [np.where(np.arange(4) == rotor, shares + more, shares) for more in NEAR.tolist()]


def shaking_of(flights: Sequence[Windows], shares: Array) -> Shaking:
    """The rotors' imbalances, by weighted least squares on the spectra of all windows."""
    normal, right = _summed(flights, shares)
    squares = _solved(normal, right)
    spread = np.zeros_like(normal)
    for one in flights:
        scores = np.zeros((one.block[-1] + 1, *squares.shape))
        for kind, lines, power in _regressed(one, shares):
            left = power - np.tensordot(squares[kind], lines, 1)
            np.add.at(scores[:, kind], one.block, np.einsum("iwk,wk->wi", lines, left))
        spread += np.einsum("bpi,bpj->pij", scores, scores)
    inverse = np.linalg.pinv(normal)
    # One number for how much more than noise alone scores differ: of four lines that lie close,
    # each with its own, some would be known far too well.
    over = np.maximum(np.einsum("pij,pji->p", inverse, spread) / 4.0, 1.0)
    return Shaking(squares, over[:, None, None] * inverse, normal, right)


def most_of(flights: Sequence[Windows], shares: Array) -> Array:
    """The largest squares (2, 4) that each rotor could have, were its speed off a little more:
    lines that lie close are told apart less well than one of them is seen."""
    most = np.zeros((len(SIZES), 4))
    for rotor in range(4):
        near = _beside(flights, shares, rotor)
        found = [_solved(*_summed(flights, other))[:, rotor] for other in near]
        most[:, rotor] = np.max(found, axis=0)
    return most


def _solved(normal: Array, right: Array) -> Array:
    """Squares (2, 4): none is negative."""
    free, low, high = np.ones(4, np.bool_), np.zeros(4), np.full(4, np.inf)
    pairs = zip(normal, right, strict=True)
    return np.array([bounded_step(one, slope, free, low, high) for one, slope in pairs])


def _summed(flights: Sequence[Windows], shares: Array) -> tuple[Array, Array]:
    """Normal matrices (2, 4, 4) and right sides (2, 4) of both kinds of size."""
    normal, right = np.zeros((len(SIZES), 4, 4)), np.zeros((len(SIZES), 4))
    for one in flights:
        for kind, lines, power in _regressed(one, shares):
            flat = lines.reshape(4, -1)
            normal[kind] += flat @ flat.T
            right[kind] += flat @ power.ravel()
    return normal, right


def _regressed(one: Windows, shares: Array) -> list[tuple[int, Array, Array]]:
    """(kind of size, lines (4, w, k), power (w, k)) of each channel that shows that kind; what a
    bin has at all times and what a window has in all bins is taken out of both."""
    line = np.stack([one.line(rotor, share) for rotor, share in enumerate(shares.tolist())])
    found = []
    for kind, channel in zip(*np.nonzero(one.per_size.any(axis=(0, 3))), strict=True):
        lines = line * one.per_size[:, kind, channel].T[:, :, None] * one.weight[channel]
        found.append((int(kind), _without_means(lines), one.power[channel]))
    return found


def _line(turned: Array, taper: Array, bins: NDArray[np.intp], rotor: int, share: float) -> Array:
    """Power (w, k) in bins. turned: (w, rows, 4) angle of each rotor since the window began, rad.
    taper: (rows,)"""
    spin = np.exp(1j * (1.0 + share) * turned[:, :, rotor]) * taper
    up = np.fft.fft(spin, axis=1)
    down = up[:, -bins]
    return np.asarray(0.25 * (np.abs(up[:, bins]) ** 2 + np.abs(down) ** 2), np.float64)


def _without_means(values: Array) -> Array:
    """Values (..., w, k) less what a bin has at all times and what a window has in all bins."""
    values = values - values.mean(axis=-2, keepdims=True)
    values -= values.mean(axis=-1, keepdims=True)
    return values


def _noise(power: Array) -> Array:
    """Power (w, k, c) as a spectrum of the flight times a level of each window: that of the bins
    beyond a line's reach, for with its own in it every line would be told too small."""
    level = np.ones_like(power)
    count = power.shape[1] - _near_by(np.ones_like(power[:1]))
    for _ in range(LEVEL_ROUNDS):
        spectrum = (power / level).mean(axis=0, keepdims=True)
        own = power / spectrum
        level = np.maximum((own.sum(axis=1, keepdims=True) - _near_by(own)) / count, 1e-6)
    return np.asarray(spectrum * level, np.float64)


def _near_by(values: Array) -> Array:
    """Sums (w, k, c) over the bins that a line in bin k reaches."""
    from scipy.ndimage import uniform_filter1d

    return LINE_BINS * uniform_filter1d(values, LINE_BINS, axis=1, mode="constant")


def _per_size(craft: Craft, speed: Array, corners: tuple[float, float]) -> Array:
    """Squared amplitude (w, 2, 6, 4) of gyro (rad/s) and accelerometer (m/s^2) for a unit of each
    size at rotors of speed (w, 4) rev/s: from the law, at one turn a second and its square."""
    law: Callable[..., Any] = IMBALANCE.law
    still, pace = (0.0, 0.0, 0.0), 2.0 * math.pi * speed
    one, none = (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0)
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), still, still, one, none, 0.0, still, still)
    squares = np.zeros((len(SIZES), 6, 4))
    for kind in range(len(SIZES)):
        sizes = tuple(float(kind == other) for other in range(len(SIZES)))
        for rotor in range(len(SPIN)):
            for turns in (0.0, 0.25):
                turn, push, _ = law((rotor + 1.0, *sizes), craft, body, (turns, 1.0))
                squares[kind, :, rotor] += np.square([*turn, *push])
    squares[squares < ROUNDED * squares.max()] = 0.0
    found = squares[None] * speed[:, None, None, :] ** 4
    found[:, :, :3] *= (power_passed(speed, corners[0]) / pace**2)[:, None, None, :]
    found[:, :, 3:] *= power_passed(speed, corners[1])[:, None, None, :]
    return found
