"""What flights say at a point, as spectra: residuals, and columns of unknowns; kept for a while."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import (
    ACCELEROMETER,
    ATTITUDE,
    Columns,
    Evaluation,
    Series,
    series_of,
)
from groundstation.identification.likelihood.motion import Frame, Point
from groundstation.telemetry.arrays import Array

# Residuals and columns of every flight and channel are tapered and transformed once.


TAPER = 0.03
"""Share of a flight over which it fades in and out."""


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
class Vertical:
    """The 1 g row of one flight: residual, slopes (p,), its standard deviation, all m/s^2."""

    flight: int
    residual: float
    slopes: Array
    sigma: float


def transform(
    number: int, series: Series, keys: Sequence[str], period_s: float, strides: Mapping[int, int]
) -> list[Spectrum]:
    """Spectra of one flight's series, whose columns are used up. strides: rows between two values
    of a channel."""
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
            stack[i + 1] = series.columns[key].pop(channel)
        step, count = period_s * strides.get(channel, 1), 1 + len(touching)
        spectra, hz, weight = fourier(stack, step)
        places = np.array([place[key] for key in touching], np.int64)
        lasts = spectra[count:] if len(lasting) else None
        rows_of = spectra[0], spectra[1:count], places, step, lasts
        found.append(Spectrum(number, channel, hz, weight, *rows_of))
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

    def equations(self, powers: Sequence[Array]) -> tuple[Array, Array]:
        """Normal matrix (p, p) and gradient (p,) by the power (m,) of each spectrum's noise."""
        count = len(self.keys)
        normal, gradient = np.zeros((count, count)), np.zeros(count)
        for s, power in zip(self.spectra, powers, strict=True):
            scaled = s.columns * (s.weight / np.tile(power, 2))
            normal[np.ix_(s.place, s.place)] += scaled @ s.columns.T
            gradient[s.place] += scaled @ s.residual
        for row in self.verticals:
            normal += np.outer(row.slopes, row.slopes) / row.sigma**2
            gradient += row.slopes * row.residual / row.sigma**2
        return normal, gradient

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
    evaluations: Sequence[Evaluation] = (),
) -> Linear:
    """Residuals and columns of flights at a point, as spectra of the given channels.

    The vertical rows belong to the accelerometer's.

    nuisances: keys that no effect has, linear, with what each adds to every flight per unit.
    evaluations: of the flights at the point, where they are known.
    """
    spectra: list[Spectrum] = []
    verticals: list[Vertical] = []
    extra = nuisances or {}
    for number, flight in enumerate(flights):
        own = [key for key in keys if key not in extra]
        known = evaluations[number] if evaluations else Evaluation(flight, frame, point, channels)
        series = series_of(known, own)
        for key in extra:
            series.columns[key] = dict(extra[key][number])
            for channel, column in extra[key][number].items():
                series.residual[channel] = series.residual[channel] - point[key] * column
        series.residual = {c: rows for c, rows in series.residual.items() if c in channels}
        stride = 1 if flight.attitude is None else flight.attitude.stride
        strides = {ATTITUDE + axis: stride for axis in range(3)}
        spectra += transform(number, series, keys, flight.period_s, strides)
        if ACCELEROMETER in channels:
            verticals += _vertical(number, series, keys, flight)
    return Linear(dict(point), tuple(keys), spectra, verticals)


def _vertical(number: int, series: Series, keys: Sequence[str], flight: Flight) -> list[Vertical]:
    if series.vertical is None:
        return []

    def row(told: tuple[float, dict[str, float]], sigma: float) -> Vertical:
        return Vertical(number, told[0], np.array([told[1].get(key, 0.0) for key in keys]), sigma)

    seconds = (flight.whole.stop - flight.whole.start) * flight.period_s
    begin = REST_SPEED_M_S if flight.rests[0] else END_SPEED_M_S
    found = [row(series.vertical, float(np.hypot(begin, END_SPEED_M_S) / seconds))]
    if series.lift is not None:
        seconds = (flight.last - flight.first) * flight.period_s
        found.append(row(series.lift, max(LEAST_LIFT_DOUBT, END_SPEED_M_S / seconds)))
    return found


