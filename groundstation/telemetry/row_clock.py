"""The clock behind a recording's samples: its period, what is missing, and whose clock it is.

A craft stamps a sample when it measures it: steps are whole periods, and a longer step is a loss.
A host stamps it when it came. Late samples make long steps and short ones behind them, and none is
missing as long as the stamps come back to the line that the earliest of them lie on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S, TICK_S
from groundstation.telemetry.samples import SampleBatch

PERIOD_TOLERANCE, SINGLE_STEPS = 0.05, 0.02
"""How far a step of the telemetry may be from 2 ms, and which share of such steps tells it."""
UNEVEN, UNEVEN_SHARE = 0.2, 0.1
"""Share of a period by which a step misses whole periods, and share of such steps, from which the
stamps are a host's."""
CATCHES_UP = -0.1
"""Correlation of neighbouring steps below which late stamps are caught up: independent delays give
-0.5, a craft that samples unevenly 0."""
ENVELOPE_ROWS = 25
"""Samples before and behind a long step of which the earliest tell whether one is missing."""
BURST, SCATTER = 1.5, 0.15
"""Mean step over the median one from which samples come in bursts, and scatter of the steps over
the median one from which that is no period."""
COARSE = 5.0
"""A clock's unit is coarse where so many are more than a period."""
LATEST_ROWS = 4
"""Behind a long step so near the end nothing tells yet whether it is caught up."""
MISSED = 0.6
"""Share of a period by which the earliest stamps behind a long step are later than those before it
where a sample is missing."""
LEAST_ROWS = 50


@dataclass(frozen=True, slots=True)
class RowSteps:
    """From each sample to the next inside a segment.

    rows: (m,) index of the first sample. step_s: (m,). lost: (m,) samples missing between.
    period_s: the usual step, 0 where there is none. by_host: whether the stamps are a host's.
    uneven: whether they say only roughly when a sample was taken: a host's, or a coarse clock's.
    """

    rows: NDArray[np.intp]
    step_s: Array
    lost: NDArray[np.int64]
    period_s: float
    by_host: bool
    uneven: bool


def row_steps(samples: SampleBatch) -> RowSteps:
    """The steps of a recording and what is missing in them."""
    rows = np.flatnonzero(np.diff(samples.segment) == 0)
    step_s = np.diff(samples.ticks)[rows].astype(np.float64) * samples.tick_s
    moving = step_s[step_s > 0]
    period_s = float(np.median(moving)) if len(moving) else 0.0
    if samples.tick_s == TICK_S:
        # Half of the steps may be gaps: a few single steps tell the telemetry's period.
        single = np.abs(moving / SAMPLE_PERIOD_S - 1) < PERIOD_TOLERANCE
        if len(moving) == 0 or single.mean() > SINGLE_STEPS:
            period_s = SAMPLE_PERIOD_S
    lost = np.zeros(len(rows), np.int64)
    readings, periods = set(), []
    for own in np.unique(samples.segment[rows]):  # a radio may have gone on more slowly
        part = slice(*np.searchsorted(samples.segment[rows], [own, own + 1]))
        step = step_s[part]
        period = period_s
        reading = "exact"
        if samples.tick_s != TICK_S and (step > 0).any():
            period = float(np.median(step[step > 0]))
            reading = _reading(step, period, samples.tick_s)
        if reading != "exact":
            lost[part], period = _lost_by_count(step, period, reading == "coarse")
        elif period > 0:
            lost[part] = np.where(step > 1.5 * period, np.rint(step / period) - 1, 0)
        readings.add(reading)
        periods.append((len(step), period))
    if readings - {"exact"}:
        period_s = max(periods)[1]
    return RowSteps(rows, step_s, lost, period_s, "host" in readings, bool(readings - {"exact"}))


