"""The noise floor of each channel: what a predictor without any physics of its own leaves.

A perfect model still errs by the sensors' noise and by the torques and pushes that nobody
measured. That much is found without a perfect model: the base model's one-step errors are
regressed on every generic signal (``floor_signals``) that clearly shows in them, weighted by the
inverse noise spectrum; what is left is summed up to 20 and 50 ms; and what fading memories of the
rows up to the start foretell of that is taken off (a model's observer does the same to noise).

One step at a time, because in closed loop the inputs answer to the disturbances within 50 ms: a
direct regression at that horizon would take the controller's answer for the cause and come out
too low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.gap import (
    ACCELEROMETER,
    ATTITUDE,
    GYRO,
    AheadErrors,
    Motion,
    pooled_rms,
)
from groundstation.dynamics.rotations import euler_rates
from groundstation.dynamics.simulation import armature_mv
from groundstation.dynamics.vehicle import MIXERS, Configuration
from groundstation.identification.flight import LEAK_S, velocity_of
from groundstation.identification.runs import Run
from groundstation.prediction.drive import fresh_rows
from groundstation.telemetry.arrays import Array

# The noise model of a prediction-error fit: autoregressive, estimated from what is left over.
#
# e = A(q) v with white e: filtering data and regressors by A turns correlated errors v into
# one-step prediction errors (thesis eq. 7.3-7.6 with H = 1/A). In closed loop this is what keeps
# an estimate free of the noise that the controller feeds back.


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


# Generic signals of a flight: what a predictor that knows no physics of the craft may look at.
#
# Rotor squares and their past, rotor speeds and slopes, rates and their products, leaky velocity,
# tilt, closeness to the ground. Nothing here knows the named effects or their parameters. No signal
# holds anything measured in the present row or later: that would know the noise it is to predict.


LAGS = (1, 2, 3, 4, 6, 8, 12, 18, 26)
"""Rows by which inputs may act later than the base model has it."""
PAST_ROWS = 4
PULL_S = 0.1
MOTOR_S = 0.05
"""A small motor with its propeller settles within about this time."""
GROUND_S = 0.4


Kind = Literal["torque", "force", "attitude"]
"""What one-step errors are of."""


def signals_of(run: Run, motion: Motion, configuration: Configuration, kind: Kind) -> Array:
    """Candidates (n, p) for the one-step errors of a kind."""
    period = run.period_s

    def mixed(values: Array) -> Array:
        """Roll, pitch, yaw and collective part of one value per rotor."""
        return np.hstack([values @ MIXERS[configuration].T, values.sum(axis=1, keepdims=True)])

    own = mixed(motion.squares.end if kind == "force" else motion.squares.square)
    own = own[:, :3] if kind == "attitude" else own
    signals = [_late(own, lag) for lag in (0, *LAGS)]
    if kind != "attitude":  # fading closeness to take-off and landing
        ends = (np.clip(away, 0.0, None) for away in (motion.since_start_s, motion.before_end_s))
        signals += [own * np.exp(-away / GROUND_S)[:, None] for away in ends]
    speed = np.sqrt(motion.squares.end)
    slope = _change(speed, period)
    slowing = np.minimum(slope, 0.0)
    signals += [mixed(one) for one in (speed, slope, slowing)]
    # What slowed down: a brake, whose torque fades as the motor settles.
    signals.append(mixed(speed * _leaky(slowing, MOTOR_S, period)))
    # The mean over the recording makes it a deviation; the voltage itself is the battery's word.
    charge = (run.supply_v - np.mean(run.supply_v))[:, None]
    signals += [mixed(motion.squares.end * charge), mixed(armature_mv(run.duty, run.supply_v))]
    past = _past_mean(run.gyro)
    p, q, r = past.T
    signals += [past, past * np.abs(past), np.column_stack([p * q, q * r, p * r]), past**2]
    # Momentum of the rotors, which a rate turns and its change answers to.
    spin = motion.spin[:, None]
    signals += [spin * past[:, :2], _change(spin, period), np.ones((len(run), 1))]
    pull = np.nan_to_num(run.accelerometer[:, :2])
    signals.append(_late(np.sin(np.nan_to_num(run.attitude[:, :2])), 4))
    signals.append(_late(_leaky(pull, PULL_S, period) / PULL_S, 1))
    # A second leak beside the usual one: together they bend to the craft's own speed.
    signals.append(_late(velocity_of(run, LEAK_S), 1))
    velocity = _late(motion.velocity, 1)
    return np.hstack([*signals, velocity, velocity * np.abs(velocity)])


def _late(values: Array, rows: int) -> Array:
    """Values of so many rows before, the first one held."""
    return np.vstack([np.repeat(values[:1], rows, axis=0), values[: len(values) - rows]])


def _leaky(values: Array, fade_s: float, period_s: float) -> Array:
    """Leaky integral over time."""
    from scipy.signal import lfilter

    keep = float(np.exp(-period_s / fade_s))
    return lfilter([period_s], [1.0, -keep], values, axis=0)


def _change(values: Array, period_s: float) -> Array:
    """Slope over the period that ends with the row."""
    return np.diff(values, axis=0, prepend=values[:1]) / period_s


def _past_mean(values: Array) -> Array:
    """Mean of the ``PAST_ROWS`` rows before each row."""
    total = np.cumsum(np.vstack([np.repeat(values[:1], PAST_ROWS + 1, axis=0), values]), axis=0)
    count = len(values)
    return (total[PAST_ROWS : PAST_ROWS + count] - total[:count]) / PAST_ROWS


# Which generic signals clearly show in a channel's one-step errors, and how strongly.


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


SOURCE = (
    "black-box predictor on the same rows: generic signals that clearly show in the one-step"
    " errors, and what fading memories of the past errors foretell, summed to 20 and 50 ms"
)
MEMORY_S = (0.008, 0.06, 0.3, 1.5)
"""Fading times of the memories. They can filter noise and follow what acts slowly, as a model's
observer can; they cannot foretell vibration, which is noise to any model of rigid flight."""
SLOW = 1
"""The accelerometer starts nothing, so only what acts longer than the first memory counts."""
SMOOTH_S = 0.0033
"""Standard deviation of the kernel that what the signals explain is smoothed by: 40 Hz."""
WHITEN_ORDER = 40
WORTH = 0.985
"""The past is used where it leaves at most this share of the error."""
LEAST_ROWS = 200
KINDS: tuple[Kind, ...] = ("torque", "force", "attitude")


@dataclass(frozen=True, slots=True)
class BlackBox:
    """What was learnt.

    channels: None where the recordings lack it; fitted: the same with the signals that do not help
    at the horizons, learnt on ``runs``. past: for each of ``HORIZONS_S``, (9, m) weights
    of the channel's memories and of its rate's; zero where it does not pay. whiteners: of the
    shortest horizon's errors, per channel, for spectra.
    """

    channels: tuple[ChannelPredictor | None, ...]
    fitted: tuple[ChannelPredictor | None, ...]
    runs: tuple[Run, ...]
    past: tuple[Array, ...]
    whiteners: tuple[Array, ...]


Shares = dict[int, tuple[ChannelPredictor, Array]]
"""By channel, a predictor and what it explains of a run's one-step errors (n,)."""


