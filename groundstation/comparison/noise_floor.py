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

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.autoregression import estimate_noise
from groundstation.comparison.gap import (
    ACCELEROMETER,
    ATTITUDE,
    GYRO,
    AheadErrors,
    pooled_rms,
)
from groundstation.comparison.generic_signals import Kind, Signals, signals_of
from groundstation.comparison.noise_floor_fit import ChannelPredictor, fit_signals
from groundstation.dynamics.rotations import euler_rates
from groundstation.dynamics.vehicle import Configuration
from groundstation.prediction.drive import fresh_rows
from groundstation.telemetry.arrays import Array

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
