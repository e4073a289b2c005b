"""The attitude of a flight on the rows on which it was new, and what the gyro says beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.read_between import angles_read_between, half_a_row_later
from groundstation.identification.runs import Run
from groundstation.prediction.drive import changed_rows, rhythm_of
from groundstation.telemetry.arrays import Array

FIRMWARE_GAIN = 0.4
"""1/s: half of the firmware's twoKp, which acts on a vector product with half of gravity."""
ACCELEROMETER_SHARE, FIRMWARE_PERIOD_S = 0.125, 0.002
"""The fusion's own filter of the accelerometer: 32/256 each 2 ms."""
LEAST_ROWS = 100


class Gaps:
    """Rows that were not received, treated alike in data and model.

    Data between known rows lie on a straight line; ``spread`` and ``bridge`` do to a model's
    differences and values what that line does to the data's.
    """

    def __init__(self, lost: NDArray[np.bool_]) -> None:
        self.lost = lost if lost.any() else None
        if self.lost is not None:
            # A row starts a group unless the row before it was lost.
            self.starts = np.flatnonzero(~np.concatenate([[False], lost[:-1]]))
            self.counts = np.diff(np.concatenate([self.starts, [len(lost)]]))

    def spread(self, differences: Array) -> Array:
        """Differences over a gap, all replaced by their mean."""
        if self.lost is None:
            return differences
        sums = np.add.reduceat(differences, self.starts, axis=0)
        return np.repeat(sums / self.counts[:, None], self.counts, axis=0)

    def bridge(self, values: Array) -> Array:
        """Values within a gap, replaced by those on the line between its neighbours."""
        if self.lost is None:
            return values
        index = np.arange(len(values), dtype=np.float64)
        known = ~self.lost
        out = values.copy()
        for column in out.T:
            column[self.lost] = np.interp(index[self.lost], index[known], column[known])
        return out


@dataclass(frozen=True, slots=True)
class AttitudeRows:
    """Everything (m, 3) unless said otherwise, one row per new attitude after the first.

    stride: rows of the run between two of them; first: the run's row of the first. told: (m,)
    whether every row of the stride was received: over a gap the angles turn by what nobody knows of
    the gyro, and a jump of that would be a hundred times their own rounding. to_euler:
    (m, 3, 3) from body to Euler rates (thesis eq. 3.11). rate: measured Euler rates. gyro: mean
    of the gyro over the stride. timing: its last row less that mean. slope: its mean slope,
    rad/s^2. lean: the rate by which a Mahony filter would turn the estimate, over its
    gain, by the accelerometer behind the fusion's own filter; lean_as_read: by that as it reads,
    which today's firmware takes.

    between: rows hold means of angles that were read half a row before and half a row after, as
    those of a radio's log. ``timing`` and ``slope`` are then such means, too: otherwise what
    is faster than any of these angles is all that counts, for there they have no noise.
    """

    stride: int
    first: int
    told: NDArray[np.bool_]
    to_euler: Array
    rate: Array
    gyro: Array
    timing: Array
    slope: Array
    lean: Array
    lean_as_read: Array
    between: bool

    def euler_rates(self, rates: Array) -> Array:
        """Euler rates (m, 3) of rates in the body."""
        return np.einsum("nij,nj->ni", self.to_euler, rates)

    def where_told(self, rates: Array) -> Array:
        """Rates (m, ...) of data or model, nothing over a gap."""
        return np.where(self.told.reshape(-1, *(1,) * (rates.ndim - 1)), rates, 0.0)


