"""An MCAP file being written by the mcap package, and nothing half-written."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, cast

from mcap.records import Attachment
from mcap.writer import LIBRARY_IDENTIFIER, Writer

from groundstation import __version__
from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
from groundstation.recording.mcap_schemas import metadata_checksum

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