# What a search evaluated lately: it asks more than once of the point at which a joint fit ended,
# and of the steps of a fit that are refused it asks no column at all.


KEPT_COLUMNS, KEPT_POINTS = 40, 8
"""Of the points evaluated last, the most unknowns whose columns are kept, those of a joint fit
(2 MB each of two minutes of flight), and the most points."""


@dataclass(slots=True, eq=False)
class Visited:
    """Flights at a point: residuals, and columns as far as they were asked for. evaluations: of the
    last point alone, and until columns are asked for, for they are large."""

    frame: Frame
    flights: tuple[Flight, ...]
    linear: Linear
    evaluations: list[Evaluation]

    def is_at(self, frame: Frame, point: Point, flights: Sequence[Flight]) -> bool:
        same = len(flights) == len(self.flights) and self.frame is frame
        same = same and all(a is b for a, b in zip(flights, self.flights, strict=True))
        return same and self.linear.point == point


class Lately:
    """The points at which flights were evaluated last, the newest one at the end."""

    def __init__(self) -> None:
        self._points: list[Visited] = []

    def linearise(
        self, flights: Sequence[Flight], frame: Frame, point: Point, keys: Sequence[str]
    ) -> Linear:
        """``linearise``: of what was evaluated at this point lately only the columns that are new.
        Arrays of columns are the caller's own, others are not."""
        found = next((one for one in self._points if one.is_at(frame, point, flights)), None)
        known = () if found is None else found.linear.keys
        new = [key for key in keys if key not in known]
        if found is not None and not new:
            self._points.append(self._points.pop(self._points.index(found)))
            return _of_keys(found.linear, keys)
        made = [] if found is None else found.evaluations
        keeps = len(known) + len(new) <= KEPT_COLUMNS
        if not keeps:  # columns of every effect take the room of all others
            self._points = [] if found is None else [found]
        for one in self._points:
            one.evaluations = []
        if not new:
            made = [Evaluation(flight, frame, point) for flight in flights]
        plain = linearise(flights, frame, point, new, evaluations=made)
        if found is not None:
            plain = _side_by_side(found.linear, plain)
        if not keeps:
            return _of_keys(plain, keys, used_up=True)
        if found is not None:
            self._points.remove(found)
        self._points.append(Visited(frame, tuple(flights), plain, [] if new else made))
        self._forget()
        return _of_keys(plain, keys)

    def _forget(self) -> None:
        columns = sum(len(one.linear.keys) for one in self._points)
        while len(self._points) > 1 and (columns > KEPT_COLUMNS or len(self._points) > KEPT_POINTS):
            columns -= len(self._points.pop(0).linear.keys)


def _side_by_side(one: Linear, other: Linear) -> Linear:
    """Two linearisations at a point as one; ``other`` is used up."""
    spectra = []
    for s in one.spectra:
        more = other.spectra.pop(0)
        columns = np.concatenate([s.columns, more.columns])
        place = np.concatenate([s.place, more.place + len(one.keys)])
        spectra.append(replace(s, columns=columns, place=place))
    verticals = [
        replace(row, slopes=np.concatenate([row.slopes, more.slopes]))
        for row, more in zip(one.verticals, other.verticals, strict=True)
    ]
    return Linear(one.point, (*one.keys, *other.keys), spectra, verticals)


def _of_keys(linear: Linear, keys: Sequence[str], used_up: bool = False) -> Linear:
    """The linearisation with the columns of these keys, in their order; used_up: it is needed no
    more, and its spectra leave it one by one."""
    at = linear.place(keys)
    spectra = []
    left = linear.spectra if used_up else [*linear.spectra]
    while left:
        s = left.pop(0)
        rows = {number: row for row, number in enumerate(s.place.tolist())}
        there = [new for new, number in enumerate(at) if number in rows]
        columns = s.columns[[rows[at[new]] for new in there]]
        spectra.append(replace(s, columns=columns, place=np.array(there, np.int64)))
    verticals = [replace(row, slopes=row.slopes[at]) for row in linear.verticals]
    return Linear(dict(linear.point), tuple(keys), spectra, verticals)
