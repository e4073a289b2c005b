"""Maximum likelihood with a noise spectrum of each flight's own, free at every frequency.

Slow air and trim, which the controller answers, hold almost all power of a real flight, and
vibration most of the rest: no rational noise model of moderate order whitens both. Here the
spectrum of each flight and channel is the smoothed periodogram of its own residual, found by
reweighting from white noise on (Whittle's likelihood, concentrated over the spectra). With
the whole band in use this is prediction one step ahead with a causal noise model, and so free of
bias in closed loop; a band cut out of it is not, quite, and is used to see whether an estimate
moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.identification.estimate import bounded_step
from groundstation.identification.likelihood.linearisation import Linear
from groundstation.identification.likelihood.parameters import Point, value
from groundstation.identification.likelihood.spectra import Spectrum
from groundstation.telemetry.arrays import Array

HALF_WIDTH_HZ, LEAST_BINS = 0.8, 4
"""Half the width of the moving mean over a periodogram, and its least number of bins to a side: the
spectrum's shape below 4 Hz is what an estimate hangs on."""
REWEIGHTINGS, RELINEARISATIONS = 30, 8
SETTLED = 0.02
"""Both end when nothing moves by more than this share of its standard error."""
WHITENER_BINS, WHITENER_ROWS = 2048, 400
WHITENER_HALF_WIDTH_HZ, SLOW_HZ = 3.0, 6.0


@dataclass(frozen=True, slots=True)
class FreeFit:
    """Where the likelihood is largest.

    point: the whole point; keys: what was estimated. normal: (p, p) information. cost: -2 log L
    with the spectra at their best, to be compared on the same flights. linear, powers, left: the
    last linearisation, the spectra (m,) and the residuals (2 m,), one for each flight and channel.
    """

    point: Point
    keys: tuple[str, ...]
    normal: Array
    cost: float
    linear: Linear
    powers: list[Array]
    left: list[Array]

    @property
    def values(self) -> Array:
        return np.array([value(self.point, key) for key in self.keys])

    @property
    def settled(self) -> bool:
        """Whether the last linearisation is as good as one at the point itself."""
        before = np.array([value(self.linear.point, key) for key in self.keys])
        errors = np.abs(self.values - before) * np.sqrt(np.diag(self.normal))
        return bool((errors < SETTLED).all())


@dataclass(frozen=True, slots=True)
class Limits:
    """low, high: (p,) hard limits. step: (p,) the longest step from one linearisation."""

    low: Array
    high: Array
    step: Array

    def held(self, keys: Sequence[str], still: Sequence[str], at: Array | None = None) -> Limits:
        """The same where some keys stay (at 0, or at their values in ``at``)."""
        fixed = np.array([key in still for key in keys])
        values = np.zeros(len(keys)) if at is None else at
        low, high = (np.where(fixed, values, one) for one in (self.low, self.high))
        return replace(self, low=low, high=high)


