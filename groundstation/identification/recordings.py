"""Recordings as the search wants them: whole flights on an even grid, lost rows as NaN.

Identification cuts a recording at every gap. A radio that loses two rows in a hundred would leave
it nothing; here short gaps become rows without values, and only long silences and restarts end
a run.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.identification.runs import (
    CHANNELS,
    FASTEST_HZ,
    SLOWEST_HZ,
    Run,
    TooShortError,
    run_of,
    uninterrupted,
    with_possible_duty,
    with_readings,
)
from groundstation.telemetry.samples import (
    HELD,
    SETTINGS_HZ,
    SampleBatch,
    filled,
    on_even_grid,
    renewals,
    slower_than_rows,
    spans,
)

LONGEST_GAP_S = 0.1
"""A longer silence ends a run: the motors' inputs are no longer known."""
ESSENTIAL = ("duty", "accelerometer")
"""Channels whose longer silences end a run, where they read elsewhere; the gyro's any does."""
LEAST_S = 5.0
SOURCES = {
    "duty": "what the motors are set to",
    "gyro": "the gyro",
}
"""Fields that the fits need in every row, in words."""


def flights_of(samples: SampleBatch, name: str = "", least_s: float = LEAST_S) -> list[Run]:
    """The runs of a recording that last at least ``least_s``, rows lost in between being NaN.

    A row whose gyro does not read counts as lost, and so does one with an impossible duty. Rows
    that a host stamped stand where their craft took them; of rows that repeat what a slower source
    said, those are taken that renew it.

    Raises TooShortError where no run is long enough, BadInputError where the rate is not one of
    inertial telemetry.
    """
    label = name or "recording"
    possible = with_readings(with_possible_duty(samples, label), ESSENTIAL, LONGEST_GAP_S)
    whole = renewed(on_even_grid(possible), label)
    read: NDArray[np.bool_] = np.asarray(np.isfinite(whole.gyro).all(axis=1))
    if read.any() and not read.all():
        whole = whole[read]
    return [
        _on_grid(whole[rows], label, float(samples.time_s[0]))
        for rows in uninterrupted(whole, label, least_s, _silent)
    ]


def renewed(samples: SampleBatch, label: str) -> SampleBatch:
    """The rows in which the slower of gyro and motors is renewed, where rows come faster than it.

    What acted between two of them is then as unknown as in a recording of that rate, and counts as
    much. Rotor speeds that were measured drive a flight in place of the motors' settings, and
    how long they are held is part of their own noise (``speed_noise``).

    Raises BadInputError where it is renewed too seldom for inertial telemetry.
    """
    slowest, hold = _slowest(samples)
    if hold <= HELD:
        return samples
    usual_s = float(np.median(np.diff(samples.time_s)))
    hz = 1.0 / (hold * usual_s)
    if hz >= SETTINGS_HZ:
        return samples
    if hz < SLOWEST_HZ <= 1.0 / usual_s:
        raise BadInputError(
            f"{label}: {SOURCES[slowest]} is renewed {hz:.3g} times a second in"
            f" {1 / usual_s:.3g} rows a second; {SLOWEST_HZ:.0f} to {FASTEST_HZ:.0f} are needed:"
            " log it as often as the rows (PX4: SDLOG_PROFILE)"
        )
    new = renewals(getattr(samples, slowest))
    between = np.diff(new, append=len(samples))
    each = np.maximum(np.rint(between / hold), 1).astype(np.intp)  # also while it rests
    share = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    rows = np.repeat(new, each) + np.rint(share * np.repeat(between / each, each)).astype(np.intp)
    return samples[rows]


def renewal_notes(samples: SampleBatch, name: str) -> list[str]:
    """What to say of a recording of which only some rows are taken, because they renew a slow
    channel."""
    slowest, hold = _slowest(samples)
    usual_s = float(np.median(np.diff(samples.time_s))) if len(samples) > 1 else 0.0
    if hold <= HELD or 1.0 / (hold * usual_s) >= SETTINGS_HZ:
        return []
    return [
        f"{name}: {SOURCES[slowest]} is renewed {1 / (hold * usual_s):.3g} times a second in"
        f" {1 / usual_s:.3g} rows a second: only the rows that renew it are used"
    ]


def _slowest(samples: SampleBatch) -> tuple[str, float]:
    """The slower of gyro and, where no speeds were measured, motors' settings, and how many rows
    its values stand."""
    speeds = np.isfinite(samples.rotor_rev_s).any(axis=0).all()
    names = ["gyro"] if speeds else list(SOURCES)
    found = {name: slower_than_rows(renewals(getattr(samples, name))) for name in names}
    return max(found.items(), key=lambda one: one[1])


def flights_of_each(
    recordings: Iterable[tuple[SampleBatch, str]],
) -> tuple[list[list[Run]], list[str]]:
    """The runs of recordings, each with its name: none where nothing lasts, which is told in words.

    Raises TooShortError where nothing lasts in any, and BadInputError as ``flights_of`` does.
    """
    found: list[list[Run]] = []
    short: list[TooShortError] = []
    for samples, name in recordings:
        try:
            found.append(flights_of(samples, name))
        except TooShortError as error:
            found.append([])
            short.append(error)
    if short and not any(found):
        raise short[0]
    return found, [f"left out: {error}" for error in short]


def _silent(steps: NDArray[np.float64], usual_s: float) -> NDArray[np.bool_]:
    return (steps > LONGEST_GAP_S) | (steps < 0)


def _on_grid(samples: SampleBatch, label: str, recording_start_s: float) -> Run:
    """Rows on a grid whose period is the mean over steps without a gap."""
    time = samples.time_s
    steps = np.diff(time)
    whole = np.rint(steps / float(np.median(steps)))
    place = np.concatenate([[0], np.cumsum(np.maximum(whole, 1.0))]).astype(np.int64)
    period = float((time[-1] - time[0]) / place[-1])
    count = int(place[-1]) + 1

    def grid(values: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.full((count, *values.shape[1:]), np.nan)
        out[place] = np.where(np.isfinite(values), values, np.nan)
        return out

    attitude = _unwrapped(samples.attitude.astype(np.float64))
    return run_of(samples, attitude, label, period, recording_start_s, grid)


def _unwrapped(attitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (n, 3) without jumps of a turn, across rows that do not read as well."""
    out = attitude.copy()
    known = np.isfinite(attitude).all(axis=1)
    out[known] = np.unwrap(attitude[known], axis=0)
    return out


def bridged(samples: SampleBatch, name: str = "", least_s: float = LEAST_S) -> list[Run]:
    """The same with short gaps bridged on straight lines, for what a radio's losses would cut to
    pieces."""
    return [without_gaps(run) for run in flights_of(samples, name, least_s)]


def without_gaps(run: Run) -> Run:
    """The run with its missing rows filled in, for what needs every row.

    Measured speeds drive the rotors: silences longer than ``LONGEST_GAP_S`` are not filled.
    """
    parts: dict[str, Any] = {name: filled(getattr(run, name)) for name in CHANNELS}
    for rotor, silent in enumerate(~np.isfinite(run.rotor_rev_s.T)):
        for first, last in spans(silent):
            if (last - first) * run.period_s > LONGEST_GAP_S:
                parts["rotor_rev_s"][first:last, rotor] = np.nan
    return replace(run, **parts)
