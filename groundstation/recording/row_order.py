"""Rows of a file in the order in which they were measured: counters that wrapped unwrapped, rows
that were overtaken put where they belong, copies left out, restarts told from all of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.samples import COLUMNS, SampleBatch

ROWS_METADATA = "rows"
"""Metadata record of what became of a file's rows: ``RowOrder.notes``."""
WRAPS_S = tuple(2**bits * unit_s for bits in (32, 24) for unit_s in (1e-3, 1e-6))
"""Full turns of the counters that loggers use: ms and us in 32 and 24 bits."""
WRAPPED_WITHIN_S = 1.0
"""A counter that wrapped goes on within so much of its full turn."""
OVERTAKEN_ROWS, OVERTAKEN_S = 64, 1.0
"""A clock that goes back further, or for longer, has restarted."""
CLOCK = ("ticks", "host_time_ns", "segment", "copies")
"""Columns of a batch that say when a row came, and not what was measured."""
APART = 0.1
"""Usual steps by which a row that was overtaken keeps away from its neighbours: it fits where it is
missing, a restart runs over what is there."""


@dataclass(frozen=True, slots=True)
class RowOrder:
    """What became of a file's rows.

    rows: (m,) places of the rows that are kept, in order of time; None: all as they stand.
    ticks, segment, copies: (m,). wraps, overtaken, left_out: how many.
    """

    rows: NDArray[np.intp] | None
    ticks: NDArray[np.int64]
    segment: NDArray[np.int32]
    copies: NDArray[np.uint8]
    wraps: int = 0
    overtaken: int = 0
    left_out: int = 0

    @property
    def notes(self) -> dict[str, str]:
        """The counts that are not zero, for a recording's metadata."""
        counts = {"wraps": self.wraps, "out_of_order": self.overtaken, "copies": self.left_out}
        return {name: str(count) for name, count in counts.items() if count}

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """A column (n, ...) of the file in this order."""
        return values if self.rows is None else values[self.rows]


def order_of(ticks: NDArray[np.int64], tick_s: float, columns: Sequence[NDArray[Any]]) -> RowOrder:
    """The order of rows whose clock reads ``ticks`` (n,) of ``tick_s``.

    columns: every other (n, ...) of the file that was read: rows of one time that are equal in all
    of them are copies.
    """
    ticks, wraps = _unwrapped(ticks, tick_s)
    steps = np.diff(ticks)
    if (steps > 0).all():
        plain = np.zeros(len(ticks), np.int32), np.ones(len(ticks), np.uint8)
        return RowOrder(None, ticks, *plain, wraps)
    stands_for = _copied(ticks, bool((steps < 0).any()), columns)
    copied = stands_for != np.arange(len(ticks))
    segment, overtaken = _segments(ticks, copied, tick_s)
    copied &= segment[stands_for] == segment  # alike before and behind a restart: by chance
    stands_for = np.where(copied, stands_for, np.arange(len(ticks)))
    rows = np.flatnonzero(~copied)
    copies = np.bincount(stands_for, minlength=len(ticks))[rows].clip(0, 255).astype(np.uint8)
    if overtaken:
        by_time = np.lexsort((ticks[rows], segment[rows]))
        rows, copies = rows[by_time], copies[by_time]
    left_out = int(copied.sum())
    kept = rows if overtaken or left_out else None
    return RowOrder(kept, ticks[rows], segment[rows], copies, wraps, overtaken, left_out)


def in_order(
    samples: SampleBatch, beside: Sequence[NDArray[Any]] = ()
) -> tuple[SampleBatch, RowOrder]:
    """A batch as a file has it in the order of its clock. beside: columns (n, ...) of the file that
    are no channels."""
    channels = [getattr(samples, name) for name in COLUMNS if name not in CLOCK]
    order = order_of(samples.ticks, samples.tick_s, [*channels, *beside])
    if order.rows is not None:
        samples = samples[order.rows]
    samples.ticks[:] = order.ticks
    samples.segment[:] = order.segment
    samples.copies[:] = order.copies
    return samples, order