def fit_free(
    linearise: Callable[[Point], Linear],
    start: Point | Linear,
    limits: Limits,
    white: bool = True,
) -> FreeFit:
    """Gauss-Newton with reweighting.

    linearise: residuals and columns at a point. start: a point, or a linearisation at it. white:
    the first weights; otherwise those of the residual at ``start``.
    """
    linear = start if isinstance(start, Linear) else linearise(start)
    point = linear.point if isinstance(start, Linear) else start
    keys = linear.keys
    powers = [np.ones(len(s.hz) // 2) for s in linear.spectra]
    if not white:
        powers = smoothed(linear.spectra, [s.residual for s in linear.spectra])
    longest, before = limits.step.copy(), np.zeros(len(keys))
    for number in range(RELINEARISATIONS):
        now = np.array([value(point, key) for key in keys])
        low = np.maximum(limits.low - now, -longest)
        high = np.minimum(limits.high - now, longest)
        change, normal, powers = reweighted(linear, powers, low, high)
        point = {**point, **dict(zip(keys, (now + change).tolist(), strict=True))}
        settled = np.all(np.abs(change) * np.sqrt(np.diag(normal)) < SETTLED)
        if settled or number == RELINEARISATIONS - 1:
            break
        longest = np.where(change * before < 0.0, 0.5 * longest, longest)  # to and fro: shorter
        before = change
        linear = linearise(point)
    left = [s.residual - change[s.place] @ s.columns for s in linear.spectra]
    return FreeFit(point, keys, normal, cost_of(linear.spectra, powers, left), linear, powers, left)


def reweighted(
    linear: Linear,
    powers: list[Array] | None,
    low: Array,
    high: Array,
) -> tuple[Array, Array, list[Array]]:
    """The step from a linearisation at which weights and residuals agree.

    powers: first spectra, None: white. low, high: (p,) limits of the step. Returns the step
    (p,), its information (p, p) and the spectra.
    """
    count = len(linear.keys)
    change = np.zeros(count)
    normal, free = np.eye(count), np.ones(count, np.bool_)
    powers = powers or [np.ones(len(s.hz) // 2) for s in linear.spectra]
    for _ in range(REWEIGHTINGS):
        normal, gradient = np.zeros((count, count)), np.zeros(count)
        for s, power in zip(linear.spectra, powers, strict=True):
            scaled = s.columns * (s.weight / np.tile(power, 2))
            normal[np.ix_(s.place, s.place)] += scaled @ s.columns.T
            gradient[s.place] += scaled @ s.residual
        for row in linear.verticals:
            normal += np.outer(row.slopes, row.slopes) / row.sigma**2
            gradient += row.slopes * row.residual / row.sigma**2
        moved = bounded_step(normal, gradient, free, low, high)
        error = np.abs(moved - change) * np.sqrt(np.diag(normal))
        change = moved
        left = [s.residual - change[s.place] @ s.columns for s in linear.spectra]
        powers = smoothed(linear.spectra, left)
        if error.max(initial=0.0) < SETTLED:
            break
    return change, normal, powers


def smoothed(spectra: Sequence[Spectrum], values: Sequence[Array]) -> list[Array]:
    """Moving means (m,) of the periodograms of ``values``, one each."""
    from scipy.ndimage import uniform_filter1d

    found = []
    for s, one in zip(spectra, values, strict=True):
        real, imaginary = np.split(one, 2)
        power = uniform_filter1d(real**2 + imaginary**2, 2 * half_width(s) + 1, mode="reflect")
        found.append(np.maximum(power, 1e-30))
    return found


def half_width(s: Spectrum) -> int:
    """Of the moving mean over a spectrum's periodogram, in bins."""
    return max(LEAST_BINS, round(HALF_WIDTH_HZ / (s.hz[1] - s.hz[0])))


def without_upper_ends(linear: Linear, most_hz: float) -> Linear:
    """The same without frequencies that neither count, above ``most_hz``, nor are smoothed into
    some that do."""
    spectra = []
    for s in linear.spectra:
        kept = s.hz <= most_hz + (half_width(s) + 1) * (s.hz[1] - s.hz[0])
        spectra.append(
            replace(
                s,
                hz=s.hz[kept],
                weight=s.weight[kept],
                residual=s.residual[kept],
                columns=s.columns[:, kept],
                lasting=None if s.lasting is None else s.lasting[:, kept],
            )
        )
    return replace(linear, spectra=spectra)


def cost_of(spectra: Sequence[Spectrum], powers: Sequence[Array], left: Sequence[Array]) -> float:
    """-2 log L but for a constant."""
    total = 0.0
    for s, power, one in zip(spectra, powers, left, strict=True):
        half = len(power)
        periodogram = one[:half] ** 2 + one[half:] ** 2
        total += float(s.weight[:half] @ (np.log(power) + periodogram / power))
    return total


def unfitted(linear: Linear) -> tuple[list[Array], list[Array], float]:
    """What a linearisation leaves at its point: residuals (2 m,), their spectra (m,), -2 log L."""
    left = [s.residual for s in linear.spectra]
    powers = smoothed(linear.spectra, left)
    return left, powers, cost_of(linear.spectra, powers, left)


def joined(linear: Linear, key: str, parts: Mapping[str, float]) -> Linear:
    """The linearisation with several keys made one, whose unit moves each by its share.

    The new key stands where the first of them did.
    """
    first = next(iter(parts))
    keep = [one for one in linear.keys if one not in parts or one == first]
    new = {name: i for i, name in enumerate(keep)}
    keep[keep.index(first)] = key
    spectra = []
    for s in linear.spectra:
        names = [linear.keys[i] for i in s.place.tolist()]
        at = [new[first if name in parts else name] for name in names]
        place = sorted(set(at))
        columns = np.zeros((len(place), s.columns.shape[1]))
        for name, number, column in zip(names, at, s.columns, strict=True):
            columns[place.index(number)] += parts.get(name, 1.0) * column
        spectra.append(replace(s, columns=columns, place=np.array(place, np.int64)))
    return Linear(linear.point, tuple(keep), spectra, [])


def minimum_phase_whitener(fit: FreeFit, channel: int) -> Array:
    """Causal filter (k,) that whitens a channel's residual to unit variance.

    From the mean log spectrum of all flights by way of the cepstrum (Kolmogorov's factorisation).
    """
    from scipy.fft import irfft, rfft
    from scipy.ndimage import uniform_filter1d

    mine = [i for i, s in enumerate(fit.linear.spectra) if s.channel == channel]
    top = max(fit.linear.spectra[i].hz[-1] for i in mine)
    hz = np.linspace(0.0, top, WHITENER_BINS + 1)
    logs, total = np.zeros(len(hz)), 0.0
    for i in mine:
        s, power = fit.linear.spectra[i], fit.powers[i]
        share = float(s.weight.sum())
        logs += share * np.interp(hz, s.hz[: len(power)], np.log(power))
        total += share
    # What one flight's spectrum shows in detail is chance; the next flight's has another.
    width = 2 * round(WHITENER_HALF_WIDTH_HZ / hz[1]) + 1
    wide = uniform_filter1d(logs, width, mode="reflect")
    cepstrum = irfft(-0.5 * np.where(hz > SLOW_HZ, wide, logs) / total)
    size = len(cepstrum)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    return irfft(np.exp(rfft(cepstrum)))[:WHITENER_ROWS]
