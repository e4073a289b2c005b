"""Generalised least squares in the frequency domain, over the full band.

Residuals and columns of every flight and channel are tapered and transformed once. Dividing by a
smooth noise spectrum whitens them; as long as the whole band is used, that is the same as
one-step prediction with a causal noise model, and so free of bias in closed loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import ATTITUDE
from groundstation.identification.likelihood.residuals import Series
from groundstation.telemetry.arrays import Array

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
