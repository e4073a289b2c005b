"""The likelihood of residuals in the frequency domain: by a given spectrum, or by one of their
own.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.estimate import bounded_step
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import (
    ACCELEROMETER,
    ATTITUDE,
    Columns,
    Series,
    evaluate,
)
from groundstation.identification.likelihood.motion import Frame, Point, value
from groundstation.telemetry.arrays import Array

# Generalised least squares in the frequency domain, over the full band.
#
# Residuals and columns of every flight and channel are tapered and transformed once. Dividing by a
# smooth noise spectrum whitens them; as long as the whole band is used, that is the same as
# one-step prediction with a causal noise model, and so free of bias in closed loop.


TAPER = 0.03
"""Share of a flight over which it fades in and out."""
FIRST_BAND_HZ, WIDEST_BAND_HZ, GROWTH = 0.4, 3.0, 1.1


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One channel of one flight.

    hz, weight: (2 m,) frequencies and degrees of freedom, m real parts and then m imaginary
    ones. residual: (2 m,). columns: (k, 2 m) of the unknowns with numbers ``place`` (k,).
    period_s: between two values of the channel. lasting: (k, 2 m) of what a flight may have
    throughout, of unit size or of the size that it is expected to have; None where nothing is.
    """

    flight: int
    channel: int
    hz: Array
    weight: Array
    residual: Array
    columns: Array
    place: NDArray[np.int64]
    period_s: float = 0.0
    lasting: Array | None = None


@dataclass(frozen=True, slots=True)
class Noise:
    """Power spectrum of one channel: (b,) band centres in Hz and power per degree of freedom."""

    hz: Array
    power: Array

    def at(self, hz: Array) -> Array:
        return np.exp(np.interp(hz, self.hz, np.log(self.power)))


@dataclass(frozen=True, slots=True)
class Vertical:
    """The 1 g row of one flight: residual, slopes (p,), its standard deviation, all m/s^2."""

    flight: int
    residual: float
    slopes: Array
    sigma: float


@dataclass(frozen=True, slots=True)
class Quadratic:
    """-2 log L around a point: value - 2 gradient d + d normal d, normal (p, p)."""

    normal: Array
    gradient: Array
    value: float


def transform(
    number: int,
    series: Series,
    keys: Sequence[str],
    period_s: float,
    strides: Mapping[int, int],
) -> list[Spectrum]:
    """Spectra of one flight's series. strides: rows between two values of a channel."""
    found = []
    place = {key: i for i, key in enumerate(keys)}
    for channel, residual in series.residual.items():
        touching = [key for key in keys if channel in series.columns.get(key, {})]
        rows = len(residual)
        lasting = series.lasting.get(channel, np.empty((0, rows)))
        stack = np.empty((1 + len(touching) + len(lasting), rows))
        stack[0] = residual
        stack[1 + len(touching) :] = lasting
        for i, key in enumerate(touching):
            stack[i + 1] = series.columns[key][channel]
        step = period_s * strides.get(channel, 1)
        spectra, hz, weight = fourier(stack, step)
        found.append(
            Spectrum(
                number,
                channel,
                hz,
                weight,
                spectra[0],
                spectra[1 : 1 + len(touching)],
                np.array([place[key] for key in touching], np.int64),
                step,
                spectra[1 + len(touching) :] if len(lasting) else None,
            )
        )
    return found


def transform_channel(signals: Mapping[str, Array], channel: int, flight: Flight) -> Array:
    """Spectra (k, 2 m) of signals that are given for all rows, as a channel's columns."""
    period, rows = flight.period_s, flight.rows
    attitude = flight.attitude
    if channel >= ATTITUDE and attitude is not None:
        ends = np.arange(len(attitude.rate)) * attitude.stride + attitude.first
        stack = np.stack([values[ends] for values in signals.values()])
        return fourier(stack, period * attitude.stride)[0]
    return fourier(np.stack([values[rows] for values in signals.values()]), period)[0]


def fourier(stack: Array, step_s: float) -> tuple[Array, Array, Array]:
    """Spectra (k, 2 m) of rows (k, n), their frequencies in Hz and weights (2 m,). The rows are
    overwritten: a search's are hundreds of megabytes."""
    from scipy.fft import next_fast_len, rfft

    rows = stack.shape[1]
    edge = max(1, round(TAPER * rows))
    fade = np.ones(rows)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(edge) + 0.5) / edge)
    fade[:edge], fade[-edge:] = ramp, ramp[::-1]
    size = next_fast_len(rows, real=True)
    energy = float((fade**2).sum())
    stack *= fade
    spectra = rfft(stack, size, axis=1, overwrite_x=True)
    hz = np.arange(spectra.shape[1]) / (size * step_s)
    weight = np.full(len(hz), 2.0 * energy / size)
    weight[0] *= 0.5
    if size % 2 == 0:
        weight[-1] *= 0.5
    real, scale = np.empty((len(stack), 2 * len(hz))), 1.0 / np.sqrt(energy)
    np.multiply(spectra.real, scale, out=real[:, : len(hz)])
    np.multiply(spectra.imag, scale, out=real[:, len(hz) :])
    return real, np.tile(hz, 2), np.tile(weight, 2)


