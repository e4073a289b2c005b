"""Samples of a live stream on an even grid, as many as the twin still needs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from groundstation.errors import BadInputError
from groundstation.identification.runs import (
    FASTEST_HZ,
    LONGEST_GAP_S,
    SupplyAnswer,
    at_the_rows_voltage,
    both_settings,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import SampleBatch, filled

SLOWEST_HZ = 200.0
"""Slower telemetry has too few rows in half a second to be judged."""
RHYTHM_ROWS = 50
"""Samples from which the period is told."""
WIDTH = 18
DUTY, SUPPLY, STEP = slice(0, 4), 4, slice(14, 18)
INPUTS = (0, 1, 2, 3, 4, 14, 15, 16, 17)
"""Columns that are known between their neighbours: duty, supply and the step of the duty."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Consecutive rows (``prediction.prediction.Flown``). Inputs of lost rows are on the line
    between their neighbours; what a lost row would have measured is NaN.

    duty, duty_step: (n, 4), supply_v: (n,), gyro, accelerometer, attitude: (n, 3), SI.
    """

    period_s: float
    duty: Array
    supply_v: Array
    gyro: Array
    accelerometer: Array
    attitude: Array
    duty_step: Array

    @property
    def settings(self) -> Array:
        """As of ``identification.runs.Run``."""
        return both_settings(self.duty, self.duty_step)

    def since(self, row: int) -> Piece:
        """The same from a row on."""
        return Piece(
            self.period_s,
            self.duty[row:],
            self.supply_v[row:],
            self.gyro[row:],
            self.accelerometer[row:],
            self.attitude[row:],
            self.duty_step[row:],
        )


class Rows:
    """One uninterrupted stretch of a stream, numbered from its first row.

    period_s: of a row. count: rows so far. Only rows from ``first`` on are kept.
    """

    def __init__(self, period_s: float, tick_s: float) -> None:
        self.period_s = period_s
        self.first = self.count = 0
        self._tick_s = tick_s
        self._answer = SupplyAnswer()
        self._table = np.empty((0, WIDTH))
        self._time_s = np.empty(0)
        self._host_ns = np.empty(0, np.int64)

    def append(self, samples: SampleBatch) -> None:
        """Samples without a break (``unbroken``) between them or before them."""
        time_s = samples.ticks * self._tick_s
        before = self._time_s[-1] if len(self._time_s) else time_s[0] - self.period_s
        steps = np.maximum(np.rint(np.diff(time_s, prepend=before) / self.period_s), 1.0)
        place = np.cumsum(steps).astype(np.int64) - 1
        rows = int(place[-1]) + 1
        new = np.full((rows, WIDTH), np.nan)
        new[place] = np.column_stack(
            [
                samples.duty,
                samples.battery_v,
                samples.gyro,
                samples.accelerometer,
                samples.attitude,
                samples.duty_step,
            ]
        )
        inputs = new[:, DUTY], new[:, STEP], new[:, SUPPLY]
        new[:, DUTY], new[:, STEP] = at_the_rows_voltage(*inputs, self._answer.learn(*inputs))
        # With the row before, so that what is lost first lies between two neighbours.
        start = max(len(self._table) - 1, 0)
        self._table = np.concatenate([self._table, new])
        self._table[start:, INPUTS] = filled(self._table[start:, INPUTS])
        self._time_s = np.concatenate([self._time_s, np.interp(np.arange(rows), place, time_s)])
        hosts = np.interp(np.arange(rows), place, samples.host_time_ns - samples.host_time_ns[0])
        self._host_ns = np.concatenate(
            [self._host_ns, samples.host_time_ns[0] + hosts.astype(np.int64)]
        )
        self.count += rows

    def forget(self, before: int) -> None:
        """Rows before this one are not needed any more."""
        drop = max(before - self.first, 0)
        self._table = self._table[drop:]
        self._time_s, self._host_ns = self._time_s[drop:], self._host_ns[drop:]
        self.first += drop

    def piece(self, first: int, last: int) -> Piece:
        """Rows ``first`` to ``last`` (exclusive)."""
        part = self._table[first - self.first : last - self.first]
        return Piece(
            self.period_s,
            np.ascontiguousarray(part[:, :4]),
            np.ascontiguousarray(part[:, 4]),
            np.ascontiguousarray(part[:, 5:8]),
            np.ascontiguousarray(part[:, 8:11]),
            np.ascontiguousarray(part[:, 11:14]),
            np.ascontiguousarray(part[:, 14:18]),
        )

    def time_s(self, first: int, last: int) -> Array:
        """Device time of rows."""
        return self._time_s[first - self.first : last - self.first]

    def host_ns(self, row: int) -> int:
        """Unix time at which a row arrived."""
        return int(self._host_ns[row - self.first])


def period_of(samples: SampleBatch) -> float:
    """Seconds from row to row. Raises BadInputError for a rate that is not inertial telemetry's."""
    usual = float(np.median(np.diff(samples.time_s)))
    if abs(usual / SAMPLE_PERIOD_S - 1.0) < 2e-3:  # the tick is coarser than the crystal
        return SAMPLE_PERIOD_S
    if not 1 / FASTEST_HZ <= usual <= 1 / SLOWEST_HZ:
        raise BadInputError(
            f"a sample every {usual * 1e3:.3g} ms; the twin needs"
            f" {SLOWEST_HZ:.0f} to {FASTEST_HZ:.0f} samples a second"
        )
    return usual


def unbroken(
    samples: SampleBatch, before: SampleBatch | None
) -> Iterator[tuple[bool, SampleBatch]]:
    """(whether it begins anew, samples) for each part without a restart or a long silence.

    before: the last sample of what came before.
    """
    joined = samples if before is None else SampleBatch.concatenate([before, samples])
    steps = np.diff(joined.time_s)
    broken = (steps > LONGEST_GAP_S) | (steps <= 0) | (np.diff(joined.segment) != 0)
    offset = 0 if before is None else 1
    cuts = np.flatnonzero(broken) + 1 - offset
    edges = [0, *(int(cut) for cut in cuts if cut > 0), len(samples)]
    new = before is None or bool(len(cuts) and cuts[0] == 0)
    for first, last in pairwise(edges):
        yield new, samples[first:last]
        new = True
