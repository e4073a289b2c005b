"""An MCAP file of ours while it is written: a recording at once, or by the recorder."""

from __future__ import annotations

import contextlib
import fcntl
import heapq
import itertools
import os
import platform
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import IO, Any, Literal, Self, cast

import numpy as np
from mcap.records import Attachment
from mcap.writer import LIBRARY_IDENTIFIER, Writer
from numpy.typing import NDArray

from groundstation import __version__
from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken, writing
from groundstation.recording.mcap_schemas import (
    COMMAND_TOPIC,
    EVENTS_TOPIC,
    PROFILE,
    RAW_TOPIC,
    ROS2_TOPICS,
    SAMPLES_TOPIC,
    STATISTICS_TOPIC,
    TOPICS,
    StandardMessages,
    TableTopic,
    Topic,
    encode_entry,
    encode_raw,
    encode_samples,
    metadata_checksum,
    row_messages,
    string_message,
)
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch
from groundstation.text import encodable

# An MCAP file being written by the mcap package, and nothing half-written.


LIBRARY = f"groundstation {__version__} ({LIBRARY_IDENTIFIER})"
CHECKSUM_KEY = "crc32"
CHUNK_BYTES, CHUNK_NS = 256 * 1024, 1_000_000_000
"""A chunk is closed before it holds more, or more of the recording's time: a damage costs one."""
_MESSAGE_HEAD = 31
_CHUNK_INDEX_BYTES = 96 + 10 * 16
"""Of a chunk with messages of sixteen topics."""


class McapFile:
    """One new MCAP file. Errors of the file system come out as ``OSError``.

    After an ``OSError`` the file ends with the last whole record that reached it, and only
    ``abandon`` may follow.
    """

    def __init__(self, path: Path, *, profile: str = "") -> None:
        self.path = path
        self._stream = _Stream(_create(path))
        self._writer = Writer(
            cast("IO[Any]", self._stream), chunk_size=2 * CHUNK_BYTES, enable_data_crcs=True
        )
        self._chunk_content = self._chunks = self._definition_bytes = 0
        self._chunk_times: tuple[int, int] | None = None
        self._counts: dict[int, int] = {}
        self._writer.start(profile, LIBRARY)

    @property
    def size(self) -> int:
        """Bytes handed to the operating system so far."""
        return self._stream.size

    @property
    def summary_bytes(self) -> int:
        """Roughly what ``finish`` still has to write."""
        index = self._chunks * _CHUNK_INDEX_BYTES
        return index + self._chunk_content + self._definition_bytes + 4096

    def add_metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add a metadata record, protected by a checksum of its own."""
        self._close_chunk()
        plain = {key: value for key, value in items.items() if key != CHECKSUM_KEY}
        checksum = metadata_checksum(name, plain.items())
        self._writer.add_metadata(name, {**plain, CHECKSUM_KEY: checksum})

    def add_attachment(self, attachment: Attachment) -> None:
        """Copy an attachment as it is."""
        self._close_chunk()
        self._writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )
        self._stream.flush()

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message definition and return its id."""
        self._definition_bytes += len(data) + 128
        return self._writer.register_schema(name, encoding, data)

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: Mapping[str, str]
    ) -> int:
        """Add a channel and return its id. Ids count from 1 in the order of registration."""
        return self._writer.register_channel(topic, message_encoding, schema_id, dict(metadata))

    def add_message(
        self,
        channel_id: int,
        log_time_ns: int,
        data: bytes | memoryview,
        publish_time_ns: int | None = None,
    ) -> None:
        """Add a message; it reaches the disk with its chunk, at the next ``flush`` at latest."""
        log_time_ns = max(log_time_ns, 0)  # the format has no times before 1970
        first, last = self._chunk_times or (log_time_ns, log_time_ns)
        first, last = min(first, log_time_ns), max(last, log_time_ns)
        is_full = self._chunk_content + len(data) > CHUNK_BYTES
        if self._chunk_times and (is_full or last - first > CHUNK_NS):
            self._close_chunk()
            first = last = log_time_ns
        self._chunk_times = first, last
        self._chunk_content += len(data) + _MESSAGE_HEAD
        sequence = self._counts.get(channel_id, 0)
        self._counts[channel_id] = sequence + 1
        publish_time_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        self._writer.add_message(
            channel_id, log_time_ns, cast("bytes", data), publish_time_ns, sequence & 0xFFFFFFFF
        )

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system: survives kill -9."""
        self._close_chunk()

    def sync(self) -> None:
        """Wait until the disk has what was flushed: survives a power loss."""
        os.fdatasync(self._stream.fd)

    def taken_away(self) -> str:
        """What another program did to the file, in words, or nothing."""
        status = os.fstat(self._stream.fd)
        if status.st_nlink == 0:
            return "the file was removed"
        if status.st_size < self._stream.size:
            return f"another program cut the file to {status.st_size} bytes"
        return ""

    def free_bytes(self) -> int:
        """Free space of the file system, for users without special rights."""
        status = os.fstatvfs(self._stream.fd)
        return status.f_bavail * status.f_frsize

    def finish(self) -> None:
        """Write the summary, sync and close. Not finished, the file reads up to its end."""
        self._close_chunk()
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fd)
        self.abandon()

    def abandon(self) -> None:
        """Close the file as it stands. Safe to call twice."""
        self._stream.close()

    def _close_chunk(self) -> None:
        """Write the chunk in progress. Definitions alone wait for their first message."""
        self._chunks += self._chunk_times is not None
        self._chunk_times, self._chunk_content = None, 0
        self._writer.flush()


class _Stream:
    """Whole records in, and a file that never ends inside one because of an error."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self.size = 0
        self._pending = bytearray()

    def tell(self) -> int:
        return self.size + len(self._pending)

    def write(self, records: bytes) -> None:
        self._pending += records

    def flush(self) -> None:
        """Hand everything to the operating system. Raises OSError, the file then ends with the
        last whole record that reached it."""
        pending, self._pending = self._pending, bytearray()
        view = memoryview(pending)
        written = 0
        try:
            while written < len(view):
                written += os.write(self.fd, view[written:])
        except OSError:
            os.ftruncate(self.fd, self.size)
            raise
        self.size += written

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def _create(path: Path) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # at the end of what is there: where another program cuts the file, no hole is written
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
        fd = os.open(path, flags, 0o644)
    except FileExistsError as error:
        if os.path.isdir(path.parent):
            raise BadInputError(taken(path)) from error
        raise RecordingError(f"{path}: {path.parent} is not a folder") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be created: {error.strerror}") from error
    with contextlib.suppress(OSError):  # not every file system has locks
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # tells a clean-up that it is being written
    with contextlib.suppress(OSError):  # not every file system can sync a folder
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)  # or a power loss takes the name of a synced file
        finally:
            os.close(folder)
    return fd