def bands(top_hz: float, even_hz: float | None = None) -> Array:
    """Edges in Hz: narrow where motion is, wider above, or all ``even_hz`` apart."""
    if even_hz is not None:
        return np.linspace(0.0, top_hz * (1.0 + 1e-9), max(1, round(top_hz / even_hz)) + 1)
    edges, width = [0.0], FIRST_BAND_HZ
    while edges[-1] < top_hz:
        edges.append(edges[-1] + width)
        width = min(width * GROWTH, WIDEST_BAND_HZ)
    edges[-1] = top_hz * (1.0 + 1e-9)
    return np.array(edges)


def whiten_by_own(
    spectra: Sequence[Spectrum],
    values: Sequence[Array],
    used: Sequence[Array],
    even_hz: float | None = None,
) -> dict[int, Noise]:
    """Noise spectra per channel from residuals; used: degrees of freedom spent on each value.

    even_hz: width of the bands, instead of those of ``bands``.
    """
    noises: dict[int, Noise] = {}
    for channel in sorted({s.channel for s in spectra}):
        mine = [i for i, s in enumerate(spectra) if s.channel == channel]
        edges = bands(max(spectra[i].hz[-1] for i in mine), even_hz)
        power, count, free = (np.zeros(len(edges) - 1) for _ in range(3))
        for i in mine:
            band = np.searchsorted(edges, spectra[i].hz, side="right") - 1
            size = len(power)
            weight = spectra[i].weight
            power += np.bincount(band, weight * values[i] ** 2, size)[:size]
            count += 0.5 * np.bincount(band, weight, size)[:size]
            free += np.bincount(band, used[i], size)[:size]
        good = count > 0
        left = np.maximum(count - free, 0.3 * count)[good]
        middle = 0.5 * (edges[1:] + edges[:-1])[good]
        noises[channel] = Noise(middle, np.maximum(power[good] / left, 1e-30))
    return noises


def quadratic(
    spectra: Sequence[Spectrum],
    noises: Mapping[int, Noise],
    verticals: Sequence[Vertical],
    count: int,
) -> Quadratic:
    """-2 log L (without its constant) of residuals as a quadratic of ``count`` unknowns."""
    normal, gradient, value = np.zeros((count, count)), np.zeros(count), 0.0
    for s in spectra:
        scale = s.weight / noises[s.channel].at(s.hz)
        root = np.sqrt(scale)
        white, error = s.columns * root, s.residual * root
        normal[np.ix_(s.place, s.place)] += white @ white.T
        gradient[s.place] += white @ error
        value += float(error @ error)
    for row in verticals:
        scaled = row.slopes / row.sigma**2
        normal += np.outer(scaled, row.slopes)
        gradient += scaled * row.residual
        value += (row.residual / row.sigma) ** 2
    return Quadratic(normal, gradient, value)


def settled(rows: Array, lasting: Array | None, scale: Array) -> Array:
    """Rows (..., 2 m) as they count beside lasting signals of unknown sizes.

    lasting: (k, 2 m) of their expected sizes, the standard deviations of a normal prior. scale:
    (2 m,) weights of squares. Sums of weighted squares and products of the result are those in
    which the sizes have been integrated out.
    """
    if lasting is None:
        return rows
    strength, turn = np.linalg.eigh(lasting @ (scale * lasting).T)
    apart = turn.T @ lasting
    share = (1.0 - (1.0 + np.maximum(strength, 0.0)) ** -0.5) / np.maximum(strength, 1e-300)
    return rows - (share * (rows @ (scale * apart).T)) @ apart


def beside_lasting(s: Spectrum, rows: Array, noise: Noise) -> Array:
    """``settled`` for rows (..., 2 m) of a spectrum's channel under its noise."""
    return settled(rows, s.lasting, s.weight / noise.at(s.hz))


def trimmed(s: Spectrum, noise: Noise) -> Spectrum:
    """A spectrum as it counts beside what lasts for its flight."""
    residual, columns = (beside_lasting(s, rows, noise) for rows in (s.residual, s.columns))
    return replace(s, residual=residual, columns=columns)


def white_rows(s: Spectrum, noise: Noise, values: Array) -> Array:
    """Values (..., 2 m) of a spectrum's channel, whitened, as rows of time (..., n); the sums of
    their products, times half the sum of its weights, are those of the likelihood."""
    from scipy.fft import irfft

    white, bins = values * (1.0 / np.sqrt(noise.at(s.hz))), len(s.hz) // 2
    return irfft(white[..., :bins] + 1j * white[..., bins:], 2 * (bins - 1))


