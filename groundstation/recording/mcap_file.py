"""An MCAP file of ours while it is written, and a recording written at once."""

from __future__ import annotations

import contextlib
import fcntl
import heapq
import itertools
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from mcap.records import Attachment
from mcap.writer import LIBRARY_IDENTIFIER, Writer
from numpy.typing import NDArray

from groundstation import __version__
from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
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
from groundstation.recording.session import Recording
from groundstation.telemetry.samples import RawBatch, SampleBatch
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
            for name, items in metadata.items():
                texts = {key: encodable(str(value)) for key, value in items.items()}
                self.file.add_metadata(name, texts)
            names = {str(number): name for number, name in enumerate(topics, start=1)}
            self.file.add_metadata(CHANNELS_METADATA, names)
            for topic in topics.values():
                self.add_topic(topic)
            self.file.flush()
        except OSError as error:
            self.discard()
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error

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
        for table in tables:
            out.add_topic(table.topic, table.metadata)
        streams = [_raw(out, recording), _samples(out, recording), *_entries(out, recording)]
        streams += [_table(out, table, _origin_ns(recording.samples)) for table in tables]
        for _, write in heapq.merge(*streams, key=lambda step: step[0]):
            write()
        out.finish()
    except BaseException as error:
        out.discard()
        if isinstance(error, OSError):
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
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
