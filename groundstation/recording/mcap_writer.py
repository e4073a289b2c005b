"""The recorder: takes what the daemon has and never makes it wait.

A thread of its own merges, encodes, compresses and writes. The caller only puts references
into a bounded queue; what does not fit is counted and reported, not waited for.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from groundstation.errors import RecordingError
from groundstation.recording.mcap_file import McapFile, RecordingFile
from groundstation.recording.mcap_scan import TOTALS
from groundstation.recording.mcap_schemas import (
    COMMAND_TOPIC,
    EVENTS_TOPIC,
    STATISTICS_TOPIC,
    TableTopic,
    encode_entry,
)
from groundstation.recording.session import Table
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch

MEBIBYTE = 1024 * 1024
RecorderState = Literal["recording", "finished", "failed", "low_space"]

_PART_BYTES = 4 * MEBIBYTE
_RAW_ROW_BYTES = 40
_SAMPLE_ROW_BYTES = 97
_ITEM_BYTES = 200
_OVERFLOW_REPORT_S = 5.0
_FINISH_TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """Where a recording stands.

    bytes: on their way to the disk or on it. samples, raw_packets: written.
    dropped_*: given to the recorder and not written, because the queue was full or the
        recording had stopped.
    text: the last fault, or empty.
    """

    file: Path
    bytes: int
    samples: int
    raw_packets: int
    dropped_samples: int
    dropped_packets: int
    dropped_entries: int
    state: RecorderState
    text: str

    @property
    def dropped(self) -> int:
        return self.dropped_samples + self.dropped_packets + self.dropped_entries


@dataclass(frozen=True, slots=True)
class _Entry:
    topic: str
    time_ns: int
    payload: bytes


class _Break:
    """Nothing from before it shares a message with anything behind it."""


_Item = RawBatch | SampleBatch | LogTable | _Entry | _Break


class McapRecorder:
    """Records into a new MCAP file until ``finish``.

    A killed process loses what arrived in the last ``flush_s``; the file is readable without
    having been finished. When the disk fails, its free space falls under ``low_space_bytes`` or
    another program removes or cuts the file, the recording stops, ``on_fault`` gets one line (from
    the recorder's thread) and what was written stays good.

    path: must not exist; its folder is created.
    metadata: name -> key -> text; see ``session_metadata`` for the one named ``session``.
    flush_s: how often what is queued is written and synced, seconds.
    batch_s: consecutive batches are merged into messages of up to this long, seconds.
    queue_bytes: bound of what waits for the disk.

    Raises BadInputError where ``path`` exists, RecordingError where it cannot be created or
    too little space is free.
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, Mapping[str, str]],
        *,
        flush_s: float = 0.2,
        batch_s: float = 0.05,
        low_space_bytes: int = 16 * MEBIBYTE,
        queue_bytes: int = 64 * MEBIBYTE,
        on_fault: Callable[[str], None] | None = None,
    ) -> None:
        self._out = RecordingFile(path, metadata)
        self._path = path
        self._flush_s, self._batch_s = flush_s, batch_s
        self._low_space_bytes, self._queue_bytes = low_space_bytes, queue_bytes
        self._on_fault = on_fault
        self._lock = threading.Lock()
        self._queue: deque[_Item] = deque()
        self._queued_bytes = 0
        self._dropped = {RawBatch: 0, SampleBatch: 0, LogTable: 0, _Entry: 0, _Break: 0}
        self._tables: dict[str, TableTopic] = {}
        self._reported_drops = 0
        self._report_due_s = 0.0
        self._samples = self._packets = self._marks = 0
        self._state: RecorderState = "recording"
        self._text = ""
        if self._space_is_low():
            free = self._out.file.free_bytes() / MEBIBYTE
            self._out.discard()
            raise RecordingError(f"{path}: not recording: only {free:.1f} MiB free; make room")
        self._finishing = threading.Event()
        self._syncer = _Syncer(self._out.file)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def raw(self, batch: RawBatch) -> None:
        """Record packets as received. The batch's arrays must not change afterwards."""
        self._offer(batch)

    def samples(self, batch: SampleBatch) -> None:
        """Record decoded samples. The batch's arrays must not change afterwards."""
        self._offer(batch)

    def table(self, rows: LogTable) -> None:
        """Record rows of a further table, whose columns stay the same in a file."""
        self._offer(rows)

    def command(self, entry: dict[str, Any]) -> None:
        """Record a setpoint or parameter write; like every entry it has a ``time_ns``."""
        self._entry(COMMAND_TOPIC, entry)

    def event(self, entry: dict[str, Any]) -> None:
        """Record a change of a link, a fault, or an operator's mark."""
        self._marks += entry.get("kind") == "mark"
        self._entry(EVENTS_TOPIC, entry)

    def statistics(self, entry: dict[str, Any]) -> None:
        """Record a link's counters."""
        self._entry(STATISTICS_TOPIC, entry)

    def split(self) -> None:
        """What follows comes from another source: in the file it is behind all of the first's."""
        self._offer(_Break())

    def status(self) -> RecorderStatus:
        with self._lock:
            return RecorderStatus(
                file=self._path,
                bytes=self._out.file.size,
                samples=self._samples,
                raw_packets=self._packets,
                dropped_samples=self._dropped[SampleBatch],
                dropped_packets=self._dropped[RawBatch],
                dropped_entries=self._dropped[_Entry] + self._dropped[LogTable],
                state=self._state,
                text=self._text,
            )

    @property
    def fullness(self) -> float:
        """How full the queue is, 0..1."""
        with self._lock:
            return self._queued_bytes / self._queue_bytes

    def finish(self) -> RecorderStatus:
        """Write what is queued, finish the file and sync it. Safe to call twice."""
        self._finishing.set()
        self._thread.join(_FINISH_TIMEOUT_S)
        if self._thread.is_alive():
            self._stop("failed", "the disk does not answer; the file was not finished")
        return self.status()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.finish()

    def _entry(self, topic: str, entry: dict[str, Any]) -> None:
        # encoded now, for the caller may change the dictionary
        self._offer(_Entry(topic, int(entry["time_ns"]), encode_entry(entry)))

    def _offer(self, item: _Item) -> None:
        size = _size(item)
        with self._lock:
            stopped = self._state != "recording" or self._finishing.is_set()
            if stopped or self._queued_bytes + size > self._queue_bytes:
                self._dropped[type(item)] += _count(item)
                return
            self._queue.append(item)
            self._queued_bytes += size

    def _run(self) -> None:
        try:
            self._record()
        except OSError as error:
            self._stop("failed", f"recording stopped: {error.strerror}; what was written is kept")
        except Exception as error:  # a fault of ours must not take the daemon with it
            with contextlib.suppress(OSError):
                self._finish_file()
            self._stop("failed", f"recording stopped by an internal fault: {error!r}")
        finally:
            self._syncer.close()
            self._out.file.abandon()

    def _finish_file(self) -> None:
        self._syncer.close()
        totals = {"samples": self._samples, "raw_packets": self._packets, "marks": self._marks}
        self._out.file.add_metadata(TOTALS, {key: str(value) for key, value in totals.items()})
        self._out.file.finish()

    def _record(self) -> None:
        while True:
            finishing = self._finishing.wait(self._flush_s)
            # before more is written, which would leave a hole where the file was cut
            if taken := self._out.file.taken_away():
                self._stop("failed", f"recording stopped: {taken}")
                return
            self._write_queued()
            self._report_overflow()
            self._out.file.flush()
            self._syncer.request(self._out.file.size)
            if self._space_is_low():
                self._finish_file()
                self._stop("low_space", "recording finished early: the disk is almost full")
                return
            if finishing:
                self._finish_file()
                with self._lock:
                    self._state = "finished"
                return

    def _write_queued(self) -> None:
        """Write what is queued, a part at a time; it counts against the bound until written."""
        while True:
            items: list[_Item] = []
            size = 0
            with self._lock:
                while self._queue and size < _PART_BYTES:
                    item = self._queue.popleft()
                    items.append(item)
                    size += _size(item)
            if not items:
                return
            self._write(items)
            with self._lock:
                self._queued_bytes -= size

    def _write(self, items: list[_Item]) -> None:
        for is_break, run in itertools.groupby(items, lambda item: isinstance(item, _Break)):
            if not is_break:
                self._write_run(list(run))

    def _write_run(self, items: list[_Item]) -> None:
        for item in items:
            if isinstance(item, _Entry):
                self._out.encoded(item.topic, item.time_ns, item.payload)
            elif isinstance(item, LogTable):
                self._write_table(item)
        packets = RawBatch.concatenate([item for item in items if isinstance(item, RawBatch)])
        self._out.raw(packets, self._batch_s)
        self._packets += len(packets)
        decoded = [item for item in items if isinstance(item, SampleBatch) and len(item)]
        for _, run in itertools.groupby(decoded, lambda batch: batch.tick_s):
            samples = SampleBatch.concatenate(list(run))
            self._out.samples(samples, self._batch_s)
            self._samples += len(samples)

    def _write_table(self, rows: LogTable) -> None:
        table = Table(rows.time_s, dict(rows.columns))
        topic = self._tables.get(rows.name)
        if topic is None:
            topic = self._tables[rows.name] = TableTopic(rows.name, len(self._tables) + 1, table)
            self._out.add_topic(topic.topic, topic.metadata)
        self._out.add(topic.topic.name, int(rows.host_time_ns[-1]), topic.encode(table))

    def _space_is_low(self) -> bool:
        file = self._out.file
        return file.free_bytes() < self._low_space_bytes + file.summary_bytes

    def _report_overflow(self) -> None:
        """Tell of a full queue, at once and then every few seconds while it lasts."""
        status = self.status()
        if status.dropped == self._reported_drops or time.monotonic() < self._report_due_s:
            return
        self._reported_drops = status.dropped
        self._report_due_s = time.monotonic() + _OVERFLOW_REPORT_S
        self._report(
            f"the disk is too slow: {status.dropped_packets} packets, {status.dropped_samples} "
            f"samples and {status.dropped_entries} entries are not in the recording so far"
        )

    def _stop(self, state: RecorderState, text: str) -> None:
        """Accept nothing more, count what is still queued as dropped, and say why."""
        with self._lock:
            self._state = state
            for item in self._queue:
                self._dropped[type(item)] += _count(item)
            self._queue.clear()
            self._queued_bytes = 0
        self._report(text)

    def _report(self, text: str) -> None:
        self._text = f"{self._path}: {text}"
        if self._on_fault is not None:
            with contextlib.suppress(Exception):  # the listener's fault is not the recording's
                self._on_fault(self._text)