def attitude_rows(run: Run, known: NDArray[np.bool_], first: int, last: int) -> AttitudeRows | None:
    """The rows between ``first`` and ``last`` of a run without gaps; None where there are few.

    known: (n,) rows that were received.
    """
    rows = _fresh(run, known, first, last)
    if len(rows) < LEAST_ROWS:
        return None
    stride = int(rows[1] - rows[0])
    index = np.arange(len(rows), dtype=np.float64)
    there = known[rows]
    angles = np.column_stack(
        [np.interp(index, index[there], run.attitude[rows[there], i]) for i in range(3)]
    )
    ends = rows[1:]
    seconds = stride * run.period_s
    told = np.ones(len(ends), np.bool_)
    mean = np.zeros((len(ends), 3))
    for back in range(stride + 1):
        mean += (0.5 if back in (0, stride) else 1.0) / stride * run.gyro[ends - back]
        told &= known[ends - back]
    now, rate = run.gyro[ends], np.diff(angles, axis=0) / seconds
    timing, slope = now - mean, (now - run.gyro[ends - stride]) / seconds
    between = stride == 1 and angles_read_between(rate, now)
    if between:
        half = half_a_row_later(run.gyro)
        late, early, earlier = half[ends], half[ends - 1], half[np.maximum(ends - 2, 0)]
        timing, slope = 0.5 * (late + early) - mean, (late - earlier) / (2.0 * seconds)
    return AttitudeRows(
        stride,
        int(ends[0]),
        told,
        _to_euler(0.5 * (angles[1:] + angles[:-1])),
        rate,
        mean,
        timing,
        slope,
        *_leans(run, known, angles[:-1], ends),
        between,
    )


def _fresh(run: Run, known: NDArray[np.bool_], first: int, last: int) -> NDArray[np.int64]:
    """Rows with a new attitude: an even comb, its stride and phase as most changes have them."""
    received = known[first:last]
    changed = changed_rows(run.attitude[first:last])
    changed[1:] &= received[1:] & received[:-1]
    if np.count_nonzero(changed) < LEAST_ROWS:
        return np.empty(0, np.int64)
    return first + rhythm_of(changed).rows(last - first)


def _leans(
    run: Run, known: NDArray[np.bool_], before: Array, ends: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Specific force x estimated up, both of unit length: by the smoothed force, and as it is."""
    if not np.isfinite(run.accelerometer).all():
        return np.zeros((len(ends), 3)), np.zeros((len(ends), 3))
    from groundstation.identification.likelihood.kernels import first_order

    force = _shaken_across(run.accelerometer, known)
    smooth = np.empty_like(force)
    keep = (1.0 - ACCELEROMETER_SHARE) ** (run.period_s / FIRMWARE_PERIOD_S)
    first_order(force, keep, smooth)
    up = np.column_stack(
        [
            -np.sin(before[:, 1]),
            np.cos(before[:, 1]) * np.sin(before[:, 0]),
            np.cos(before[:, 1]) * np.cos(before[:, 0]),
        ]
    )

    def lean(felt: Array) -> Array:
        length = np.linalg.norm(felt, axis=1, keepdims=True)
        return np.cross(felt / np.maximum(length, 1e-9), up)

    return lean(smooth[ends]), lean(force[ends])


def _shaken_across(values: Array, known: NDArray[np.bool_]) -> Array:
    """Rows (n, 3) with lost ones between the values two rows before and two rows after.

    Rotors shake the sensor at a frequency that folds near half the row rate: a straight line
    between neighbours has the other phase.
    """
    out = np.array(values, np.float64)
    for phase in (0, 1):
        rows = np.arange(phase, len(out), 2)
        lost, there = rows[~known[rows]], rows[known[rows]]
        if len(lost) and len(there):
            for column in out.T:
                column[lost] = np.interp(lost, there, column[there])
    return out


def _to_euler(attitude: Array) -> Array:
    roll, pitch = attitude[:, 0], attitude[:, 1]
    cr, sr, cp = np.cos(roll), np.sin(roll), np.cos(pitch)
    tp = np.tan(pitch)
    out = np.zeros((len(attitude), 3, 3))
    out[:, 0, 0] = 1.0
    out[:, 0, 1], out[:, 0, 2] = sr * tp, cr * tp
    out[:, 1, 1], out[:, 1, 2] = cr, -sr
    out[:, 2, 1], out[:, 2, 2] = sr / cp, cr / cp
    return out
