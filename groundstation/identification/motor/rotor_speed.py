"""Rotor speed as sensors show it: the bench's optical gate (thesis 7.2.2), a deck in flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.identification.runs import Run
from groundstation.telemetry.arrays import Array

WINDOW = 11
"""Fresh readings around each one that it is compared with."""
TOLERANCE = 0.10
"""A reading that differs from the median around it by more than this share is a glitch."""
LONGEST_PERIOD_S = 0.1
"""Half a revolution slower than this (5 rev/s) is a rotor that stands."""
LEAST_FRESH = 0.2
"""Share of rows with a new reading from which a sensor works: one that reads once a revolution
renews every second row at 250 rev/s."""
FEWEST_BLADES, MOST_BLADES = 0.6, 1.7
"""A sensor off by more than this from what the others show at their voltages counts passages
wrongly: rotors that fly one craft differ by some percent, a missed blade is a factor of two."""


@dataclass(frozen=True, slots=True)
class GateReading:
    """Speeds behind a run's gate.

    rev_s: (n,), NaN in rows without a fresh, credible reading. Each is the mean speed of the half
    revolution whose middle lies ``age_s`` (n,) before the row, give or take ``jitter_s`` (n,;
    standard deviation).
    glitches: share of the fresh readings that were rejected; rejected: (n,) these rows.
    """

    rev_s: Array
    age_s: Array
    jitter_s: Array
    glitches: float
    rejected: NDArray[np.bool_]


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
            " the motor bench, or on one with measured rotor speed; without either, give 'fit body'"
            " the profile's motors"
        )
    credible = _credible(period[rows])
    speed, age, jitter = np.full(len(run), np.nan), np.zeros(len(run)), np.zeros(len(run))
    kept = rows[credible]
    window = np.minimum(period[kept], run.period_s)
    speed[kept] = 0.5 / period[kept]
    age[kept] = 0.5 * period[kept] + 0.5 * window
    jitter[kept] = window / np.sqrt(12)
    rejected = np.zeros(len(run), np.bool_)
    rejected[rows[~credible]] = True
    return GateReading(speed, age, jitter, float(1 - credible.mean()), rejected)


@dataclass(frozen=True, slots=True)
class RotorReadings:
    """Speeds (n, 4) rev/s of a run's rotors in flight, NaN where there is no new, credible
    reading; all NaN for a sensor that is left out, which ``left_out`` says in words."""

    rev_s: Array
    left_out: tuple[str, ...]


def rotor_readings(run: Run) -> RotorReadings:
    """New, credible readings of the rotor-speed sensors, and which sensors do not work.

    A reading that repeats the one before is none: the rotor has not passed the sensor since.
    """
    shown = run.rotor_rev_s
    fresh = np.isfinite(shown) & (shown > 0.5 / LONGEST_PERIOD_S)
    fresh[1:] &= shown[1:] != shown[:-1]
    found, left_out = np.full_like(shown, np.nan), []
    for rotor in range(4):
        rows = np.flatnonzero(fresh[:, rotor])
        if len(rows) < max(LEAST_FRESH * len(run), WINDOW):
            said = _silence(shown[:, rotor])
            left_out.append(f"rotor {rotor + 1}: its sensor {said} of {run.name}: left out")
            continue
        kept = rows[_credible(shown[rows, rotor])]
        found[kept, rotor] = shown[kept, rotor]
    working = np.flatnonzero(np.isfinite(found).any(axis=0))
    if len(working) > 2:
        each = np.nanmedian(found[:, working], axis=0) / np.nanmean(run.duty[:, working], axis=0)
        for place, share in zip(working, each / np.median(each), strict=True):
            rotor = int(place)
            if not FEWEST_BLADES < share < MOST_BLADES:
                found[:, rotor] = np.nan
                left_out.append(
                    f"rotor {rotor + 1}: its sensor shows {share:.2f} of what the others show at"
                    f" the same duty in {run.name}: left out"
                )
    return RotorReadings(found, tuple(left_out))


def _silence(shown: Array) -> str:
    """What a sensor shows that does not work, and in how many of the rows."""
    missing, stands = np.isnan(shown), shown <= 0.5 / LONGEST_PERIOD_S
    if missing.mean() > 0.5:
        return f"shows nothing in {100 * missing.mean():.0f} % of the rows"
    if stands.mean() > 0.5:
        return f"shows a rotor that stands in {100 * stands.mean():.0f} % of the rows"
    same = np.concatenate([[False], shown[1:] == shown[:-1]])
    return f"repeats its last value in {100 * same.mean():.0f} % of the rows"


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
