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
from groundstation.telemetry.arrays import AXES, Array

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
GROUND_S = (0.4,)
MIXED = (*AXES, "collective")


@dataclass(frozen=True, slots=True)
class Signals:
    """names: (p,) in words. values: (n, p)."""

    names: tuple[str, ...]
    values: Array


Kind = Literal["torque", "force", "attitude"]
"""What one-step errors are of."""


def signals_of(run: Run, motion: Motion, configuration: Configuration, kind: Kind) -> Signals:
    """Candidates for the one-step errors of a kind."""
    mixer = MIXERS[configuration]
    common = _Collected()
    speed = np.sqrt(motion.squares.end)
    slope = _change(speed, run.period_s)
    # The mean over the recording makes it a deviation; the voltage itself is the battery's word.
    charge = (run.supply_v - np.mean(run.supply_v))[:, None]
    common.add("rotor speed", MIXED, _mixed(speed, mixer))
    common.add("rotor acceleration", MIXED, _mixed(slope, mixer))
    common.add("rotors slowing down", MIXED, _mixed(np.minimum(slope, 0.0), mixer))
    lost = speed * _leaky(np.minimum(slope, 0.0), MOTOR_S, run.period_s)
    common.add("rotors that slowed down", MIXED, _mixed(lost, mixer))
    common.add("thrust by battery voltage", MIXED, _mixed(motion.squares.end * charge, mixer))
    common.add("motor voltage", MIXED, _mixed(armature_mv(run.duty, run.supply_v), mixer))
    past = _past_mean(run.gyro)
    p, q, r = past.T
    common.add("rate", AXES, past)
    common.add("rate times its magnitude", AXES, past * np.abs(past))
    common.add("rate products", ("pq", "qr", "pr"), np.column_stack([p * q, q * r, p * r]))
    common.add("squared rate", AXES, past**2)
    spin = motion.spin[:, None]
    common.add("rate by rotor momentum", AXES[:2], spin * past[:, :2])
    common.add("rotor momentum", ("change",), _change(spin, run.period_s))
    common.add("offset", ("constant",), np.ones((len(run), 1)))
    attitude = np.sin(np.nan_to_num(run.attitude[:, :2]))
    common.add("tilt", AXES[:2], _late(attitude, 4))
    pull = np.nan_to_num(run.accelerometer[:, :2])
    force = _late(_leaky(pull, PULL_S, run.period_s) / PULL_S, 1)
    common.add("specific force in the plane", ("forward", "left"), force)
    ways = ("forward", "left", "up")
    # A second leak beside the usual one: together they bend to the craft's own speed.
    slow = _late(velocity_of(run, LEAK_S), 1)
    common.add("slow velocity", ways, slow)
    velocity = _late(motion.velocity, 1)
    common.add("velocity", ways, velocity)
    common.add("velocity times its magnitude", ways, velocity * np.abs(velocity))
    squares = motion.squares.end if kind == "force" else motion.squares.square
    own = _mixed(squares, mixer)
    if kind == "attitude":
        inputs = _lagged(own[:, :3], AXES)
    else:
        inputs, ground = _lagged(own, MIXED), _ground(motion)
        for column in range(ground.shape[1]):
            inputs.add("rotor squares near the ground", MIXED, own * ground[:, [column]])
    names = (*inputs.names, *common.names)
    return Signals(names, np.hstack([*inputs.columns, *common.columns]))


class _Collected:
    """Columns and their names, as they come."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.columns: list[Array] = []

    def add(self, what: str, parts: tuple[str, ...], values: Array) -> None:
        self.names += [f"{what}, {part}" for part in parts]
        self.columns.append(values)


def _lagged(own: Array, parts: tuple[str, ...]) -> _Collected:
    inputs = _Collected()
    for lag in (0, *LAGS):
        when = f" {lag} rows before" if lag else ""
        inputs.add(f"rotor squares{when}", parts, _late(own, lag))
    return inputs


def _mixed(values: Array, mixer: Array) -> Array:
    """Roll, pitch, yaw and collective part of one value per rotor."""
    return np.hstack([values @ mixer.T, values.sum(axis=1, keepdims=True)])


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


def _ground(motion: Motion) -> Array:
    """Fading closeness to take-off and landing, (n, 2)."""
    columns = []
    for away in (motion.since_start_s, motion.before_end_s):
        columns += [np.exp(-np.clip(away, 0.0, None) / fade) for fade in GROUND_S]
    return np.column_stack(columns)


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

    channels: None where the recordings lack it. past: for each of ``HORIZONS_S``, (9, m) weights
    of the channel's memories and of its rate's; zero where it does not pay. whiteners: of the
    shortest horizon's errors, per channel, for spectra.
    """

    channels: tuple[ChannelPredictor | None, ...]
    past: tuple[Array, ...]
    whiteners: tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class Floor:
    """What noise leaves of a run, SI, (n, 9) each.

    horizons: as ``AheadErrors`` has them. step: of the shortest one, whitened by an
    autoregression: as large as a perfect observer's errors would be, which are white.
    """

    horizons: tuple[Array, ...]
    step: Array