def _unwrapped(ticks: NDArray[np.int64], tick_s: float) -> tuple[NDArray[np.int64], int]:
    """Ticks (n,) without the jumps of a counter that came round, and how often it did."""
    steps = np.diff(ticks)
    near = WRAPPED_WITHIN_S / tick_s
    jumps = np.flatnonzero(np.abs(steps) > min(WRAPS_S) / tick_s - near)
    added = np.zeros(len(ticks), np.int64)
    for turn in (round(turn_s / tick_s) for turn_s in WRAPS_S):
        low = np.minimum(ticks[jumps], ticks[jumps + 1])
        high = np.maximum(ticks[jumps], ticks[jumps + 1])
        here = jumps[(low >= 0) & (low <= near) & (high < turn) & (turn - high <= near)]
        added[here + 1] = -np.sign(steps[here]) * turn
    turned = 0
    for row in np.flatnonzero(added):
        if turned + added[row] < 0:  # nothing came round before: a pause of nearly a turn
            added[row] = 0
        turned += int(added[row])
    return (ticks + np.cumsum(added), int(np.sign(added).sum())) if len(jumps) else (ticks, 0)


def _copied(
    ticks: NDArray[np.int64], falls: bool, columns: Sequence[NDArray[Any]]
) -> NDArray[np.intp]:
    """The first of the rows that each row (n,) is a copy of; itself where it is none."""
    order = np.argsort(ticks, kind="stable") if falls else np.arange(len(ticks))
    again = np.flatnonzero(np.diff(ticks[order]) == 0) + 1
    for column in columns:
        one, other = column[order[again]], column[order[again - 1]]
        same = (one == other) | ((one != one) & (other != other))
        again = again[same if same.ndim == 1 else same.all(axis=1)]
    first = np.arange(len(ticks))
    first[again] = 0
    found = np.empty(len(ticks), np.intp)
    found[order] = order[np.maximum.accumulate(first)]
    return found


def _segments(
    ticks: NDArray[np.int64], copied: NDArray[np.bool_], tick_s: float
) -> tuple[NDArray[np.int32], int]:
    """Segment (n,) of each row, and how many rows were overtaken by later ones. copied: (n,)."""
    steps = np.diff(ticks)
    falls = np.flatnonzero(steps < 0) + 1
    segment = np.zeros(len(ticks), np.int32)
    if not len(falls):
        return segment, 0
    rising = steps[steps > 0]
    usual = float(np.median(rising)) if len(rising) else 0.0
    restarts: list[int] = []
    overtaken, start, placed = 0, 0, 0
    for row in map(int, falls):
        if row < placed:
            continue  # among rows that have their place already
        before = ticks[max(start, row - 4 * OVERTAKEN_ROWS) : row]
        top = int(before.max())
        until = min(row + OVERTAKEN_ROWS, len(ticks))
        ahead = np.flatnonzero(ticks[row:until] > top)
        end = row + int(ahead[0]) if len(ahead) else until
        late = ticks[row:end][~copied[row:end]]
        ends = len(ahead) > 0 or until == len(ticks)
        near = not len(late) or (top - int(late.min())) * tick_s <= OVERTAKEN_S
        if ends and near and _fits(late, before, usual):
            overtaken += len(late)
            placed = end
        else:
            restarts.append(row)
            start = row
    segment[restarts] = 1
    return np.cumsum(segment, dtype=np.int32), overtaken


def _fits(late: NDArray[np.int64], around: NDArray[np.int64], usual: float) -> bool:
    """Whether late rows fill holes between the others; what is earlier than all may be as many
    usual steps ahead of them as there are rows."""
    if not len(late):
        return True
    others = np.sort(around)
    if late.min() < others[0] - 2 * usual * len(late):
        return False
    place = np.searchsorted(others, late)
    below = late - others[np.maximum(place - 1, 0)]
    above = others[np.minimum(place, len(others) - 1)] - late
    far = np.iinfo(np.int64).max
    below, above = np.where(place > 0, below, far), np.where(place < len(others), above, far)
    fits = np.minimum(below, above) >= APART * usual
    return bool(fits.all() and (np.diff(np.sort(late)) > 0).all())