def on_even_grid(samples: SampleBatch) -> SampleBatch:
    """Samples with uneven stamps on the even grid on which their craft took them, none later than
    its stamp; what is missing stays missing. Others as they are."""
    steps = row_steps(samples)
    if not steps.uneven:
        return samples
    ticks = samples.ticks.copy()
    for own in np.unique(samples.segment):
        first, last = np.searchsorted(samples.segment, [own, own + 1])
        if last - first < LEAST_ROWS:
            continue
        inside = slice(*np.searchsorted(steps.rows, [first, last - 1]))
        step, lost = steps.step_s[inside], steps.lost[inside]
        place = np.concatenate([[0], np.cumsum(1 + lost)]).astype(np.float64)
        stamps = np.concatenate([[0.0], np.cumsum(step)])
        period = _slope(place, stamps)
        start = float((stamps - place * period).min())
        ticks[first:last] = ticks[first] + np.rint((start + place * period) / samples.tick_s)
    return replace(samples, ticks=ticks)


def _reading(step: Array, period: float, tick_s: float) -> str:
    """How steps (m,) of a clock are to be read: ``exact``, ``coarse`` where they are few units of
    the clock, or ``host``."""
    step = step[: 1 << 16]
    if len(step) < LEAST_ROWS or np.abs(step / period - 1).mean() < 0.02:
        return "exact"
    usual = np.clip(step, 0.0, 5.0 * np.mean(step))
    usual = usual - usual.mean()
    if not float(usual[1:] @ usual[:-1]) < CATCHES_UP * float(usual @ usual):
        return "exact"
    resolution = int(np.gcd.reduce(np.rint(step / tick_s).astype(np.int64))) * tick_s
    off = np.abs(step - np.rint(step / period) * period)
    if (off > max(UNEVEN * period, 1.01 * resolution)).mean() > UNEVEN_SHARE:
        return "host"
    if COARSE * resolution > step.mean():
        return "coarse"
    return "host" if step.mean() > BURST * period else "exact"


def _lost_by_count(step: Array, period: float, coarse: bool) -> tuple[NDArray[np.int64], float]:
    """Samples missing in each step of uneven stamps, and the period that their count gives."""
    from scipy.ndimage import minimum_filter1d

    scatter = float(np.median(np.abs(step - period)))
    if coarse or scatter > SCATTER * period or float(step.mean()) > BURST * period:
        period = _mean_step(step)
    stamps = np.concatenate([[0.0], np.cumsum(step)])
    late = stamps - period * np.arange(len(stamps))
    width = ENVELOPE_ROWS
    behind = minimum_filter1d(late, width, origin=-(width // 2), mode="nearest")
    before = minimum_filter1d(late, width, origin=width // 2, mode="nearest")
    lost = np.zeros(len(step), np.int64)
    last = 0
    for k in np.flatnonzero((step > 1.5 * period) & (behind[1:] - before[:-1] > MISSED * period)):
        earliest = late[max(last, int(k) - width + 1) : int(k) + 1].min()
        missing = int(float(behind[k + 1] - earliest) / period + 1.0 - MISSED)
        if missing > (0 if len(step) - k > LATEST_ROWS else LATEST_ROWS):
            lost[k], last = missing, int(k) + 1
    place = np.concatenate([[0], np.cumsum(1 + lost)]).astype(np.float64)
    return lost, _slope(place, stamps)


def _mean_step(step: Array) -> float:
    """A low one of the mean steps over many samples: bursts even out, and losses lengthen some."""
    stamps = np.concatenate([[0.0], np.cumsum(step)])
    width = min(len(step), 4 * ENVELOPE_ROWS)
    return float(np.quantile(stamps[width:] - stamps[:-width], 0.3)) / width


def _slope(place: Array, stamps: Array) -> float:
    """Period of the line below stamps: through the earliest of each block of samples."""
    blocks = np.array_split(np.arange(len(place)), max(2, min(50, len(place) // ENVELOPE_ROWS)))
    rough = float((stamps[-1] - stamps[0]) / max(place[-1] - place[0], 1.0))
    lowest = np.array([block[np.argmin((stamps - rough * place)[block])] for block in blocks])
    x, y = place[lowest], stamps[lowest]
    x = x - x.mean()
    return float(x @ y / (x @ x))
