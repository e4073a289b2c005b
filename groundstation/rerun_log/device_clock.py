"""One axis of device time for samples (which carry it) and for events (which carry host time).

Device time starts again when the craft restarts; a view that follows the newest data would then
show the old flight for ever. What follows a restart is therefore moved behind what came before
it, by the silence that the host measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import SampleBatch


class Clock(Protocol):
    """Times in ns on the common axis."""

    def advance(self, batch: SampleBatch) -> NDArray[np.int64]:
        """Times of the next samples, shape (n,)."""

    def at_host(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Times of the Unix times ``time_ns``, both shape (n,)."""


class LiveClock:
    """Knows what has been seen so far; before the first sample everything is at zero."""

    def __init__(self) -> None:
        self._offset_ns = 0
        self._segment: int | None = None
        self._last: tuple[int, int] | None = None

    def advance(self, batch: SampleBatch) -> NDArray[np.int64]:
        times = np.rint(batch.time_s * 1e9).astype(np.int64)
        for rows in _segments(batch):
            if self._last is not None:
                last_ns, last_host_ns = self._last
                if times[rows.start] + self._offset_ns < last_ns:
                    silence_ns = max(
                        int(batch.host_time_ns[rows.start]) - last_host_ns,
                        round(SAMPLE_PERIOD_S * 1e9),
                    )
                    self._offset_ns = last_ns + silence_ns - int(times[rows.start])
            times[rows] += self._offset_ns
            self._last = int(times[rows.stop - 1]), int(batch.host_time_ns[rows.stop - 1])
        if len(batch):
            self._segment = int(batch.segment[-1])
        return times

    def at_device(self, segment: int, time_s: NDArray[np.float64]) -> NDArray[np.int64] | None:
        """Of device times (n,) in a segment; None where it is not the one of the newest sample."""
        if segment != self._segment:
            return None
        return np.rint(time_s * 1e9).astype(np.int64) + self._offset_ns

    def at_host(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        if self._last is None:
            return np.zeros_like(time_ns)
        last_ns, last_host_ns = self._last
        return time_ns - last_host_ns + last_ns


class RecordedClock:
    """Knows all samples of a recording from the start, so that events fall between them."""

    def __init__(self, samples: SampleBatch) -> None:
        self._times = LiveClock().advance(samples)
        self._hosts = np.maximum.accumulate(samples.host_time_ns)
        self._next = 0

    def advance(self, batch: SampleBatch) -> NDArray[np.int64]:
        self._next += len(batch)
        return self._times[self._next - len(batch) : self._next]

    def at_host(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        if not len(self._times):
            return time_ns - time_ns[:1]
        before = np.searchsorted(self._hosts, time_ns, side="right") - 1
        nearest = np.clip(before, 0, None)
        return self._times[nearest] + time_ns - self._hosts[nearest]


def _segments(batch: SampleBatch) -> Iterator[slice]:
    """Stretches of uninterrupted device time."""
    edges = np.flatnonzero(np.diff(batch.segment)) + 1
    bounds = [0, *edges.tolist(), len(batch)] if len(batch) else []
    for start, stop in pairwise(bounds):
        yield slice(start, stop)