@dataclass(frozen=True, slots=True)
class Floor:
    """What noise leaves of a run, SI, (n, 9) each.

    horizons: as ``AheadErrors`` has them. step: of the shortest one, whitened by an
    autoregression: as large as a perfect observer's errors would be, which are white. shares: what
    signals explain of it, at any horizon.
    """

    horizons: tuple[Array, ...]
    step: Array
    shares: Shares


@dataclass(frozen=True, slots=True)
class Prepared:
    """One run: one-step errors (n, 9), the craft's layout, and stretches in the air; what signals
    explain, as far as it was asked."""

    errors: AheadErrors
    step: Array
    configuration: Configuration
    stretches: tuple[slice, ...]
    shares: Shares

    def signals(self, kind: Kind) -> Array:
        """Candidates for errors of a kind: made when they are asked for, since those of a minute
        of flight are 20 MB."""
        return signals_of(self.errors.run, self.errors.motion, self.configuration, kind)


def prepare(
    errors: AheadErrors, configuration: Configuration, known: Floor | None = None
) -> Prepared:
    """errors: of any base model on the run; its rows, its motion and its body are used. known: a
    floor of the same one-step errors."""
    flown = np.concatenate([[0], errors.motion.flown.astype(np.int8), [0]])
    edges = np.flatnonzero(np.diff(flown)).reshape(-1, 2)
    stretches = tuple(
        slice(int(first) + 2, int(last)) for first, last in edges if last - first > LEAST_ROWS
    )
    shares = {} if known is None else dict(known.shares)
    return Prepared(errors, _one_step(errors), configuration, stretches, shares)


