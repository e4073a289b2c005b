"""A recorded session as a link: the same packets, with their timing, at any speed."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from groundstation.clock import HostClock
from groundstation.errors import BadInputError, LinkEndedError
from groundstation.links.base import Link, LinkBatch
from groundstation.recording.open_recording import open_recording
from groundstation.telemetry.samples import RawBatch, SampleBatch

BATCH_S = 0.02
"""Span of one batch at normal speed."""
FAST_PACKETS = 4096
"""Size of a batch when replaying as fast as possible."""
FAST = float("inf")


class ReplayLink(Link):
    """Delivers the raw packets of a recording; where it has none (microSD), its samples.

    speed: 1 for real time, 2 for twice as fast, ``FAST`` for as fast as the reader takes them.
    Host stamps keep the recorded spacing whatever the speed and are moved by one constant, so
    that the first is the moment of opening: what is recorded again has the same intervals.
    """

    def __init__(self, path: Path, *, speed: float = 1.0, clock: HostClock | None = None) -> None:
        super().__init__(f"replay:{path}", clock=clock)
        if not speed > 0:
            raise BadInputError(f"replay speed {speed:g}: must be greater than 0 (or 'max')")
        self.path = path
        self.speed = speed
        self.silence_s = 0.5
        self._source: RawBatch | SampleBatch | None = None
        self._at = 0
        self._started_s = 0.0

    async def _open(self) -> None:
        recording = await asyncio.to_thread(open_recording, self.path, raw=True)
        source: RawBatch | SampleBatch | None = recording.raw
        if source is None or len(source) == 0:
            source = recording.samples
        if len(source) == 0:
            raise BadInputError(f"{self.path} holds no telemetry to replay")
        for line in recording.damage:
            self.emit("damage", f"{self.path}: {line}")
        if len(recording.samples):
            self.start_ticks = int(recording.samples.ticks[0])
        shift = self.clock() - int(source.host_time_ns[0])
        self._source = replace(source, host_time_ns=source.host_time_ns + shift)
        self._at = 0
        self._started_s = time.monotonic()

    async def _read(self) -> LinkBatch:
        source = self._source
        if source is None or self._at >= len(source):
            raise LinkEndedError(f"the end of {self.path}")
        stamps = source.host_time_ns
        if self.speed == FAST:
            await asyncio.sleep(0)
            end = min(self._at + FAST_PACKETS, len(source))
        else:
            due_s = (int(stamps[self._at] - stamps[0]) * 1e-9) / self.speed
            wait_s = self._started_s + due_s + BATCH_S - time.monotonic()
            await asyncio.sleep(max(0.0, wait_s))
            passed_ns = (time.monotonic() - self._started_s) * self.speed * 1e9
            end = int(np.searchsorted(stamps, stamps[0] + int(passed_ns), side="right"))
            end = min(max(end, self._at + 1), self._at + FAST_PACKETS)
        rows = slice(self._at, end)
        self._at = end
        if isinstance(source, SampleBatch):
            return source[rows]
        return RawBatch(source.packets[rows], stamps[rows])

    async def _close(self) -> None:
        self._source = None

    def now_ns(self) -> int:
        """Stamps keep their spacing at any speed: so must the time that has passed since."""
        if self._source is None or self.speed == FAST:
            return self.clock()
        passed_s = time.monotonic() - self._started_s
        return int(self._source.host_time_ns[0]) + int(passed_s * self.speed * 1e9)
