"""What waits for the feeder: bounded, the oldest dropped first, every drop counted."""

from __future__ import annotations

import socket
from collections import deque

from groundstation.telemetry.samples import SampleBatch
from groundstation.viewer.messages import (
    MAX_BYTES,
    MAX_ROWS,
    Note,
    SamplesMessage,
    encode_message,
)


class Outbox:
    """Samples, and events, statistics or predictions ("notes"), until a socket takes them.

    sent, dropped: counts of samples plus notes. What was sent, but not taken by the reader before
    it died, was dropped.
    """

    def __init__(self, *, max_rows: int = 2000, max_notes: int = 200) -> None:
        self.sent = 0
        self.dropped = 0
        self._max_rows = max_rows
        self._batches: deque[SampleBatch] = deque()
        self._rows = 0
        self._notes: deque[Note] = deque()
        self._max_notes = max_notes
        self._untaken = 0
        self._taken = 0

    @property
    def waiting(self) -> int:
        """Samples and notes that nobody has taken yet."""
        return self._rows + len(self._notes)

    def put_samples(self, batch: SampleBatch) -> None:
        for start in range(0, len(batch), MAX_ROWS):
            piece = batch[start : start + MAX_ROWS] if len(batch) > MAX_ROWS else batch
            self._batches.append(piece)
            self._rows += len(piece)
            while self._rows > self._max_rows:
                oldest = self._batches.popleft()
                self._rows -= len(oldest)
                self.dropped += len(oldest)

    def put_note(self, note: Note) -> None:
        self._notes.append(note)
        if len(self._notes) > self._max_notes:
            self._notes.popleft()
            self.dropped += 1

    def flush(self, channel: socket.socket) -> None:
        """Send what the non-blocking ``channel`` takes now; the rest stays.

        Raises OSError when the other end is gone.
        """
        while self._batches:
            batches = self._next_run()
            batch = batches[0] if len(batches) == 1 else SampleBatch.concatenate(batches)
            if not _send(channel, encode_message(SamplesMessage.of(batch))):
                return
            for _ in batches:
                self._batches.popleft()
            self._rows -= len(batch)
            self._count(len(batch))
        while self._notes:
            data = encode_message(self._notes[0])
            if len(data) > MAX_BYTES:
                self.dropped += 1
            elif _send(channel, data):
                self._count(1)
            else:
                return
            self._notes.popleft()

    def new_reader(self) -> None:
        """Another reader: what the last one did not take is lost."""
        self.sent -= self._untaken
        self.dropped += self._untaken
        self._untaken = 0
        self._taken = 0

    def taken(self, total: int) -> None:
        """The reader has taken ``total`` samples and notes since it started."""
        self._untaken -= total - self._taken
        self._taken = total

    def _count(self, items: int) -> None:
        self.sent += items
        self._untaken += items

    def _next_run(self) -> list[SampleBatch]:
        """The oldest batches that fit one message: one source, at most ``MAX_ROWS`` rows."""
        first = self._batches[0]
        run, rows = [first], len(first)
        for batch in list(self._batches)[1:]:
            rows += len(batch)
            if rows > MAX_ROWS or batch.tick_s != first.tick_s:
                break
            run.append(batch)
        return run


def _send(channel: socket.socket, data: bytes) -> bool:
    try:
        channel.send(data)
    except BlockingIOError:
        return False
    return True
