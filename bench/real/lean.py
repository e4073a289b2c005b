"""What an estimator takes for a tilt: how far reported angles leave the gyro's integral, and why.

The rate at which reported roll and pitch turn less what the gyro says is regressed, within
``BAND_HZ``, on the slope of the specific force across the rotors' axis over g behind a critically
damped filter of second order: 1 is an estimator that takes all of it for a tilt. Nothing of the
program's search or models is used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.real.slow import FLYING_DUTY
from groundstation.dynamics.rotations import euler_rates
from groundstation.recording.open_recording import open_recording
from groundstation.telemetry.packet import STANDARD_GRAVITY

Array = NDArray[np.float64]

BAND_HZ = (0.15, 4.0)
TIMES_S = tuple(np.geomspace(0.1, 1.5, 28).tolist())
BEGIN_S, END_S = 0.7, 0.4
"""Left out after the rotors are up, and before they stop."""
CASES = (
    ("brushless, slow", "imrc", ("eckart00", "eckart12")),
    ("brushless, fast", "imrc", ("eckart22", "eckart27", "eckart34")),
    ("with payload", "imrc_payload", ("eckart06", "eckart12", "eckart20", "eckart26")),
    ("brushed, figures of eight", "imrc_brushed", ("jana02", "jana03")),
    ("brushed, turns on the spot", "imrc_brushed", ("jana01", "jana04", "jana05", "jana06")),
    ("NanoBench, helix and oval", "nanobench", ("B5_helix_fast_rep1.csv", "B7_oval_fast_rep1.csv")),
)
"""Label, folder, flights."""


@dataclass(frozen=True, slots=True)
class Turned:
    """A recording on even rows: how much faster reported roll and pitch turn than the gyro says,
    rad/s, and the force across over g, in the sign in which it would turn them; (n, 2) each. flown:
    the rows that count."""

    period_s: float
    off: Array
    across: Array
    flown: slice


@dataclass(frozen=True, slots=True)
class Lean:
    """strength, share: of roll and pitch (2,); share: of the band's power that is explained."""

    time_s: float
    strength: Array
    share: Array


def find_lean(flights: Sequence[Turned]) -> Lean:
    """The time constant that explains most of both axes, and what it explains."""
    rows = [_in_band(one, one.off) for one in flights]
    off = np.concatenate(rows)
    best: Lean | None = None
    for time_s in TIMES_S:
        lean = np.concatenate([_in_band(one, _slope(one, time_s)) for one in flights])
        power = (lean**2).sum(axis=0)
        strength = (lean * off).sum(axis=0) / power
        share = strength**2 * power / (off**2).sum(axis=0)
        if best is None or share.sum() > best.share.sum():
            best = Lean(time_s, strength, share)
    assert best is not None
    return best


def table(data: Path) -> Iterator[str]:
    """A row per set of flights."""
    yield ""
    yield "| flights | time constant, s | strength: roll, pitch | explained: roll, pitch |"
    yield "|---|---|---|---|"
    for label, folder, names in CASES:
        if not (data / folder).is_dir():
            continue
        found = find_lean([read(data / folder / name) for name in names])
        strength = ", ".join(f"{one:.2f}" for one in found.strength)
        share = ", ".join(f"{100 * one:.0f} %" for one in found.share)
        yield f"| {label} | {found.time_s:.2f} | {strength} | {share} |"


def read(path: Path) -> Turned:
    """A recording, without what it lacks."""
    samples = open_recording(path).samples
    time, period = samples.time_s, float(np.median(np.diff(samples.time_s)))
    rows = np.flatnonzero((samples.duty > FLYING_DUTY).all(axis=1))
    grid = np.arange(time[0], time[-1], period)
    flown = np.searchsorted(grid, (time[rows[0]] + BEGIN_S, time[rows[-1]] - END_S))

    def even(values: Array) -> Array:
        known = np.isfinite(values).all(axis=1)
        return np.column_stack([np.interp(grid, time[known], one) for one in values[known].T])

    attitude = even(np.unwrap(samples.attitude, axis=0))
    gyro, force = even(samples.gyro), even(samples.accelerometer)
    middle, mean = (0.5 * (one[1:] + one[:-1]) for one in (attitude, gyro))
    off = np.diff(attitude, axis=0) / period - euler_rates(middle, mean)
    weight = STANDARD_GRAVITY if abs(float(force[:, 2].mean())) > 0.5 * STANDARD_GRAVITY else 1.0
    across = np.column_stack([-force[1:, 1], force[1:, 0]]) / weight  # some are logged in g
    return Turned(period, off[:, :2], across, slice(*flown.tolist()))


def _slope(one: Turned, time_s: float) -> Array:
    """Slope of the force behind the filter, (n, 2), 1/s."""
    from scipy.signal import bilinear, lfilter

    b, a = bilinear([1.0, 0.0], [time_s**2, 2.0 * time_s, 1.0], fs=1.0 / one.period_s)
    return np.asarray(lfilter(b, a, one.across, axis=0))


def _in_band(one: Turned, values: Array) -> Array:
    from scipy.signal import butter, sosfiltfilt

    band = butter(2, BAND_HZ, "band", fs=1.0 / one.period_s, output="sos")
    return np.asarray(sosfiltfilt(band, values, axis=0)[one.flown])
