"""A recorded session as a link: the same packets, with their timing, at any speed."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from groundstation.background import in_background
from groundstation.errors import BadInputError, GroundStationError, LinkEndedError
from groundstation.links.base import Link, LinkBatch, LinkOptions
from groundstation.links.command import HostClock
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_scan import FileWindow
from groundstation.telemetry.samples import RawBatch, SampleBatch

BATCH_S = 0.02
"""Span of one batch at normal speed."""
PIECE = 4096
"""Rows read ahead; also a batch when replaying as fast as possible."""
FAST = float("inf")


def make(options: LinkOptions) -> Link:
    return ReplayLink(Path(options.argument), speed=options.speed, clock=options.clock)


class ReplayLink(Link):
    """Delivers the raw packets of a recording; where it has none (microSD), its samples.

    speed: 1 for real time, 2 for twice as fast, ``FAST`` for as fast as the reader takes them.
    Host stamps keep the recorded spacing whatever the speed and are moved by one constant, so
    that the first is the moment of opening: what is recorded again has the same intervals.
    A recording is read piece by piece: an hour needs no more memory than a minute.
    """

    finite = True

    def __init__(self, path: Path, *, speed: float = 1.0, clock: HostClock | None = None) -> None:
        super().__init__(f"replay:{path}", clock=clock)
        if not speed > 0:
            raise BadInputError(f"replay speed {speed:g}: must be greater than 0 (or 'max')")
        self.path = path
        self.speed = speed
        self._pieces: Iterator[LinkBatch] = iter(())
        self._piece: LinkBatch | None = None
        self._ahead: asyncio.Future[LinkBatch | None] | None = None
        self._damage: list[str] = []
        self._at = 0
        self._first_ns = 0
        self._shift_ns = 0
        self._started_s = 0.0

    async def _open(self) -> None:
        pieces = self._pieces = self._read_pieces()
        first = await in_background(lambda: next(pieces, None))
        if first is None:
            raise BadInputError(f"{self.path} holds no telemetry to replay")
        self._take(first)
        self._at = 0
        self._first_ns = int(first.host_time_ns[0])
        self._shift_ns = self.clock() - self._first_ns
        self._started_s = time.monotonic()

    async def _read(self) -> LinkBatch:
        if self._piece is None and self._ahead is not None:
            # shielded: a cancelled read leaves it for the next one
            self._take(await asyncio.shield(self._ahead))
        piece = self._piece
        if piece is None:
            raise LinkEndedError(f"the end of {self.path}")
        stamps = piece.host_time_ns
        if self.speed == FAST:
            await asyncio.sleep(0)
            end = len(piece)
        else:
            due_s = (int(stamps[self._at]) - self._first_ns) * 1e-9 / self.speed
            await asyncio.sleep(max(0.0, self._started_s + due_s + BATCH_S - time.monotonic()))
            passed_ns = (time.monotonic() - self._started_s) * self.speed * 1e9
            end = int(np.searchsorted(stamps, self._first_ns + int(passed_ns), side="right"))
            end = max(end, self._at + 1)
        rows = slice(self._at, end)
        self._at = end
        if end == len(piece):
            # no await between here and the return: a cancelled read has lost nothing
            self._piece, self._at = None, 0
        shifted = stamps[rows] + self._shift_ns
        if isinstance(piece, SampleBatch):
            return replace(piece[rows], host_time_ns=shifted)
        return RawBatch(piece.packets[rows], shifted)

    async def _close(self) -> None:
        if self._ahead is not None:
            self._ahead.cancel()
        self._piece = self._ahead = None

    def _take(self, piece: LinkBatch | None) -> None:
        """The next piece has come; the one behind it is read where it holds up nobody."""
        self._piece, self._ahead = piece, None
        if piece is not None:
            pieces = self._pieces
            self._ahead = asyncio.ensure_future(in_background(lambda: next(pieces, None)))
            # where nobody comes for it any more, a fault in it is nobody's
            self._ahead.add_done_callback(lambda ahead: ahead.cancelled() or ahead.exception())
            return
        for line in self._damage:
            self.emit("damage", f"{self.path}: {line}")
        self._damage = []

    def now_ns(self) -> int:
        """Stamps keep their spacing at any speed: so must the time that has passed since."""
        if self._ahead is None or self.speed == FAST:
            return self.clock()
        passed_s = time.monotonic() - self._started_s
        return self._first_ns + self._shift_ns + int(passed_s * self.speed * 1e9)

    def _read_pieces(self) -> Iterator[LinkBatch]:
        """Packets from an MCAP file as they are read; anything else is loaded at once."""
        from groundstation.recording.mcap_reader import RawStream

        if _is_mcap(self.path):
            stream = RawStream(self.path, batch_packets=PIECE)
            some = False
            for batch in stream.batches():
                self.start_ticks = stream.first_ticks
                some = True
                yield batch
            if some:
                self._damage = stream.damage
                return
        recording = open_recording(self.path, raw=True)
        if len(recording.samples):
            self.start_ticks = int(recording.samples.ticks[0])
        has_packets = recording.raw is not None and len(recording.raw) > 0
        source = recording.raw if has_packets else recording.samples
        assert source is not None
        for at in range(0, len(source), PIECE):
            rows = slice(at, at + PIECE)
            if isinstance(source, SampleBatch):
                yield source[rows]
            else:
                yield RawBatch(source.packets[rows], source.host_time_ns[rows])
        self._damage = recording.damage


def _is_mcap(path: Path) -> bool:
    from groundstation.recording.mcap_scan import looks_like_mcap

    try:
        window = FileWindow(path)  # never waits, as opening a pipe would
    except GroundStationError:
        return False  # the general reader says what is wrong with it
    try:
        return looks_like_mcap(bytes(window.view(0, min(window.size, 8))))
    finally:
        window.close()
