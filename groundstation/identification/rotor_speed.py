"""Rotor speed from the optical gate's half-revolution periods (thesis 7.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.identification.runs import Run

Array = NDArray[np.float64]

WINDOW = 11
"""Fresh readings around each one that it is compared with."""
TOLERANCE = 0.10
"""A reading that differs from the median around it by more than this share is a glitch."""
LONGEST_PERIOD_S = 0.1
"""Half a revolution slower than this (5 rev/s) is a rotor that stands."""


@dataclass(frozen=True, slots=True)
class GateReading:
    """Speeds behind a run's gate.

    rev_s: (n,), NaN in rows without a fresh, credible reading. Each is the mean speed of the half
    revolution whose middle lies ``age_s`` (n,) before the row, give or take ``jitter_s`` (n,;
    standard deviation).
    glitches: share of the fresh readings that were rejected.
    """

    rev_s: Array
    age_s: Array
    jitter_s: Array
    glitches: float


def speed_from_gate(run: Run) -> GateReading:
    """Speeds from the times between blade passages, without the gate's glitches.

    A missed passage doubles a period, a bounce cuts it: both differ from the readings around
    them, which a rotor's inertia keeps together. The passage that ended a period lay, on
    average, half a row (or half a period, where shorter) before the row that first shows it.

    Raises BadInputError where the rotor never turned.
    """
    period = run.debug_s
    fresh = np.concatenate([[False], np.diff(period) != 0])
    # An unchanged value is a new passage too, where the rotor is fast enough for one each row.
    fresh |= (period > 0) & (period <= run.period_s)
    fresh &= (period > 0) & (period < LONGEST_PERIOD_S)
    rows = np.flatnonzero(fresh)
    if len(rows) < WINDOW:
        raise BadInputError(
            f"{run.name}: the debug field holds no rotor periods; fit the motor on a recording of"
            " the motor bench, or on one with measured rotor speed"
        )
    credible = _credible(period[rows])
    speed, age, jitter = np.full(len(run), np.nan), np.zeros(len(run)), np.zeros(len(run))
    kept = rows[credible]
    window = np.minimum(period[kept], run.period_s)
    speed[kept] = 0.5 / period[kept]
    age[kept] = 0.5 * period[kept] + 0.5 * window
    jitter[kept] = window / np.sqrt(12)
    return GateReading(speed, age, jitter, float(1 - credible.mean()))


def _credible(period: Array) -> NDArray[np.bool_]:
    """Which readings agree with the median of those around them (twice: glitches come in pairs)."""
    good = np.ones(len(period), bool)
    for _ in range(2):
        values = period[good]
        half = min(WINDOW // 2, (len(values) - 1) // 2)
        padded = np.pad(values, half, mode="reflect")
        around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
        places = np.flatnonzero(good)
        good[places[np.abs(values / around - 1) > TOLERANCE]] = False
    return good
