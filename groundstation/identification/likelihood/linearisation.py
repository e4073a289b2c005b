"""Residuals of flights at a point and their slopes, in the frequency domain."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import ACCELEROMETER, ATTITUDE, Columns
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.parameters import Point
from groundstation.identification.likelihood.residuals import Series, evaluate
from groundstation.identification.likelihood.spectra import Spectrum, Vertical, transform
from groundstation.telemetry.arrays import Array

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