@dataclass(frozen=True, slots=True)
class Prepared:
    """One run: one-step errors (n, 9), the craft's layout, and stretches in the air."""

    errors: AheadErrors
    step: Array
    configuration: Configuration
    stretches: tuple[slice, ...]

    def signals(self, kind: Kind) -> Signals:
        """Candidates for errors of a kind: made when they are asked for, since those of a minute
        of flight are 20 MB."""
        return signals_of(self.errors.run, self.errors.motion, self.configuration, kind)


def prepare(errors: AheadErrors, configuration: Configuration) -> Prepared:
    """errors: of any base model on the run; its rows, its motion and its body are used."""
    flown = np.concatenate([[0], errors.motion.flown.astype(np.int8), [0]])
    edges = np.flatnonzero(np.diff(flown)).reshape(-1, 2)
    stretches = tuple(
        slice(int(first) + 2, int(last)) for first, last in edges if last - first > LEAST_ROWS
    )
    return Prepared(errors, _one_step(errors), configuration, stretches)


def learn(prepared: Sequence[Prepared]) -> BlackBox:
    """Fit the black box on runs."""
    found: list[ChannelPredictor | None] = []
    shares = [np.zeros_like(one.step) for one in prepared]
    for first, kind in zip((0, 3, 6), KINDS, strict=True):
        signals = [one.signals(kind) for one in prepared]
        pieces = [
            (_taken(own.values, rows), one.step[rows, first : first + 3])
            for one, own in zip(prepared, signals, strict=True)
            for rows in _rows(one, first)
        ]
        fitted = fit_signals(pieces) if pieces else [None] * 3
        for one, own, explained in zip(prepared, signals, shares, strict=True):
            explained[:, first : first + 3] = _share(one, own, fitted)
        found += fitted
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
        known = [part[np.isfinite(part)] for part in series]
        whiteners.append(estimate_noise(known, WHITEN_ORDER).whitener if known else np.ones(1))
    return BlackBox(channels, _learn_past(prepared, left), tuple(whiteners))


def floor_errors(black_box: BlackBox, prepared: Prepared) -> Floor:
    """What the black box leaves of a run, in the rows of its errors."""
    share = np.zeros_like(prepared.step)
    for first, kind in zip((0, 3, 6), KINDS, strict=True):
        fitted = black_box.channels[first : first + 3]
        share[:, first : first + 3] = _share(prepared, prepared.signals(kind), fitted)
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
    return Floor(tuple(horizons), step)


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
        for rows in _rows(one, channel):
            step[rows, channel] = one.step[rows, channel] - share[rows, channel]
    totals = []
    for counts, error in zip(_counts(one), (errors.step, *errors.horizons), strict=True):
        total = step.copy()  # specific force is judged at the end only: nothing adds up
        for part in (GYRO, ATTITUDE):
            total[:, part] = _weighted(step[:, part], np.ones(int(counts[part][0])))
        turned = _weighted(step[:, GYRO], _angle_weights(int(counts[6])))
        total[:, ATTITUDE] += _turn(errors.run.attitude, turned * period)
        total[~np.isfinite(error)] = np.nan
        totals.append(total)
    return _Unexplained(step, tuple(totals))


def _share(one: Prepared, signals: Signals, predictors: Sequence[ChannelPredictor | None]) -> Array:
    """What signals explain of the one-step errors of their three channels, (n, 3), without
    vibration.

    Through the controller the inputs hold the vibration of the rows before, and noise-free sums
    of them foretell the next row's. Smoothed on all rows, before an attitude of every second row
    could fold it to low frequency.
    """
    from scipy.ndimage import gaussian_filter1d

    share = np.zeros((len(one.step), len(predictors)))
    sigma = SMOOTH_S / one.errors.run.period_s
    for column, predictor in enumerate(predictors):
        if predictor is None or not len(predictor.columns):
            continue
        for stretch in one.stretches:
            explained = signals.values[stretch, predictor.columns] @ predictor.weights
            share[stretch, column] = gaussian_filter1d(explained, sigma, mode="nearest")
    return share


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


def _counts(one: Prepared) -> tuple[NDArray[np.int64], ...]:
    """Rows (9,) of the shortest horizon and of each of ``HORIZONS_S``."""
    return (one.errors.step_rows, *one.errors.rows)


def _weighted(values: Array, weights: Array) -> Array:
    """Row k: sum over j of ``weights[j] values[k - j]``; values (n, m)."""
    from scipy.signal import lfilter

    return lfilter(weights, [1.0], values, axis=0)


def _angle_weights(count: int) -> Array:
    """What a rate error of each row of a horizon, last row first, adds to the angle at its end:
    it lasts from its row on, by the trapezoidal rule."""
    return np.arange(count, dtype=np.float64) + 0.5


def _turn(attitude: Array, turned: Array) -> Array:
    """Small body rotations (n, 3) at attitudes (n, 3) as changes of roll, pitch, yaw."""
    return euler_rates(np.nan_to_num(attitude), turned)


def _pooled(left: Sequence[_Unexplained]) -> Array:
    """RMS (9,) over runs and the judged horizons; NaN for a channel without a row."""
    return pooled_rms([error for one in left for error in one.totals[1:]])