def leverage(spectrum: Spectrum, noise: Noise, covariance: Array) -> Array:
    """Degrees of freedom (2 m,) that a fit with this covariance takes from each value."""
    part = covariance[np.ix_(spectrum.place, spectrum.place)]
    scale = spectrum.weight / noise.at(spectrum.hz)
    turned = part @ spectrum.columns
    return scale * np.einsum("kn,kn->n", spectrum.columns, turned)


# Residuals of flights at a point and their slopes, in the frequency domain.


END_SPEED_M_S = 0.3
"""Vertical speed that what was recorded of a flight may end with, on the ground as well: a
touch-down is over between two rows, and how fast the craft came down is not in the recording."""
LEAST_LIFT_DOUBT = 0.05
"""m/s^2: the model's mean force is 1 g to half a percent; what the accelerometer says of it is
better known, but where slow air moves real craft its mean has no weight."""
REST_SPEED_M_S = 0.03
"""What it may begin with where it takes off."""


@dataclass(frozen=True, slots=True)
class Linear:
    """Residuals and columns of all flights at a point, in the frequency domain."""

    point: Point
    keys: tuple[str, ...]
    spectra: list[Spectrum]
    verticals: list[Vertical]

    def place(self, keys: Sequence[str]) -> list[int]:
        return [self.keys.index(key) for key in keys]

    def within(self, least_hz: float, most_hz: float | Sequence[float]) -> Linear:
        """The same where only a band counts, which may end elsewhere in each flight."""
        spectra = []
        for s in self.spectra:
            most = most_hz[s.flight] if isinstance(most_hz, Sequence) else most_hz
            inside = (s.hz >= least_hz) & (s.hz <= most)
            spectra.append(replace(s, weight=np.where(inside, s.weight, 0.0)))
        return replace(self, spectra=spectra)


def linearise(
    flights: Sequence[Flight],
    frame: Frame,
    point: Point,
    keys: Sequence[str],
    channels: Container[int] = range(9),
    nuisances: Mapping[str, Sequence[Columns]] | None = None,
) -> Linear:
    """Residuals and columns of flights at a point, as spectra of the given channels.

    The vertical rows belong to the accelerometer's.

    nuisances: keys that no effect has, linear, with what each adds to every flight per unit.
    """
    spectra: list[Spectrum] = []
    verticals: list[Vertical] = []
    extra = nuisances or {}
    for number, flight in enumerate(flights):
        own = [key for key in keys if key not in extra]
        series = evaluate(flight, frame, point, own, channels)
        for key in extra:
            series.columns[key] = extra[key][number]
            for channel, column in extra[key][number].items():
                series.residual[channel] = series.residual[channel] - point[key] * column
        series.residual = {c: rows for c, rows in series.residual.items() if c in channels}
        spectra += transform(number, series, keys, flight.period_s, _strides(flight))
        if ACCELEROMETER in channels:
            verticals += _vertical(number, series, keys, flight)
    return Linear(dict(point), tuple(keys), spectra, verticals)


def _strides(flight: Flight) -> dict[int, int]:
    stride = flight.attitude.stride if flight.attitude is not None else 1
    return {ATTITUDE + i: stride for i in range(3)}


def _vertical(number: int, series: Series, keys: Sequence[str], flight: Flight) -> list[Vertical]:
    if series.vertical is None:
        return []
    residual, slopes = series.vertical
    seconds = (flight.whole.stop - flight.whole.start) * flight.period_s
    begin = REST_SPEED_M_S if flight.rests[0] else END_SPEED_M_S
    sigma = np.hypot(begin, END_SPEED_M_S) / seconds
    found = [Vertical(number, residual, _row(slopes, keys), float(sigma))]
    if series.lift is not None:
        loose = max(
            LEAST_LIFT_DOUBT, END_SPEED_M_S / ((flight.last - flight.first) * flight.period_s)
        )
        found.append(Vertical(number, series.lift[0], _row(series.lift[1], keys), loose))
    return found


def _row(slopes: Mapping[str, float], keys: Sequence[str]) -> Array:
    return np.array([slopes.get(key, 0.0) for key in keys])


# Maximum likelihood with a noise spectrum of each flight's own, free at every frequency.
#
# Slow air and trim, which the controller answers, hold almost all power of a real flight, and
# vibration most of the rest: no rational noise model of moderate order whitens both. Here the
# spectrum of each flight and channel is the smoothed periodogram of its own residual, found by
# reweighting from white noise on (Whittle's likelihood, concentrated over the spectra). With
# the whole band in use this is prediction one step ahead with a causal noise model, and so free of
# bias in closed loop; a band cut out of it is not, quite, and is used to see whether an estimate
# moves.


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