class _Syncer:
    """Syncs the file from a thread of its own.

    A sync can take seconds on a memory card; what arrives meanwhile must still be handed to
    the operating system, or a killed process would lose it.
    """

    def __init__(self, file: McapFile) -> None:
        self._file = file
        self._asked_size = 0
        self._error: OSError | None = None
        self._closing = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-sync", daemon=True)
        self._thread.start()

    def request(self, size: int) -> None:
        """Sync soon where the file has grown to ``size``. Raises what the last sync raised."""
        if self._error is not None:
            raise self._error
        if size > self._asked_size:
            self._asked_size = size
            self._wake.set()

    def close(self) -> None:
        """Wait for a running sync; none starts after this. Safe to call twice."""
        self._closing = True
        self._wake.set()
        self._thread.join()

    def _run(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._closing:
                return
            try:
                self._file.sync()
            except OSError as error:
                self._error = error


def _count(item: _Item) -> int:
    if isinstance(item, _Break):
        return 0
    return 1 if isinstance(item, _Entry | LogTable) else len(item)


def _size(item: _Item) -> int:
    """Bytes that ``item`` holds, and at least what its place in the queue costs."""
    if isinstance(item, _Entry):
        return _ITEM_BYTES + len(item.payload)
    if isinstance(item, _Break):
        return _ITEM_BYTES
    if isinstance(item, LogTable):
        return _ITEM_BYTES + (2 + len(item.columns)) * item.time_s.nbytes
    row = _RAW_ROW_BYTES if isinstance(item, RawBatch) else _SAMPLE_ROW_BYTES
    return _ITEM_BYTES + len(item) * row
