"""Recordings as the search wants them: whole flights on an even grid, lost rows as NaN.

Identification cuts a recording at every gap. A radio that loses two rows in a hundred would leave
it nothing; here short gaps become rows without values, and only long silences and restarts end
a run.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.identification.runs import CHANNELS, FASTEST_HZ, SLOWEST_HZ, Run
from groundstation.telemetry.samples import SampleBatch

LONGEST_GAP_S = 0.1
"""A longer silence ends a run: the motors' inputs are no longer known."""
LEAST_S = 5.0


def flights_of(samples: SampleBatch, name: str = "", least_s: float = LEAST_S) -> list[Run]:
    """The runs of a recording that last at least ``least_s``, rows lost in between being NaN.

    Raises BadInputError where no run is long enough or the rate is not one of inertial
    telemetry.
    """
    label = name or "recording"
    if len(samples) < 3:
        raise BadInputError(f"{label}: {len(samples)} samples are too few; record a flight")
    time = samples.time_s
    steps = np.diff(time)
    usual = float(np.median(steps))
    if not 1 / FASTEST_HZ <= usual <= 1 / SLOWEST_HZ:
        raise BadInputError(
            f"{label}: a sample every {usual * 1e3:.3g} ms; the search needs"
            f" {SLOWEST_HZ:.0f} to {FASTEST_HZ:.0f} samples a second"
        )
    broken = (steps > LONGEST_GAP_S) | (steps < 0) | (np.diff(samples.segment) != 0)
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(samples)]])
    found, longest = [], 0.0
    for first, last in pairwise(edges):
        seconds = float(time[last - 1] - time[first])
        longest = max(longest, seconds)
        if seconds >= least_s:
            found.append(_on_grid(samples[first:last], usual, label))
    if not found:
        raise BadInputError(
            f"{label}: the longest uninterrupted stretch lasts {longest:.1f} s, at least"
            f" {least_s:.0f} s are needed; record longer or improve the link"
        )
    return found


def _on_grid(samples: SampleBatch, usual_s: float, label: str) -> Run:
    """Rows on a grid whose period is the mean over steps without a gap."""
    time = samples.time_s
    steps = np.diff(time)
    whole = np.rint(steps / usual_s)
    place = np.concatenate([[0], np.cumsum(np.maximum(whole, 1.0))]).astype(np.int64)
    period = float((time[-1] - time[0]) / place[-1])
    count = int(place[-1]) + 1

    def grid(values: NDArray[np.floating]) -> NDArray[np.float64]:
        out = np.full((count, *values.shape[1:]), np.nan)
        out[place] = values
        return out

    attitude = samples.attitude.astype(np.float64)
    if np.isfinite(attitude).all():
        attitude = np.unwrap(attitude, axis=0)
    return Run(
        name=label,
        start_s=float(time[0]),
        period_s=period,
        duty=grid(samples.duty),
        supply_v=grid(samples.battery_v),
        gyro=grid(samples.gyro),
        accelerometer=grid(samples.accelerometer),
        attitude=grid(attitude),
        rotor_rev_s=grid(samples.rotor_rev_s),
        debug_s=grid(samples.debug * samples.tick_s),
    )


def filled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Missing rows on the straight line between their neighbours; all NaN stays NaN."""
    flat = values.reshape(len(values), -1)
    out = flat.copy()
    rows = np.arange(len(flat), dtype=np.float64)
    for column in range(flat.shape[1]):
        known = np.isfinite(flat[:, column])
        if known.any() and not known.all():
            out[:, column] = np.interp(rows, rows[known], flat[known, column])
    return out.reshape(values.shape)


def without_gaps(run: Run) -> Run:
    """The run with its missing rows filled in, for what needs every row."""
    parts: dict[str, Any] = {name: filled(getattr(run, name)) for name in CHANNELS}
    return replace(run, **parts)
