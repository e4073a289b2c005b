"""What is looked for apart from the search: slow disturbances, and propellers out of balance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import CHANNELS, FURTHER_EVERY_S, AheadErrors
from groundstation.discrepancy.acceptance import (
    LEAST_DROP,
    LEAST_SURE,
    SHAKEN,
    Shaken,
    is_significant,
    refusal,
)
from groundstation.discrepancy.proof import UNPROVEN, Candidate, EffectFound, Findings, Verdict
from groundstation.dynamics.effect import FAR_M, FORCE, GYRO, SPIN, Body, Craft, Role, power_passed
from groundstation.dynamics.model import Disturbance, EffectTerm, Estimate, Model, model_vehicle
from groundstation.dynamics.registry import DISTURBANCE, EFFECTS
from groundstation.identification.estimate import bounded_step
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.motion import Point, spin_rotors, trim_of
from groundstation.identification.likelihood.problem import ON_BOARD, Problem
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

# How likely a series is a first-order process beside white noise, and how large that then is.
#
# Every lag counts: of a flight of ten seconds, whose half seconds are twenty numbers, neighbours
# alone tell at most 4.5 standard errors, however plainly it drifts.


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


# What pushes and turns a craft slowly and belongs to no flight condition: the disturbance.
#
# No column shows it, for it has no law but its spread and its pace. What is left of predictions
# is averaged over half seconds: noise is forgotten from one to the next, and what acts slowly is
# not. The likelihood of these means gives the spread, and how well fitted rows are predicted the
# pace. Two flights in which nothing of it shows do not say that the third has none: batteries are
# pushed in anew, and one pushes more than another. So moments are never held to be smaller than
# the trims of flights in general (``trim_of``), nor the force along z than what batteries differ
# by.


BLOCK_S = 0.5
"""Ten times the horizon, which neighbours share at their edges; a circle takes five seconds."""
PACES_S = (0.3, 1.0, 3.0, 10.0, 30.0)
"""How fast it may change: more slowly than a craft is steered, and told by a flight of a minute."""
LEAST_BLOCKS = 20
"""Means that tell anything."""
LIFT_SHARE = 0.03
"""Of its weight, what a craft's thrust differs by from flight to flight at one PWM and voltage:
flights of one craft tell thrusts per mass up to 5 % apart."""
FAINTEST = 1e-300
"""A chance that a double still holds; it is one of 37 standard errors."""


@dataclass(frozen=True, slots=True)
class Slow:
    """spread (6,): standard deviation of moments (rad/s^2) and forces (m/s^2) along x, y, z, 0
    where nothing lasts. time_s: the pace of all. t: ``standard_errors`` of the six, where one at
    least lasts; drop: of -2 log L where each has its likeliest pace. seconds: so much was flown.
    variances (paces, 6): of the means of half seconds, by ``PACES_S``. usual: (6,) spreads of
    flights in general, below which these flights, or others, did not tell one."""

    spread: Array
    time_s: float
    t: float
    drop: float
    seconds: float
    variances: Array
    usual: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(6, np.bool_))

    def at(self, time_s: float) -> Slow:
        """The spreads with which a first-order process of this pace has such means."""
        variance = self.variances[PACES_S.index(time_s)]
        return replace(self, time_s=time_s, spread=spread_of(variance, BLOCK_S, time_s))

    def with_trims(self, least: Array) -> Slow:
        """Spreads at least as large as these (6,)."""
        return replace(self, spread=np.maximum(self.spread, least), usual=self.spread < least)

    @property
    def parameters(self) -> dict[str, Estimate]:
        """With the standard errors of a first-order process that was watched for so long, none
        where no flight told the spread; the pace is known to a step of ``PACES_S``."""
        error = math.sqrt(self.time_s / max(2.0 * self.seconds, self.time_s))
        told = (self.spread > 0.0) & ~self.usual
        found = {
            one.name: Estimate(spread, error * spread if known else None, one.unit)
            for one, spread, known in zip(
                DISTURBANCE.sizes, self.spread.tolist(), told.tolist(), strict=True
            )
        }
        (pace,) = (one for one in DISTURBANCE.parameters if one.kind == "shape")
        return {
            **found,
            pace.name: Estimate(self.time_s, max(2.0 * error, 0.5) * self.time_s, pace.unit),
        }

    @property
    def is_there(self) -> bool:
        """Whether white noise hardly explains the means as well."""
        return is_significant(self.t, self.drop)


def with_disturbance(model: Model, fitted: Comparison) -> Model:
    """A model with the slow forces and moments that it leaves in fitted samples, none where white
    noise explains these as well. fitted: the model on them."""
    slow = slow_part(fitted.errors)
    if not slow.is_there:
        return model
    trims = np.array([*trim_of(model_vehicle(model)), 0.0, 0.0, LIFT_SHARE * STANDARD_GRAVITY])
    return with_term(model, best_followed(slow, fitted).with_trims(trims))


def best_followed(slow: Slow, fitted: Comparison) -> Slow:
    """At the pace with which fitted rows are predicted best, with the spreads only of those
    channels that are: beside what is fast and has no name, following what is slow can mislead."""
    told = np.isfinite(fitted.rms)
    before = _squares(_coarsely(fitted, fitted.model), told)
    found = []
    for time_s in PACES_S:
        one = slow.at(time_s)
        gained = before - _squares(_coarsely(fitted, with_term(fitted.model, one)), told)
        kept = replace(one, spread=np.where(gained > 0.0, one.spread, 0.0))
        found.append((float(gained[gained > 0.0].sum()), kept))
    return max(found, key=lambda each: each[0])[1]


def _coarsely(fitted: Comparison, model: Model) -> Array:
    """Gaps (9,) of a model on fitted rows, from few of them: it is asked of many models."""
    return fitted.with_model(model, FURTHER_EVERY_S).rms / fitted.noise_floor


def _squares(gaps: Array, told: NDArray[np.bool_]) -> Array:
    """Of the channels (9,) that a moment or a force on each axis moves, (6,); infinite where a
    channel that can be told is predicted no number."""
    known = np.where(np.isfinite(gaps), gaps, np.inf)
    squares = np.where(told, known, 0.0) ** 2
    return np.concatenate([squares[:3] + squares[6:], squares[3:6]])


def slow_part(errors: Sequence[AheadErrors]) -> Slow:
    """What lasts in the errors of predictions at the longest horizon.

    The rate that a craft has gained by then is a moment times the horizon. A channel which white
    noise explains as well has none.
    """
    flights = [_means(one) for one in errors]
    seconds = BLOCK_S * float(sum(len(means) for means in flights))
    count = sum(np.isfinite(means).sum(axis=0) for means in flights)
    drops, variances = drift_of(flights, BLOCK_S, PACES_S)
    likeliest = np.where(count >= LEAST_BLOCKS, drops.max(axis=0), 0.0)
    lasting = likeliest >= LEAST_SURE**2  # all six are asked at once, and need more
    found = Slow(
        spread=np.zeros(6),
        time_s=PACES_S[0],
        t=standard_errors(likeliest) if lasting.any() else math.sqrt(likeliest.max()),
        drop=float(likeliest.sum()) if lasting.any() else 0.0,
        seconds=seconds,
        variances=np.where(lasting, variances, 0.0),
    )
    return found.at(PACES_S[int(drops[:, lasting].sum(axis=1).argmax())])


def standard_errors(drops: Array) -> float:
    """Of a normal deviate that chance makes as seldom as the largest drop of -2 log L by one
    variance, or as all six (6,) together where that is seldomer: what pushes a craft is seldom in
    one channel alone."""
    from scipy.special import ndtri

    half = 0.5 * float(drops.sum())
    chance = math.exp(-half) * (1.0 + half + 0.5 * half**2)  # of chi^2, six degrees of freedom
    return max(math.sqrt(drops.max()), float(-ndtri(max(0.5 * chance, FAINTEST))))


def _means(one: AheadErrors) -> Array:
    """Moments and forces that are missing, (blocks, 6), averaged over each block; NaN where less
    than half of it was judged."""
    period, last = one.run.period_s, one.horizons[-1][:, :6]
    missing = last / np.concatenate([one.rows[-1][:3] * period, np.ones(3)])
    size = max(round(BLOCK_S / period), 1)
    blocks = missing[: len(missing) // size * size].reshape(-1, size, 6)
    known = np.isfinite(blocks)
    count = known.sum(axis=1)
    sums = np.where(known, blocks, 0.0).sum(axis=1)
    return np.where(count * 2 >= size, sums / np.maximum(count, 1), np.nan)


def with_term(model: Model, slow: Slow) -> Model:
    """A model whose observer follows what is slow."""
    if not slow.spread.any():
        return model
    x, y, z, u, v, w = slow.spread.tolist()
    return msgspec.structs.replace(
        model, disturbance=Disturbance((x, y, z), (u, v, w), slow.time_s)
    )


# How strongly each rotor shakes a craft: vibration that follows its speed, whatever its phase.
#
# Nobody knows the angle of a rotor for longer than some tenths of a second. In windows of that
# length it is left free: the expected power of a window's spectrum is that of noise and, with the
# squared size of each rotor's imbalance as the unknown, that of a line which turns as the rotor
# did, sampled as the craft was and so folded by itself. Noise is any spectrum times any level of
# each window; what stands still in frequency, or rises with everything else, is no rotor's.


IMBALANCE = next(effect for effect in EFFECTS.values() if effect.role is Role.UNPHASED)
SIZES = tuple(one.name for one in IMBALANCE.sizes)
WINDOW_S = 0.2
"""A rotor whose speed is off by 1 rev/s has lost a fifth of a turn by then."""
SCORE_BLOCK_S = 1.0
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
    block = np.asarray((starts - starts[0]) * period // SCORE_BLOCK_S, np.int64)
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


# Which propeller is out of balance: ``propeller_imbalance``.
#
# No column shows it, for nobody knows the angle of a rotor: it is told by its power,
# changes no prediction, and closes no gap, since vibration counts as noise.
# Every propeller shakes a little; named is a rotor that shakes more than the three others
# together.


def with_imbalance(findings: Findings, problem: Problem, point: Point) -> Findings:
    """The findings, with ``propeller_imbalance`` as the last effect, beside which all others stay
    as they are, where one rotor shakes the craft. point: where the search ended, which says how
    fast rotors turned."""
    if any(term.name == IMBALANCE.name for term in findings.model.effects):
        return findings
    fitted = _windows(problem.flights, problem, point, findings.base)
    if not fitted:
        return findings
    asked = shaken_most(fitted)
    why = refusal(SHAKEN, asked)
    candidate = Candidate(IMBALANCE.name, asked.drop, asked.t, 0.0, True)
    if why is not None:
        candidate = candidate.refused(why)
    found = replace(findings, candidates=(*findings.candidates, candidate))
    if why is not None:
        return found
    term = EffectTerm(IMBALANCE.name, dict(asked.parameters))
    model = msgspec.structs.replace(findings.model, effects=(*findings.model.effects, term))
    effect = EffectFound(
        name=IMBALANCE.name,
        order=len(findings.effects) + 1,
        adds=IMBALANCE.adds,
        parameters=term.parameters,
        evidence={"likelihood_ratio": asked.drop, "t": asked.t, "over_others": asked.alone},
        alternatives=(),
        gap=UNPROVEN,
        channels=tuple(CHANNELS[channel] for channel in asked.channels),
    )
    return replace(
        found,
        verdict=Verdict.EFFECTS_FOUND,
        effects=(*findings.effects, effect),
        models=(*findings.models, model),
        model=model,
    )


def shaken_most(fitted: Sequence[Windows]) -> Shaken:
    """The rotor that surely shakes the craft most, and what its gates are asked of."""
    shares = shares_of(fitted, LEAST_DROP)
    shaking = shaking_of(fitted, shares)
    kind, rotor = max(np.ndindex(len(SIZES), 4), key=lambda at: shaking.t(*at))
    alone = 0.0
    if shaking.t(kind, rotor) > 0.0:
        alone = shaking.over_others(kind, rotor, most_of(fitted, shares))
    square = float(shaking.squares[kind, rotor])
    slope, curvature = shaking.beside_others(kind, rotor)
    sizes = (shaking_of([one], shares).size(kind, rotor) for one in fitted)
    return Shaken(
        effect=IMBALANCE,
        parameters=_parameters(shaking, rotor),
        t=shaking.t(kind, rotor),
        drop=slope**2 / curvature if curvature > 0.0 else 0.0,
        alone=alone,
        recordings=_apart(np.array(list(sizes)), math.sqrt(square)),
        channels=tuple(np.flatnonzero(fitted[0].per_size[0, :, :, rotor].any(axis=0)).tolist()),
    )


def _windows(
    flights: Sequence[Flight], problem: Problem, point: Point, model: Model
) -> list[Windows]:
    frame = problem.frame
    craft, corners = frame.craft(point), _corners_hz(model)
    found = (windows_of(one, spin_rotors(one, point, frame).end, craft, corners) for one in flights)
    return [one for one in found if one is not None]


def _corners_hz(model: Model) -> tuple[float, float]:
    """Of the filters behind gyro and accelerometer: the model's, or else the vehicle's."""
    given = {term.name: term for term in model.effects}
    corners = []
    for channels in (GYRO, FORCE):
        (effect,) = (one for one in ON_BOARD.values() if one.channels == channels)
        (size,) = effect.sizes
        if effect.name in given:
            corners.append(given[effect.name].parameters[size.name].value)
        else:
            corners.append(float(getattr(model_vehicle(model), effect.on_board)))
    gyro, force = corners
    return gyro, force


def _parameters(shaking: Shaking, rotor: int) -> dict[str, Estimate]:
    found = {"rotor": Estimate(rotor + 1.0)}
    for kind, one in enumerate(IMBALANCE.sizes):
        found[one.name] = Estimate(*shaking.size(kind, rotor), one.unit)
    return found


def _apart(sizes: Array, whole: float) -> tuple[float, float]:
    """Standard errors, and share of the whole, by which one flight's size (n, 2), with its error,
    is away from all flights'."""
    away = np.abs(sizes[:, 0] - whole)
    worst = int(np.argmax(away / sizes[:, 1]))
    return float(away[worst] / sizes[worst, 1]), float(away[worst] / max(whole, 1e-300))