def learn(prepared: Sequence[Prepared], known: BlackBox | None = None) -> BlackBox:
    """Fit the black box on runs. known: one with other horizons; where it was learnt on the same
    runs, its signals are those that show in these."""
    runs = tuple(one.errors.run for one in prepared)
    same = known is not None and len(known.runs) == len(runs)
    if known is not None and same and all(a is b for a, b in zip(known.runs, runs, strict=True)):
        found = list(known.fitted)
    else:
        found = [one for first in (0, 3, 6) for one in _fitted(prepared, first)]
    shares = [_shares(one, found) for one in prepared]
    plain = [_unexplained(one, found, np.zeros_like(one.step)) for one in prepared]
    left = [_unexplained(one, found, share) for one, share in zip(prepared, shares, strict=True)]
    # Never more than it knows without: signals that do not help at the horizons are left out.
    worse = _pooled(left) > _pooled(plain)
    nothing = ChannelPredictor(np.zeros(0, np.int64), np.zeros(0))
    channels = tuple(nothing if out else one for out, one in zip(worse, found, strict=True))
    if worse.any():
        useful = [np.where(worse, 0.0, share) for share in shares]
        left = [_unexplained(one, found, own) for one, own in zip(prepared, useful, strict=True)]
    whiteners = []
    for channel in range(9):
        series = [
            one.totals[0][rows, channel]
            for one, made in zip(left, prepared, strict=True)
            for rows in _rows(made, channel)
        ]
        told = [part[np.isfinite(part)] for part in series]
        whiteners.append(estimate_noise(told, WHITEN_ORDER).whitener if told else np.ones(1))
    past = _learn_past(prepared, left)
    return BlackBox(channels, tuple(found), runs, past, tuple(whiteners))


