"""The noise floor of each channel: what a predictor without any physics of its own leaves.

A perfect model still errs by the sensors' noise and by the torques and pushes that nobody
measured. That much is found without a perfect model: the base model's one-step errors are
regressed on every generic signal (``floor_signals``) that clearly shows in them, weighted by the
inverse noise spectrum; of what is left, a long autoregression foretells what it can from the
rows up to the one the prediction starts from (that is what a model's observer does with noise);
and the rest is summed up to 20 and 50 ms.

One step at a time, because in closed loop the inputs answer to the disturbances within 50 ms: a
direct regression at that horizon would take the controller's answer for the cause and come out
too low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.floor_signals import Signals, signals_of
from groundstation.discrepancy.gap import (
    ACCELEROMETER,
    ATTITUDE,
    GYRO,
    AheadErrors,
    fresh_attitude,
    pooled_rms,
)
from groundstation.dynamics.mixer import Configuration
from groundstation.dynamics.rotations import euler_rates
from groundstation.identification.noise_model import NoiseModel, estimate_noise

Array = NDArray[np.float64]

SOURCE = (
    "black-box predictor on the same rows: generic signals that clearly show in the one-step"
    " errors, then an autoregression of order up to 60 on the past, summed to 20 and 50 ms"
)
CLEAR = 30.0
"""Drop of the weighted sum of squares from which a signal is let in: 5.5 standard deviations, as
some eighty are tried on nine channels."""
NOISE_ORDER = 60
WEIGHT_ORDER = 10
"""Order of the spectrum that weights: the saturated fit takes some noise away where the signals
are strong, at low frequency; a long autoregression would follow it there and in closed loop that
is where the inputs mirror the disturbance."""
ROUNDS = 4
WORTH = 0.98
"""The autoregression is used where it leaves at most this share of the error."""
LEAST_ROWS = 200
KINDS = ("torque", "force", "attitude")


@dataclass(frozen=True, slots=True)
class ChannelPredictor:
    """What the black box learnt about one channel's one-step error.

    columns: chosen signals, weights: theirs. noise: of what is left. use_past: whether the
    autoregression pays.
    """

    columns: NDArray[np.int64]
    weights: Array
    noise: NoiseModel
    use_past: bool = False


BlackBox = tuple[ChannelPredictor | None, ...]
"""One per channel; None where the recordings lack it."""


@dataclass(frozen=True, slots=True)
class Floor:
    """What noise leaves of a run, SI, (n, 9) each: as ``AheadErrors`` has ``horizons`` and
    ``step``."""

    horizons: tuple[Array, ...]
    step: Array


@dataclass(frozen=True, slots=True)
class Prepared:
    """One run: one-step errors (n, 9), signals for them by kind, and stretches in the air."""

    errors: AheadErrors
    step: Array
    signals: dict[str, Signals]
    stretches: tuple[slice, ...]


def prepare(errors: AheadErrors, configuration: Configuration) -> Prepared:
    """errors: of any base model on the run; its rows, its motion and its body are used."""
    flown = np.concatenate([[0], errors.motion.flown.astype(np.int8), [0]])
    edges = np.flatnonzero(np.diff(flown)).reshape(-1, 2)
    stretches = tuple(
        slice(int(first) + 2, int(last)) for first, last in edges if last - first > LEAST_ROWS
    )
    signals = signals_of(errors.run, errors.motion, configuration)
    return Prepared(errors, _one_step(errors), signals, stretches)


def learn(prepared: Sequence[Prepared]) -> BlackBox:
    """Fit the black box on runs."""
    found: list[ChannelPredictor | None] = []
    for channel in range(9):
        pieces = [
            (one.step[rows, channel], one.signals[_kind(channel)].values[rows])
            for one in prepared
            for rows in _rows(one, channel)
        ]
        if channel % 3 == 0 and pieces:
            bands = _bands(prepared, _kind(channel))
        found.append(_learn_channel(pieces, bands, channel % 3) if pieces else None)
    best = tuple(
        None if one is None else replace(one, columns=one.columns[:0], weights=one.weights[:0])
        for one in found
    )
    # Never more than it knows without: a signal or a past that does not help there is left out.
    for tried, worth in (
        (tuple(found), 1.0),
        (tuple(None if one is None else replace(one, use_past=True) for one in found), WORTH),
    ):
        before = _pooled([_left(one, best) for one in prepared])
        after = _pooled([_left(one, tried) for one in prepared])
        best = tuple(
            tried[k] if after[k] <= worth * before[k] else one for k, one in enumerate(best)
        )
    return best


def floor_errors(black_box: BlackBox, prepared: Prepared) -> Floor:
    """What the black box leaves of a run, in the rows of its errors."""
    left = _left(prepared, black_box)
    return Floor(left[1:], left[0])


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
        fresh, _ = fresh_attitude(run.attitude)
        step[~fresh, ATTITUDE] = np.nan
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


def _kind(channel: int) -> str:
    return KINDS[channel // 3]


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
        return np.asarray(total[np.ix_(keep, keep)])


def _bands(prepared: Sequence[Prepared], kind: str) -> _Bands:
    from scipy.fft import next_fast_len, rfft
    from scipy.signal.windows import tukey

    first = 3 * KINDS.index(kind)
    parts = [
        (one.signals[kind].values[rows], one.step[rows, first : first + 3])
        for one in prepared
        for rows in _rows(one, first)
    ]
    power = sum(np.square(signals).sum(axis=0) for signals, _ in parts)
    scale = np.sqrt(power / sum(len(signals) for signals, _ in parts))
    scale[scale == 0.0] = 1.0
    edges = np.concatenate([[0.0], np.geomspace(1e-3, 0.02, 15), np.linspace(0.026, 0.501, 80)])
    gram = np.zeros((len(edges) - 1, len(scale) + 3, len(scale) + 3))
    for signals, errors in parts:
        size = next_fast_len(len(signals), real=True)
        window = tukey(len(signals), 0.1)[:, None]
        spectrum = rfft(np.hstack([signals / scale, errors]) * window, size, axis=0)
        spectrum *= np.sqrt(2.0 / size)
        spectrum[0] *= np.sqrt(0.5)
        if size % 2 == 0:
            spectrum[-1] *= np.sqrt(0.5)
        places = np.searchsorted(np.arange(len(spectrum)) / size, edges)
        for band, (low, high) in enumerate(pairwise(places)):
            part = spectrum[low:high]
            gram[band] += part.real.T @ part.real + part.imag.T @ part.imag
    return _Bands(gram, 0.5 * (edges[1:] + edges[:-1]), scale)


def _learn_channel(
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
        left = [error - signals[:, chosen] @ weights for error, signals in pieces]
    return ChannelPredictor(chosen, weights, estimate_noise(left, NOISE_ORDER))


def _solve(gram: Array, columns: NDArray[np.int64]) -> Array:
    if not len(columns):
        return np.zeros(0)
    normal = gram[np.ix_(columns, columns)]
    return np.asarray(np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ gram[columns, -1])


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


def _left(one: Prepared, black_box: BlackBox) -> tuple[Array, ...]:
    """Errors (n, 9) that the black box does not foresee: of the shortest horizon, and of each."""
    errors = one.errors
    series = [_series(one, channel, black_box) for channel in range(9)]

    def reached(channel: int, weights: Array) -> Array:
        total = np.zeros(len(one.step))
        predictor = black_box[channel]
        for rows, left in series[channel]:
            if predictor is not None:
                total[rows] = _unforeseen(left, weights, predictor)
        return total

    found = []
    counts = (errors.step_rows, *errors.rows)
    for count, error in zip(counts, (errors.step, *errors.horizons), strict=True):
        total = np.zeros_like(error)
        for channel in range(9):
            steps = int(count[channel] // errors.step_rows[channel])
            weights = np.ones(steps)
            if channel in range(9)[ACCELEROMETER]:
                weights[1:] = 0.0  # judged at the end only: nothing adds up
            total[:, channel] = reached(channel, weights)
        turned = [reached(axis, _angle_weights(int(count[6]))) for axis in range(3)]
        total[:, ATTITUDE] += _turn(
            errors.run.attitude, np.column_stack(turned) * errors.run.period_s
        )
        total[~np.isfinite(error)] = np.nan
        found.append(total)
    return tuple(found)


def _series(
    one: Prepared, channel: int, black_box: BlackBox
) -> list[tuple[NDArray[np.int64], Array]]:
    """(rows, one-step errors less the share of the signals) of each stretch."""
    predictor = black_box[channel]
    if predictor is None:
        return []
    found = []
    for rows in _rows(one, channel):
        signals = one.signals[_kind(channel)].values[np.ix_(rows, predictor.columns)]
        found.append((rows, one.step[rows, channel] - signals @ predictor.weights))
    return found


def _unforeseen(left: Array, weights: Array, predictor: ChannelPredictor) -> Array:
    """Sum of ``weights[j] left[k - j]``, less what the rows up to the start foretell of it."""
    summed = _weighted(left[:, None], weights)[:, 0]
    whitener = predictor.noise.whitener
    if not predictor.use_past or len(whitener) < 2:
        return summed
    ahead: Array = -whitener[1:]
    total = np.zeros(len(whitener) - 1)
    for weight in weights[::-1]:
        total += weight * ahead
        ahead = np.append(ahead[1:], 0.0) - ahead[0] * whitener[1:]
    delay = np.zeros(len(weights))
    return np.asarray(summed - _weighted(left[:, None], np.concatenate([delay, total]))[:, 0])


def _weighted(values: Array, weights: Array) -> Array:
    """Row k: sum over j of ``weights[j] values[k - j]``; values (n, m)."""
    from scipy.signal import lfilter

    return np.asarray(lfilter(weights, [1.0], values, axis=0))


def _angle_weights(count: int) -> Array:
    """What a rate error of each row of a horizon, last row first, adds to the angle at its end:
    it lasts from its row on, by the trapezoidal rule."""
    return np.arange(count, dtype=np.float64) + 0.5


def _turn(attitude: Array, turned: Array) -> Array:
    """Small body rotations (n, 3) at attitudes (n, 3) as changes of roll, pitch, yaw."""
    return euler_rates(np.nan_to_num(attitude), turned)


def _pooled(left: Sequence[tuple[Array, ...]]) -> Array:
    """RMS (9,) over runs and the judged horizons; NaN for a channel without a row."""
    return pooled_rms([error for one in left for error in one[1:]])
