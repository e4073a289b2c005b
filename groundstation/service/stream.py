"""The live samples for other programs: a bounded queue for each, the oldest dropped first."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from groundstation.comparison.gap import CHANNELS
from groundstation.errors import TakenError
from groundstation.links.command import LinkEvent
from groundstation.recording.mcap_schemas import SAMPLE_FIELDS
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import LogTable, SampleBatch

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown

CLIENTS_MOST = 8
ROWS_MOST = 2000
"""Four seconds of telemetry wait for a client that does not read."""
NOTES_MOST = 100
PERIOD_S = 0.02
"""What has come meanwhile goes out together: 50 messages a second at most."""
ROWS_A_MESSAGE = 5
"""A client that wants few rows gets so many together: each message costs as much as 100 rows."""
KEEP_ALIVE_S = 2.0
"""A comment is sent after so long without anything, so that a dead connection shows."""


class Subscriber:
    """What waits for one client. dropped: samples and notes that it was too slow for.

    rows_hz: about so many rows a second are wanted; None: all.
    """

    def __init__(self, rows_hz: float | None = None) -> None:
        self.dropped = 0
        self._rows_hz = rows_hz
        self._period_s = max(PERIOD_S, 0.0 if rows_hz is None else ROWS_A_MESSAGE / rows_hz)
        self._batches: deque[SampleBatch] = deque()
        self._at_s = 0.0
        self._rows = 0
        self._notes: deque[tuple[str, dict[str, Any]]] = deque()
        self._something = asyncio.Event()

    def put_samples(self, batch: SampleBatch) -> None:
        self._at_s = time.monotonic()
        self._batches.append(batch)
        self._rows += len(batch)
        while self._rows > ROWS_MOST and len(self._batches) > 1:
            oldest = self._batches.popleft()
            self._rows -= len(oldest)
            self.dropped += len(oldest)
        if self._rows > ROWS_MOST:
            newest = self._batches.pop()[-ROWS_MOST:]
            self.dropped += self._rows - len(newest)
            self._rows = len(newest)
            self._batches.append(newest)
        self._something.set()

    def put_note(self, kind: str, note: dict[str, Any]) -> None:
        self._notes.append((kind, note))
        if len(self._notes) > NOTES_MOST:
            self._notes.popleft()
            self.dropped += 1
        self._something.set()

    async def messages(self) -> AsyncIterator[bytes]:
        """Server-sent events for as long as somebody asks."""
        yield b": live telemetry\n\n"
        while True:
            try:
                async with asyncio.timeout(KEEP_ALIVE_S):
                    await self._something.wait()
            except TimeoutError:
                yield b": nothing\n\n"
                continue
            self._something.clear()
            while self._notes:
                kind, note = self._notes.popleft()
                yield _event(kind, note)
            while self._batches:
                batch = self._batches.popleft()
                self._rows -= len(batch)
                while self._batches and self._batches[0].tick_s == batch.tick_s:
                    more = self._batches.popleft()
                    self._rows -= len(more)
                    batch = SampleBatch.concatenate([batch, more])
                if self._rows_hz is not None:
                    batch = thinned(batch, self._rows_hz)
                more_columns = {"at_s": self._at_s, "dropped": self.dropped}
                yield _event("samples", {**columns(batch), **more_columns})
            await asyncio.sleep(self._period_s)


class Stream:
    """Every client that listens. dropped: over all of them, also those that have left."""

    def __init__(self) -> None:
        self._subscribers: set[Subscriber] = set()
        self._dropped_before = 0

    def __len__(self) -> int:
        return len(self._subscribers)

    @property
    def dropped(self) -> int:
        return self._dropped_before + sum(one.dropped for one in self._subscribers)

    def subscribe(self, rows_hz: float | None = None) -> Subscriber:
        """rows_hz: as many a second are enough. Raises TakenError when there are too many."""
        if len(self._subscribers) >= CLIENTS_MOST:
            raise TakenError(f"{CLIENTS_MOST} clients read the stream already; end one of them")
        subscriber = Subscriber(rows_hz)
        self._subscribers.add(subscriber)
        return subscriber

    def leave(self, subscriber: Subscriber) -> None:
        """Forget a client. Safe to call twice."""
        if subscriber in self._subscribers:
            self._subscribers.remove(subscriber)
            self._dropped_before += subscriber.dropped

    def samples(self, batch: SampleBatch) -> None:
        for subscriber in self._subscribers:
            subscriber.put_samples(batch)

    def note(self, note: LinkEvent | LinkStatistics | LogTable | Shown) -> None:
        kind, entry = _entry(note)
        for subscriber in self._subscribers:
            subscriber.put_note(kind, entry)

    def split(self) -> None:
        """Each batch says which segment it is of."""


def _entry(note: LinkEvent | LinkStatistics | LogTable | Shown) -> tuple[str, dict[str, Any]]:
    """How the stream calls a note, and what it says of it."""
    match note:
        case LinkEvent():
            return "event", asdict(note)
        case LinkStatistics():
            return "statistics", note.as_dict()
        case LogTable():
            return "table", {
                "name": note.name,
                "at_s": time.monotonic(),
                "time_s": np.round(note.time_s, 4).tolist(),
                "columns": {
                    name: [None if np.isnan(one) else round(float(one), 6) for one in values]
                    for name, values in note.columns.items()
                },
            }
    gap = [None if np.isnan(each) else round(float(each), 3) for each in note.gap]
    return "twin", {
        "segment": note.segment,
        "begin_s": float(note.time_s[0]),
        "end_s": float(note.time_s[-1]),
        "gap": dict(zip(CHANNELS, gap, strict=True)),
    }


def thinned(batch: SampleBatch, rows_hz: float) -> SampleBatch:
    """At most ``rows_hz`` rows a second of a batch, each as it came, the newest among them."""
    span_s = float(batch.ticks[-1] - batch.ticks[0]) * batch.tick_s
    step = math.ceil(len(batch) / max(1.0, rows_hz * span_s))
    return batch[(len(batch) - 1) % step :: step]


def columns(batch: SampleBatch) -> dict[str, Any]:
    """A batch as lists, named as in a recording; a channel without data is left out."""
    values: dict[str, Any] = {"tick_s": batch.tick_s}
    for column, (field, _) in SAMPLE_FIELDS.items():
        array = getattr(batch, column)
        if array.dtype.kind == "f":
            if np.isnan(array).all():
                continue
            # six decimals are finer than any sensor here, and shorter than 32 bits spelt out
            array = np.round(array.astype(np.float64), 6)
        values[field] = array.tolist()
    return values


def _event(kind: str, content: dict[str, Any]) -> bytes:
    return b"event: %s\ndata: %s\n\n" % (kind.encode(), msgspec.json.encode(content, enc_hook=str))