# A recording being written: an MCAP file with the project's topics.


MESSAGE_S = 0.05
"""How long a message of packets or samples lasts, seconds."""
_MAX_ROWS = 1024
_STEP_ROWS = 1000

TOTALS = "totals"
"""Metadata record that a finished recording ends with."""
CHANNELS_METADATA = "channels"
"""Metadata record: channel id -> topic. The definitions live in the first chunk; should that
one be damaged in a torn file, this is how the rest is still understood."""


class RecordingFile:
    """Writes batches and entries as messages.

    ros2_hz: rows a second that are also written for ROS 2's tools, with the profile ``ros2``;
    0 for none, and JSON where that is smaller.

    Raises BadInputError where ``path`` exists and RecordingError where it cannot be created;
    every other method raises ``OSError`` where the disk fails.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, Mapping[str, str]], *, ros2_hz: float = 0.0
    ) -> None:
        self._is_ros2 = ros2_hz > 0
        self.file = McapFile(path, profile=PROFILE if self._is_ros2 else "")
        self._standard = (
            StandardMessages(ros2_hz, row_messages) if self._is_ros2 else StandardMessages()
        )
        topics = ROS2_TOPICS if self._is_ros2 else TOPICS
        self._channels: dict[str, int] = {}
        try:
            with writing(path):
                for name, items in metadata.items():
                    texts = {key: encodable(str(value)) for key, value in items.items()}
                    self.file.add_metadata(name, texts)
                names = {str(number): name for number, name in enumerate(topics, start=1)}
                self.file.add_metadata(CHANNELS_METADATA, names)
                for topic in topics.values():
                    self.add_topic(topic)
                self.file.flush()
        except RecordingError:
            self.discard()
            raise

    def add_topic(self, topic: Topic, metadata: Mapping[str, str] | None = None) -> None:
        """Make ``topic`` known to the file; ``TOPICS`` are known from the start."""
        schema = self.file.register_schema(topic.schema_name, topic.schema_encoding, topic.schema)
        self._channels[topic.name] = self.file.register_channel(
            topic.name, topic.message_encoding, schema, metadata or {}
        )

    def raw(self, batch: RawBatch, span_s: float = MESSAGE_S) -> None:
        """Write packets as messages that last up to ``span_s`` each."""
        for rows in _spans(batch.host_time_ns, span_s):
            message = RawBatch(batch.packets[rows], batch.host_time_ns[rows])
            self.add(RAW_TOPIC, int(message.host_time_ns.max()), encode_raw(message))

    def samples(self, batch: SampleBatch, span_s: float = MESSAGE_S) -> None:
        """Write samples as messages that last up to ``span_s`` each, and what they add to the
        topics of standard types."""
        for rows in _spans(batch.host_time_ns, span_s):
            message = batch[rows]
            self.add(SAMPLES_TOPIC, int(message.host_time_ns.max()), encode_samples(message))
        for topic, time_ns, payload in self._standard.messages(batch):
            self.add(topic, time_ns, payload)

    def entry(self, topic: str, entry: dict[str, Any]) -> None:
        """Write a command, event or statistics entry; it has a ``time_ns``."""
        self.encoded(topic, int(entry["time_ns"]), encode_entry(entry))

    def encoded(self, topic: str, time_ns: int, payload: bytes) -> None:
        """Write an entry that ``encode_entry`` made."""
        self.add(topic, time_ns, string_message(payload) if self._is_ros2 else payload)

    def add(self, topic: str, time_ns: int, payload: bytes) -> None:
        self.file.add_message(self._channels[topic], time_ns, payload)

    def finish(self) -> None:
        self.file.finish()

    def discard(self) -> None:
        """Close the file and remove it."""
        self.file.abandon()
        with contextlib.suppress(OSError):
            self.file.path.unlink()


def write_mcap(recording: Recording, path: str | Path, *, ros2_hz: float = 0.0) -> None:
    """Write a recording, from whatever file it came, as a new MCAP file.

    ros2_hz: as ``RecordingFile`` takes it. Messages are in the order of their host times, so
    viewers can play the file. Leaves no output behind where it fails. Raises BadInputError where
    ``path`` exists, RecordingError where it cannot be written or a table does not hold numbers.
    """
    path = Path(path)
    tables = [
        TableTopic(name, number, table)
        for number, (name, table) in enumerate(recording.tables.items(), start=1)
    ]
    out = RecordingFile(path, recording.metadata, ros2_hz=ros2_hz)
    try:
        with writing(path):
            for table in tables:
                out.add_topic(table.topic, table.metadata)
            streams = [_raw(out, recording), _samples(out, recording), *_entries(out, recording)]
            streams += [_table(out, table, _origin_ns(recording.samples)) for table in tables]
            for _, write in heapq.merge(*streams, key=lambda step: step[0]):
                write()
            out.finish()
    except BaseException:
        out.discard()
        raise


def session_metadata(link: str) -> dict[str, str]:
    """The ``session`` metadata of a recording that ``link`` makes from now on."""
    return {
        "link": link,
        "created": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "groundstation": __version__,
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
    }


_Step = tuple[int, Callable[[], None]]
"""Host time (ns) of a message, and what writes it."""


def _raw(out: RecordingFile, recording: Recording) -> Iterator[_Step]:
    raw = recording.raw
    if raw is not None:
        for rows in _pieces(len(raw)):
            batch = RawBatch(raw.packets[rows], raw.host_time_ns[rows])
            yield int(batch.host_time_ns[0]), partial(out.raw, batch)


def _samples(out: RecordingFile, recording: Recording) -> Iterator[_Step]:
    for rows in _pieces(len(recording.samples)):
        batch = recording.samples[rows]
        yield int(batch.host_time_ns[0]), partial(out.samples, batch)


def _entries(out: RecordingFile, recording: Recording) -> Iterator[Iterator[_Step]]:
    def steps(topic: str, entries: list[dict[str, Any]]) -> Iterator[_Step]:
        for entry in entries:
            yield int(entry["time_ns"]), partial(out.entry, topic, entry)

    yield steps(COMMAND_TOPIC, recording.commands)
    yield steps(EVENTS_TOPIC, recording.events)
    yield steps(STATISTICS_TOPIC, recording.statistics)


def _table(out: RecordingFile, table: TableTopic, origin_ns: int) -> Iterator[_Step]:
    for time_ns, payload in table.messages(origin_ns):
        yield time_ns, partial(out.add, table.topic.name, time_ns, payload)


def _origin_ns(samples: SampleBatch) -> int:
    """Unix time at which the device's clock was at 0, as far as the first sample tells."""
    if not len(samples):
        return 0
    return int(samples.host_time_ns[0] - round(float(samples.time_s[0]) * 1e9))


def _pieces(length: int) -> Iterator[slice]:
    """Slices that cover ``length`` rows, small enough to interleave topics by time."""
    return (slice(start, start + _STEP_ROWS) for start in range(0, length, _STEP_ROWS))


def _spans(host_time_ns: NDArray[np.int64], span_s: float) -> Iterator[slice]:
    """Slices that cover all rows, each at most ``span_s`` and ``_MAX_ROWS`` long."""
    if not len(host_time_ns):
        return
    turn = (host_time_ns - host_time_ns[0]) // int(span_s * 1e9)
    edges = [0, *(np.flatnonzero(np.diff(turn)) + 1).tolist(), len(host_time_ns)]
    for first, last in itertools.pairwise(edges):
        for start in range(first, last, _MAX_ROWS):
            yield slice(start, min(start + _MAX_ROWS, last))


# The recorder: takes what the daemon has and never makes it wait.
#
# A thread of its own merges, encodes, compresses and writes. The caller only puts references into a
# bounded queue; what does not fit is counted and reported, not waited for.


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
