"""An MCAP file being written: chunks, indexes, checksums, and nothing half-written.

The mcap package's own writer keeps 0.7 kB of Python objects for every chunk until the file is
closed. With a chunk flushed five times a second that is 13 MB an hour, so the records are
laid out here (MCAP specification version 0) and the index is kept as the bytes it will be.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics
from mcap.writer import LIBRARY_IDENTIFIER, MCAP0_MAGIC

from groundstation import __version__
from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
from groundstation.recording.mcap_schemas import metadata_checksum

LIBRARY = f"groundstation {__version__} ({LIBRARY_IDENTIFIER})"
CHECKSUM_KEY = "crc32"
CHUNK_BYTES, CHUNK_NS = 256 * 1024, 1_000_000_000
"""A chunk is closed before it holds more, or more of the recording's time: a damage costs one."""
_PENDING_BYTES = 1024 * 1024

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = 2 + 4 + 8 + 8
_CHUNK = struct.Struct("<QQQII4sQ")
_INDEX_ENTRY = struct.Struct("<QQ")
_SUMMARY_OFFSET = struct.Struct("<BQBQQ")


class McapFile:
    """One new MCAP file. Errors of the file system come out as ``OSError``.

    After an ``OSError`` the file ends with the last whole record that reached it, and only
    ``abandon`` may follow.
    """

    def __init__(self, path: Path, chunk_bytes: int = CHUNK_BYTES, *, profile: str = "") -> None:
        self.path = path
        self._stream = _Stream(_create(path))
        self._chunk_bytes = chunk_bytes
        self._compress = zstandard.ZstdCompressor().compress
        self._data_crc = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._metadata_index = bytearray()
        self._attachment_index = bytearray()
        self._chunk_index = bytearray()
        self._metadata_count = self._attachment_count = self._chunk_count = 0
        self._times: tuple[int, int] | None = None
        self._chunk = bytearray()
        self._chunk_times: tuple[int, int] | None = None
        self._chunk_messages: dict[int, bytearray] = {}
        self._put(MCAP0_MAGIC)
        builder = RecordBuilder()
        Header(profile=profile, library=LIBRARY).write(builder)
        self._put(builder.end())

    @property
    def size(self) -> int:
        """Bytes handed to the operating system so far."""
        return self._stream.size

    @property
    def summary_bytes(self) -> int:
        """Roughly what ``finish`` still has to write."""
        schemas = sum(len(schema.data) + 128 for schema in self._schemas)
        return len(self._chunk_index) + len(self._chunk) + schemas + 4096

    def add_metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add a metadata record, protected by a checksum of its own."""
        self._close_chunk()
        offset = self._stream.tell()
        plain = {key: value for key, value in items.items() if key != CHECKSUM_KEY}
        checksum = metadata_checksum(name, plain.items())
        builder = RecordBuilder()
        Metadata(name=name, metadata={**plain, CHECKSUM_KEY: checksum}).write(builder)
        record = builder.end()
        self._put(record)
        encoded = name.encode()
        self._metadata_index += _RECORD.pack(Opcode.METADATA_INDEX, 20 + len(encoded))
        self._metadata_index += struct.pack("<QQI", offset, len(record), len(encoded)) + encoded
        self._metadata_count += 1

    def add_attachment(self, attachment: Attachment) -> None:
        """Copy an attachment as it is."""
        self._close_chunk()
        offset = self._stream.tell()
        builder = RecordBuilder()
        attachment.write(builder)
        record = builder.end()
        self._put(record)
        name, media = attachment.name.encode(), attachment.media_type.encode()
        entry = struct.pack(
            "<QQQQQI",
            offset,
            len(record),
            attachment.log_time,
            attachment.create_time,
            len(attachment.data),
            len(name),
        )
        entry += name + struct.pack("<I", len(media)) + media
        self._attachment_index += _RECORD.pack(Opcode.ATTACHMENT_INDEX, len(entry)) + entry
        self._attachment_count += 1

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message definition and return its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._chunk += _record_bytes(schema)
        return schema.id

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: Mapping[str, str]
    ) -> int:
        """Add a channel and return its id. Ids count from 1 in the order of registration."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=message_encoding,
            schema_id=schema_id,
            metadata=dict(metadata),
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._chunk += _record_bytes(channel)
        return channel.id

    def add_message(
        self,
        channel_id: int,
        log_time_ns: int,
        data: bytes | memoryview,
        publish_time_ns: int | None = None,
    ) -> None:
        """Add a message; it reaches the disk with its chunk, at the next ``flush`` at latest."""
        log_time_ns = max(log_time_ns, 0)  # the format has no times before 1970
        first, last = _widen(self._chunk_times, log_time_ns)
        is_full = len(self._chunk) + len(data) > self._chunk_bytes
        if self._chunk and (is_full or last - first > CHUNK_NS):
            self._close_chunk()
        entries = self._chunk_messages.setdefault(channel_id, bytearray())
        entries += _INDEX_ENTRY.pack(log_time_ns, len(self._chunk))
        sequence = self._counts[channel_id]
        self._counts[channel_id] = sequence + 1
        publish_time_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        self._chunk += _MESSAGE.pack(
            Opcode.MESSAGE,
            _MESSAGE_HEAD + len(data),
            channel_id,
            sequence & 0xFFFFFFFF,
            log_time_ns,
            publish_time_ns,
        )
        self._chunk += data
        self._chunk_times = _widen(self._chunk_times, log_time_ns)

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system: survives kill -9."""
        self._close_chunk()
        self._stream.flush()

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
        self._stream.flush()
        end = _RECORD.pack(Opcode.DATA_END, 4) + struct.pack("<I", self._data_crc)
        self._stream.write(end + self._summary(self._stream.tell() + len(end)))
        self._stream.flush()
        os.fsync(self._stream.fd)
        self.abandon()

    def abandon(self) -> None:
        """Close the file as it stands. Safe to call twice."""
        self._stream.close()

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._data_crc = zlib.crc32(data, self._data_crc)

    def _close_chunk(self) -> None:
        """Write the chunk in progress. Definitions alone wait for their first message."""
        if self._chunk_times is None:
            return
        content = bytes(self._chunk)
        packed = self._compress(content)
        first, last = self._chunk_times
        head = _CHUNK.pack(first, last, len(content), zlib.crc32(content), 4, b"zstd", len(packed))
        offset = self._stream.tell()
        chunk = _RECORD.pack(Opcode.CHUNK, len(head) + len(packed)) + head + packed
        indexes = bytearray()
        places = bytearray()
        for channel_id, entries in self._chunk_messages.items():
            places += struct.pack("<HQ", channel_id, offset + len(chunk) + len(indexes))
            indexes += _RECORD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries))
            indexes += struct.pack("<HI", channel_id, len(entries)) + entries
        self._put(chunk + indexes)
        entry = struct.pack("<QQQQI", first, last, offset, len(chunk), len(places)) + places
        entry += struct.pack("<QI4sQQ", len(indexes), 4, b"zstd", len(packed), len(content))
        self._chunk_index += _RECORD.pack(Opcode.CHUNK_INDEX, len(entry)) + entry
        self._chunk_count += 1
        self._times = _widen(_widen(self._times, first), last)
        self._chunk = bytearray()
        self._chunk_times = None
        self._chunk_messages = {}

    def _summary(self, start: int) -> bytes:
        """The summary section, its offsets, the footer and the closing magic."""
        first, last = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=self._attachment_count,
            channel_count=len(self._channels),
            channel_message_counts={c: n for c, n in self._counts.items() if n},
            chunk_count=self._chunk_count,
            message_count=sum(self._counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=self._metadata_count,
            schema_count=len(self._schemas),
        )
        groups = (
            (Opcode.SCHEMA, b"".join(_record_bytes(schema) for schema in self._schemas)),
            (Opcode.CHANNEL, b"".join(_record_bytes(channel) for channel in self._channels)),
            (Opcode.STATISTICS, _record_bytes(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_index),
            (Opcode.ATTACHMENT_INDEX, self._attachment_index),
            (Opcode.METADATA_INDEX, self._metadata_index),
        )
        out = bytearray()
        offsets = bytearray()
        for opcode, group in groups:
            if group:
                offsets += _SUMMARY_OFFSET.pack(
                    Opcode.SUMMARY_OFFSET, 17, opcode, start + len(out), len(group)
                )
                out += group
        offsets_start = start + len(out)
        out += offsets
        out += _RECORD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, offsets_start)
        return bytes(out) + struct.pack("<I", zlib.crc32(out)) + MCAP0_MAGIC


class _Stream:
    """Whole records in, and a file that never ends inside one because of an error."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self.size = 0
        self._pending = bytearray()

    def tell(self) -> int:
        return self.size + len(self._pending)

    def write(self, records: bytes) -> None:
        if len(self._pending) > _PENDING_BYTES:
            self.flush()
        self._pending += records

    def flush(self) -> None:
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


def _record_bytes(record: Schema | Channel | Statistics) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _widen(span: tuple[int, int] | None, time_ns: int) -> tuple[int, int]:
    return (time_ns, time_ns) if span is None else (min(span[0], time_ns), max(span[1], time_ns))
