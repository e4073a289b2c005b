"""Runs: uninterrupted stretches of a recording on an even time grid.

Every estimate works on runs, so that a gap, a restart or another sample rate can never be read
as motion. A run may be cut further: by hand, or into what is fitted and what is held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.spans import spans
from groundstation.telemetry.samples import SampleBatch

Array = NDArray[np.float64]

STEP_TOLERANCE = 0.5
"""A step that differs from the usual one by more than this share of it ends a run."""
FASTEST_HZ, SLOWEST_HZ = 2000.0, 50.0


@dataclass(frozen=True, slots=True)
class Run:
    """One stretch, rows a constant ``period_s`` apart.

    duty: (n, 4), 0..1, acted from the row before to this one. supply_v: (n,) as reported.
    gyro: (n, 3) rad/s. accelerometer: (n, 3) m/s^2. attitude: (n, 3) rad.
    rotor_rev_s: (n, 4) measured speeds. debug_s: (n,) half a rotor revolution on the motor bench,
    in seconds. start_s: device time of the first row; recording_start_s: of the recording's. A
    channel that is not there is NaN.
    """

    name: str
    start_s: float
    period_s: float
    duty: Array
    supply_v: Array
    gyro: Array
    accelerometer: Array
    attitude: Array
    rotor_rev_s: Array
    debug_s: Array
    recording_start_s: float = 0.0

    def __len__(self) -> int:
        return len(self.duty)

    @property
    def seconds(self) -> float:
        return len(self) * self.period_s

    @property
    def time_s(self) -> Array:
        """Device time, (n,)."""
        return np.asarray(self.start_s + self.period_s * np.arange(len(self)), np.float64)

    def __getitem__(self, rows: slice) -> Run:
        """Some consecutive rows as a run of its own."""
        first, last, step = rows.indices(len(self))
        if step != 1 or last <= first:
            raise ValueError(f"run {self.name}: a part needs consecutive rows, not {rows}")
        parts = {name: getattr(self, name)[first:last] for name in CHANNELS}
        return replace(self, start_s=self.start_s + first * self.period_s, **parts)


SCALARS = ("name", "start_s", "period_s", "recording_start_s")
CHANNELS = tuple(f.name for f in fields(Run) if f.name not in SCALARS)


def runs_of(samples: SampleBatch, name: str = "", least_s: float = 1.0) -> list[Run]:
    """The runs of a recording that last at least ``least_s`` seconds, in order of time.

    Raises BadInputError where none does, or where the rate is not one of inertial telemetry.
    """
    label = name or "recording"
    if len(samples) < 3:
        raise BadInputError(f"{label}: {len(samples)} samples are too few; record a flight")
    time = samples.time_s
    steps = np.diff(time)
    usual = float(np.median(steps))
    if not 1 / FASTEST_HZ <= usual <= 1 / SLOWEST_HZ:
        raise BadInputError(
            f"{label}: a sample every {usual * 1e3:.3g} ms; identification needs"
            f" {SLOWEST_HZ:.0f} to {FASTEST_HZ:.0f} samples a second"
        )
    broken = np.abs(steps - usual) > STEP_TOLERANCE * usual
    broken |= np.diff(samples.segment) != 0
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(samples)]])
    longest = int(np.diff(edges).max())
    columns: dict[str, NDArray[np.floating]] = {
        "duty": samples.duty,
        "supply_v": samples.battery_v,
        "gyro": samples.gyro,
        "accelerometer": samples.accelerometer,
        "attitude": np.unwrap(samples.attitude.astype(np.float64), axis=0),
        "rotor_rev_s": samples.rotor_rev_s,
        "debug_s": samples.debug * samples.tick_s,
    }
    runs = []
    for first, last in pairwise(edges):
        if (last - first) * usual < least_s:
            continue
        period = float((time[last - 1] - time[first]) / (last - first - 1))
        parts = {key: np.asarray(values[first:last], np.float64) for key, values in columns.items()}
        start = float(time[first])
        runs.append(Run(label, start, period, **parts, recording_start_s=float(time[0])))
    if not runs:
        raise BadInputError(
            f"{label}: the longest uninterrupted stretch lasts {longest * usual:.2f} s, at least"
            f" {least_s:.1f} s are needed; record longer or improve the link"
        )
    return runs


def hold_out(runs: Sequence[Run], share: float = 1 / 3) -> tuple[list[Run], list[Run]]:
    """(to fit on, to validate on): the last ``share`` of all rows, cutting a run where needed."""
    rows = sum(len(run) for run in runs)
    left = round(rows * (1 - share))
    fit: list[Run] = []
    held: list[Run] = []
    for run in runs:
        if left >= len(run):
            fit.append(run)
        elif left <= 0:
            held.append(run)
        else:
            fit.append(run[:left])
            held.append(run[left:])
        left -= len(run)
    return fit, held


def flying(run: Run, least_s: float = 2.0) -> list[Run]:
    """The stretches of a run in which all motors turn: no take-off from standstill, no rest.

    A motor counts as turning above 10 % duty. Shorter stretches than ``least_s`` are left out.
    """
    turning = (run.duty > 0.1).all(axis=1)
    return [run[a:b] for a, b in spans(turning) if (b - a) * run.period_s >= least_s]