def _fitted(prepared: Sequence[Prepared], first: int) -> Sequence[ChannelPredictor | None]:
    """Predictors of three channels, and what they explain, for ``Prepared.shares``."""
    signals = [one.signals(KINDS[first // 3]) for one in prepared]
    pieces = [
        (_taken(own, rows), one.step[rows, first : first + 3])
        for one, own in zip(prepared, signals, strict=True)
        for rows in _rows(one, first)
    ]
    fitted = fit_signals(pieces) if pieces else [None] * 3
    for one, own in zip(prepared, signals, strict=True):
        _explain(one, first, fitted, own)
    return fitted


def floor_errors(black_box: BlackBox, prepared: Prepared) -> Floor:
    """What the black box leaves of a run, in the rows of its errors."""
    share = _shares(prepared, black_box.channels)
    left = _unexplained(prepared, black_box.channels, share)
    memories = _memories(left.step, prepared.errors.run.period_s)
    horizons = []
    for counts, total, weights in zip(
        prepared.errors.rows, left.totals[1:], black_box.past, strict=True
    ):
        foretold = np.zeros_like(total)
        for channel in range(9):
            if weights[channel].any():
                known = _remembered(memories, channel) @ weights[channel]
                count = int(counts[channel])
                foretold[count:, channel] = known[:-count]
        horizons.append(total - foretold)
    step = np.full_like(left.step, np.nan)
    for channel, whitener in enumerate(black_box.whiteners):
        for rows in _rows(prepared, channel):
            series = np.nan_to_num(left.totals[0][rows, channel])
            step[rows, channel] = _weighted(series[:, None], whitener)[:, 0]
    step[~np.isfinite(left.totals[0])] = np.nan
    return Floor(tuple(horizons), step, prepared.shares)


def _one_step(errors: AheadErrors) -> Array:
    """What one row adds beyond the base model: (n, 9), NaN outside flight.

    Rates: the gyro's step less the modelled torque's. Specific force: less thrust. Angles: the
    step from one fresh row to the next less what the measured rates make of it.
    """
    run, motion = errors.run, errors.motion
    step = np.full((len(run), 9), np.nan)
    step[1:, GYRO] = np.diff(run.gyro, axis=0) - motion.torque[1:] * run.period_s
    step[:, ACCELEROMETER] = run.accelerometer
    step[:, 5] -= motion.thrust
    every = int(errors.step_rows[6])
    weights = np.ones(every + 1)
    weights[[0, -1]] = 0.5
    middle = 0.5 * (run.attitude[every:] + run.attitude[:-every])
    turned = _weighted(run.gyro, weights)[every:] * run.period_s
    step[every:, ATTITUDE] = run.attitude[every:] - run.attitude[:-every] - _turn(middle, turned)
    step[~motion.flown] = np.nan
    if every > 1:
        step[~fresh_rows(run.attitude), ATTITUDE] = np.nan
    return step


def _rows(one: Prepared, channel: int) -> list[NDArray[np.int64]]:
    """Rows of each stretch in which the channel's one-step error is known."""
    found = []
    for stretch in one.stretches:
        rows = np.arange(stretch.start, stretch.stop)
        known = rows[np.isfinite(one.step[stretch, channel])]
        if len(known) > LEAST_ROWS:
            found.append(known)
    return found


def _taken(values: Array, rows: NDArray[np.int64]) -> Array:
    """These rows, ascending; a view where none between them is left out."""
    first, last = int(rows[0]), int(rows[-1])
    return values[first : last + 1] if last - first + 1 == len(rows) else values[rows]


@dataclass(frozen=True, slots=True)
class _Unexplained:
    """step: (n, 9) one-step errors less the signals' share, 0 where unknown. totals: what they
    add up to at the shortest horizon and at each of ``HORIZONS_S``, (n, 9), NaN as in the
    errors."""

    step: Array
    totals: tuple[Array, ...]


def _unexplained(
    one: Prepared, channels: Sequence[ChannelPredictor | None], share: Array
) -> _Unexplained:
    """share: (n, 9), what signals explain."""
    errors, period = one.errors, one.errors.run.period_s
    step = np.zeros_like(one.step)
    for channel, predictor in enumerate(channels):
        if predictor is None:
            continue
        for known in _rows(one, channel):
            step[known, channel] = one.step[known, channel] - share[known, channel]
    totals, rows = [], (errors.step_rows, *errors.rows)
    for counts, error in zip(rows, (errors.step, *errors.horizons), strict=True):
        total = step.copy()  # specific force is judged at the end only: nothing adds up
        for part in (GYRO, ATTITUDE):
            total[:, part] = _weighted(step[:, part], np.ones(int(counts[part][0])))
        # A rate error of each row, the last one first, lasts to the end, by the trapezoidal rule.
        turned = _weighted(step[:, GYRO], np.arange(int(counts[6]), dtype=np.float64) + 0.5)
        total[:, ATTITUDE] += _turn(errors.run.attitude, turned * period)
        total[~np.isfinite(error)] = np.nan
        totals.append(total)
    return _Unexplained(step, tuple(totals))


def _shares(one: Prepared, predictors: Sequence[ChannelPredictor | None]) -> Array:
    """What predictors of every channel explain of the one-step errors, (n, 9)."""
    found = np.zeros_like(one.step)
    for first in (0, 3, 6):
        own = predictors[first : first + 3]
        _explain(one, first, own)
        for channel, predictor in enumerate(own, first):
            if predictor is not None and len(predictor.columns):
                found[:, channel] = one.shares[channel][1]
    return found


def _explain(
    one: Prepared,
    first: int,
    predictors: Sequence[ChannelPredictor | None],
    signals: Array | None = None,
) -> None:
    """What signals explain of the one-step errors of three channels, from ``first`` on, without
    vibration, into ``shares``; signals: those of the three, where they are at hand.

    Through the controller the inputs hold the vibration of the rows before, and noise-free sums
    of them foretell the next row's. Smoothed on all rows, before an attitude of every second row
    could fold it to low frequency.
    """
    from scipy.ndimage import gaussian_filter1d

    sigma = SMOOTH_S / one.errors.run.period_s
    for channel, predictor in enumerate(predictors, first):
        if predictor is None or not len(predictor.columns):
            continue
        if channel in one.shares and one.shares[channel][0] is predictor:
            continue
        if signals is None:
            signals = one.signals(KINDS[first // 3])
        share = np.zeros(len(one.step))
        for stretch in one.stretches:
            explained = signals[stretch, predictor.columns] @ predictor.weights
            share[stretch] = gaussian_filter1d(explained, sigma, mode="nearest")
        one.shares[channel] = predictor, share


def _learn_past(prepared: Sequence[Prepared], left: Sequence[_Unexplained]) -> tuple[Array, ...]:
    """Weights of the memories, by least squares at each horizon.

    Memories end where the prediction starts, so that nothing in them answers to what follows.
    """
    memories = [
        _memories(one.step, made.errors.run.period_s)
        for one, made in zip(left, prepared, strict=True)
    ]
    found = []
    for number, counts in enumerate(prepared[0].errors.rows, 1):
        weights = np.zeros((9, 2 * len(MEMORY_S)))
        for channel in range(9):
            count = int(counts[channel])
            parts, targets = [], []
            for one, memory in zip(left, memories, strict=True):
                target = one.totals[number][count:, channel]
                known = np.isfinite(target)
                parts.append(_remembered(memory, channel)[:-count][known])
                targets.append(target[known])
            past, target = np.vstack(parts), np.concatenate(targets)
            scale = np.sqrt(np.mean(past**2, axis=0)) if len(past) else np.zeros(0)
            used = np.flatnonzero(scale > 0)
            if len(target) < LEAST_ROWS or not len(used):
                continue
            normal = (past[:, used] / scale[used]).T @ (past[:, used] / scale[used])
            score = (past[:, used] / scale[used]).T @ target
            fitted = np.linalg.pinv(normal, rcond=1e-10, hermitian=True) @ score
            if 1.0 - float(score @ fitted) / float(target @ target) <= WORTH**2:
                weights[channel, used] = fitted / scale[used]
        found.append(weights)
    return tuple(found)


def _memories(step: Array, period_s: float) -> Array:
    """Fading sums of the past one-step errors, (n, 9, m), the row itself included."""
    from scipy.signal import lfilter

    fading = [np.exp(-period_s / memory) for memory in MEMORY_S]
    return np.stack([lfilter([1.0], [1.0, -keep], step, axis=0) for keep in fading], axis=2)


def _remembered(memories: Array, channel: int) -> Array:
    """The memories (n, 2 m) that a channel may use: its own, and an angle its rate's."""
    own = memories[:, channel].copy()
    rate = memories[:, channel - 6] if channel >= 6 else np.zeros_like(own)
    if channel in (3, 4, 5):
        own[:, :SLOW] = 0.0
    return np.hstack([own, rate])


def _weighted(values: Array, weights: Array) -> Array:
    """Row k: sum over j of ``weights[j] values[k - j]``; values (n, m)."""
    from scipy.signal import lfilter

    return lfilter(weights, [1.0], values, axis=0)


def _turn(attitude: Array, turned: Array) -> Array:
    """Small body rotations (n, 3) at attitudes (n, 3) as changes of roll, pitch, yaw."""
    return euler_rates(np.nan_to_num(attitude), turned)


def _pooled(left: Sequence[_Unexplained]) -> Array:
    """RMS (9,) over runs and the judged horizons; NaN for a channel without a row."""
    return pooled_rms([error for one in left for error in one.totals[1:]])
