"""An MCAP file as it is on disk: its records scanned, catalogued and recovered."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Self, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from groundstation.documents import open_regular
from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import reading, taken, writing
from groundstation.recording.mcap_file import CHANNELS_METADATA, CHECKSUM_KEY, TOTALS, McapFile
from groundstation.recording.mcap_schemas import TOPICS, metadata_checksum, usual_topic

# A file of any size read through one buffer.


_WINDOW = 4 * 1024 * 1024


class FileWindow:
    """Random access to the ``size`` bytes a file had when it was opened.

    Raises BadInputError where there is no such file, RecordingError where it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError as error:
            raise BadInputError(f"{path}: no such file") from error
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
        status = os.fstat(self._fd)
        if not stat.S_ISREG(status.st_mode):
            self.close()
            raise BadInputError(f"{path}: not a file; give the recording itself")
        self.size = status.st_size
        self._buffer = b""
        self._start = 0

    def view(self, offset: int, length: int) -> memoryview:
        """``length`` bytes that the file has; stays valid when the window moves on."""
        at = offset - self._start
        if at < 0 or at + length > len(self._buffer):
            self._buffer = self._read(offset, max(length, _WINDOW))
            self._start, at = offset, 0
            if len(self._buffer) < length:
                raise RecordingError(f"{self._path}: became shorter while it was read")
        return memoryview(self._buffer)[at : at + length]

    def find(
        self, patterns: tuple[bytes, ...], start: int, stop: int
    ) -> Iterator[tuple[int, bytes]]:
        """Places of any of ``patterns`` between ``start`` and ``stop``, in order."""
        overlap = max(len(pattern) for pattern in patterns) - 1
        while start < stop:
            block = self._read(start, min(_WINDOW, stop - start) + overlap)
            hits = []
            for pattern in patterns:
                at = block.find(pattern)
                while 0 <= at < _WINDOW:
                    hits.append((start + at, pattern))
                    at = block.find(pattern, at + 1)
            yield from sorted(hits)
            start += _WINDOW

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _read(self, offset: int, length: int) -> bytes:
        with reading(self._path):
            return os.pread(self._fd, length, offset)


# MCAP records taken apart strictly: no field reaches beyond its record, none is left over.


RECORD = struct.Struct("<BQ")
"""Opcode and length before every record's body."""
_MESSAGE = struct.Struct("<HIQQ")

Message = tuple[int, int, int, memoryview]
"""Channel id, log time (ns), publish time (ns), payload."""


Kind = TypeVar("Kind", bound=McapRecord)


def parsed(kind: type[Kind], body: bytes | memoryview) -> Kind:
    """The record of that kind whose body this is. Raises ValueError."""
    stream = _Strict(BytesIO(body))
    try:
        record: Kind = kind.read(stream)
    except (EndOfFile, OverflowError, struct.error, UnicodeDecodeError) as error:
        raise ValueError("a record's parts are longer than the record") from error
    if stream.count != len(body):
        raise ValueError("a record is longer than its parts")
    return record


class _Strict(ReadDataStream):
    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


@dataclass(slots=True)
class Contents:
    """What a chunk or a summary holds.

    first_ns, last_ns: log times of the messages, where there are any.
    """

    content: memoryview
    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    first_ns: int | None = None
    last_ns: int = 0
    places: array[int] = field(default_factory=lambda: array("Q"))
    """Offset and length of each message: objects would need ten times a small message's size."""

    def messages(self) -> Iterator[Message]:
        for at, length in zip(self.places[::2], self.places[1::2], strict=True):
            channel_id, _, log_ns, publish_ns = _MESSAGE.unpack_from(self.content, at)
            yield channel_id, log_ns, publish_ns, self.content[at + _MESSAGE.size : at + length]


def records(content: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of each record's body. Raises ValueError."""
    at, total = 0, len(content)
    while at < total:
        if at + RECORD.size > total:
            raise ValueError("a chunk ends inside a record")
        opcode, length = RECORD.unpack_from(content, at)
        at += RECORD.size
        if at + length > total:
            raise ValueError("a chunk ends inside a record")
        yield opcode, at, length
        at += length


def parse_contents(content: bytes) -> Contents:
    """Messages and definitions in a chunk or a summary. Raises ValueError."""
    view = memoryview(content)
    found = Contents(view)
    first_ns, last_ns = 1 << 64, 0
    for opcode, at, length in records(view):
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise ValueError("a message is shorter than its header")
            log_ns = _MESSAGE.unpack_from(view, at)[2]
            first_ns, last_ns = min(first_ns, log_ns), max(last_ns, log_ns)
            found.places.extend((at, length))
        elif opcode == Opcode.SCHEMA:
            found.schemas.append(parsed(Schema, view[at : at + length]))
        elif opcode == Opcode.CHANNEL:
            found.channels.append(parsed(Channel, view[at : at + length]))
    if found.places:
        found.first_ns, found.last_ns = first_ns, last_ns
    return found


def parse_attachment(body: memoryview) -> Attachment:
    """Raises ValueError, DamagedContentError where its checksum does not match."""
    attachment = parsed(Attachment, body)
    crc = int.from_bytes(body[-4:], "little")
    if crc and zlib.crc32(body[:-4]) != crc:
        raise DamagedContentError("an attachment is damaged", RECORD.size + len(body))
    return attachment


class DamagedContentError(ValueError):
    """The record's framing is sound, so the next one can be found; its content is not."""

    def __init__(self, reason: str, length: int, chunks: int = 0) -> None:
        super().__init__(reason)
        self.length = length
        self.chunks = chunks


@dataclass(slots=True)
class Damage:
    """A place that could not be read.

    offset, length: bytes of the file passed over.
    chunks: whole chunks lost with it.
    before_ns, after_ns: log times of the good messages on either side, where there are any.
    """

    offset: int
    length: int
    reason: str
    chunks: int = 0
    before_ns: int | None = None
    after_ns: int | None = None

    def line(self, start_ns: int | None) -> str:
        """One line for the reader, times counted from ``start_ns``."""
        text = f"byte {self.offset}: {self.reason}"
        if self.length:
            text += f"; {self.length} bytes passed over"
        if start_ns is None or self.before_ns is None:
            return text
        before_s = (self.before_ns - start_ns) / 1e9
        if self.after_ns is None:
            return f"{text}, after {before_s:.3f} s of the recording"
        return f"{text}, between {before_s:.3f} s and {(self.after_ns - start_ns) / 1e9:.3f} s"


# Reading an MCAP file front to back, trusting nothing that no checksum covers.
#
# Torn, flipped and foreign files are the normal case here. Every record is taken apart
# strictly; a chunk counts only when its CRC agrees; where the framing is broken, the next chunk
# whose CRC agrees is looked for. What was passed over is listed, never hidden.


_CHUNK_HEAD = struct.Struct("<QQQI")
_FOOTER_BYTES = RECORD.size + 20 + len(MCAP0_MAGIC)
_LARGEST_CHUNK = 256 * 1024 * 1024
_MOST_UNPACKED = 64
"""Times the file's length: packets and samples that are all zeros come to 13."""
_FREE_UNPACKED = 4 * 1024 * 1024
_MAGIC_SEARCH = 1024 * 1024
_COMPRESSIONS = (b"\x04\0\0\0zstd", b"\x03\0\0\0lz4")


def looks_like_mcap(head: bytes) -> bool:
    """True where a file beginning with ``head`` was an MCAP, one damaged byte allowed."""
    same = sum(a == b for a, b in zip(head, MCAP0_MAGIC, strict=False))
    return same >= len(MCAP0_MAGIC) - 1


class McapScan:
    """One pass over an MCAP file.

    ``messages`` yields what is good and fills in everything else on its way: ``schemas``,
    ``channels``, ``metadata``, ``damage``; ``on_attachment`` is called for each attachment.

    Raises BadInputError where there is no such file, RecordingError where it cannot be read,
    is empty or is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = self.profile = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.damage: list[Damage] = []
        self.start_ns: int | None = None
        self.on_attachment: Callable[[Attachment], None] = lambda attachment: None
        self._file = FileWindow(path)
        self._budget = _FREE_UNPACKED + _MOST_UNPACKED * self._file.size
        self._decompress = zstandard.ZstdDecompressor().decompress
        self._data_crc: int | None = 0
        self._newest_ns: int | None = None
        self._unplaced: list[Damage] = []
        try:
            self._start = self._check_start()
            self._index_fault = self._read_index()
        except BaseException:
            self.close()
            raise

    @property
    def is_ours(self) -> bool:
        """True where this program wrote the file: then every checksum must be there."""
        return self.library.startswith("groundstation")

    def topic(self, channel_id: int) -> str:
        channel = self.channels.get(channel_id)
        return channel.topic if channel else ""

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def messages(self) -> Iterator[Message]:
        """Every readable message in the order of the file. To be consumed once, to its end."""
        offset = self._start
        size = self._file.size
        while offset < size:
            try:
                opcode, body = self._record(offset)
                if opcode == Opcode.DATA_END:
                    self._check_end(offset, body)
                    return
                contents = self._take(offset, opcode, body)
            except DamagedContentError as error:
                self._note(Damage(offset, error.length, str(error), chunks=error.chunks))
                self._data_crc = None
                offset += error.length
                continue
            except ValueError as error:
                self._data_crc = None
                found = self._next_chunk(offset)
                if found is None:
                    self._note(Damage(offset, size - offset, str(error)))
                    return
                start, end, contents = found
                self._note(Damage(offset, start - offset, str(error)))
                yield from self._unpack(start, contents)
                offset = end
                continue
            if contents is not None:
                yield from self._unpack(offset, contents)
            offset += RECORD.size + len(body)
        self._note(Damage(size, 0, "the recording was not finished: it ends without an index"))

    def is_at_end(self, damage: Damage) -> bool:
        """Whether it is only that the file ends there, as one that is being written does."""
        return damage.offset + damage.length >= self._file.size

    def _check_start(self) -> int:
        """The offset of the first record."""
        if not self._file.size:
            raise RecordingError(f"{self.path}: is empty (0 bytes)")
        head = bytes(self._file.view(0, min(self._file.size, len(MCAP0_MAGIC))))
        if head == MCAP0_MAGIC:
            self._data_crc = zlib.crc32(head)
            return len(head)
        if len(head) < len(MCAP0_MAGIC) and MCAP0_MAGIC.startswith(head):
            raise RecordingError(f"{self.path}: ends within the first {len(MCAP0_MAGIC)} bytes")
        if self._next_chunk(0, _MAGIC_SEARCH) is None:
            raise RecordingError(f"{self.path}: not an MCAP file")
        self._data_crc = None
        self._note(Damage(0, 0, "the file's opening mark is damaged"))
        return len(MCAP0_MAGIC)

    def _record(self, offset: int) -> tuple[int, memoryview]:
        """Opcode and body of the record at ``offset``. ValueError where it does not fit."""
        left = self._file.size - offset - RECORD.size
        if left < 0:
            raise ValueError("torn: the file ends inside a record")
        opcode, length = RECORD.unpack(self._file.view(offset, RECORD.size))
        if length > left:
            raise ValueError("torn: a record reaches beyond the end of the file")
        if length > _LARGEST_CHUNK:
            raise ValueError("a record is too long to be true")
        return opcode, self._file.view(offset + RECORD.size, length)

    def _take(self, offset: int, opcode: int, body: memoryview) -> Contents | None:
        """Use one record; the contents where it is a chunk (or a message without one)."""
        contents: Contents | None = None
        if opcode == Opcode.CHUNK:
            contents = self._chunk(body)
        elif opcode == Opcode.MESSAGE_INDEX:
            if len(body) < 6 or int.from_bytes(body[2:6], "little") != len(body) - 6:
                raise ValueError("a message index is damaged")
        elif opcode == Opcode.METADATA:
            self._add_metadata(body)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            contents = parse_contents(RECORD.pack(opcode, len(body)) + bytes(body))
        elif opcode == Opcode.ATTACHMENT:
            self.on_attachment(parse_attachment(body))
        elif opcode == Opcode.HEADER and offset == self._start:
            header = parsed(Header, body)
            self.profile, self.library = header.profile, header.library
        else:
            raise ValueError(f"a record of unknown kind {opcode}")
        if self._data_crc is not None:
            crc = zlib.crc32(RECORD.pack(opcode, len(body)), self._data_crc)
            self._data_crc = zlib.crc32(body, crc)
        return contents

    def _chunk(self, body: memoryview) -> Contents:
        """The verified contents of a chunk.

        Raises ValueError where its parts do not add up, DamagedContentError where they do
        and the content is bad.
        """
        chunk = parsed(Chunk, body)
        crc = chunk.uncompressed_crc
        try:
            return self._content(
                chunk.compression,
                chunk.data,
                chunk.uncompressed_size,
                crc if crc or self.is_ours else None,
            )
        except ValueError as error:
            raise DamagedContentError(str(error), RECORD.size + len(body), chunks=1) from error

    def _content(
        self, compression: str, packed: bytes | memoryview, size: int, crc: int | None
    ) -> Contents:
        if size > _LARGEST_CHUNK:
            raise ValueError("a chunk is too large to be true")
        if compression:
            self._budget -= size
            if self._budget < 0:
                raise ValueError(f"its chunks unpack to more than {_MOST_UNPACKED} times the file")
        try:
            if compression == "zstd":
                if zstandard.frame_content_size(packed) not in (size, -1):
                    raise ValueError("a chunk's size disagrees with its content")
                content = self._decompress(packed, max_output_size=size)
            elif compression == "lz4":
                content = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
            elif not compression:
                content = bytes(packed)
            else:
                raise ValueError(f"a chunk has unknown compression {compression!r}")
        except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
            raise ValueError("a chunk cannot be decompressed") from error
        if len(content) != size or (crc is not None and zlib.crc32(content) != crc):
            raise ValueError("a chunk's checksum does not match")
        return parse_contents(content)

    def _next_chunk(self, start: int, limit: int | None = None) -> tuple[int, int, Contents] | None:
        """Offset, end and contents of the first chunk from ``start`` on whose CRC agrees.

        Opcode and record length are not needed for that: the chunk's own fields say how long
        it is, and its CRC whether they are right.
        """
        stop = self._file.size if limit is None else min(self._file.size, start + limit)
        before = RECORD.size + _CHUNK_HEAD.size
        for at, mark in self._file.find(_COMPRESSIONS, start, stop):
            offset = at - before
            data_at = at + len(mark) + 8
            if offset < start or data_at > self._file.size:
                continue
            length = int.from_bytes(self._file.view(at + len(mark), 8), "little")
            if length > min(self._file.size - data_at, _LARGEST_CHUNK):
                continue
            *_, size, crc = _CHUNK_HEAD.unpack(
                self._file.view(offset + RECORD.size, _CHUNK_HEAD.size)
            )
            packed = self._file.view(data_at, length)
            try:
                return offset, data_at + length, self._content(mark[4:].decode(), packed, size, crc)
            except ValueError:
                continue
        return None

    def _unpack(self, offset: int, contents: Contents) -> Iterator[Message]:
        """Definitions are kept, messages yielded."""
        self._define(contents)
        if contents.first_ns is None:
            return
        self._place(contents.first_ns)
        unknown = 0
        for message in contents.messages():
            if message[0] in self.channels or self._recall_channel(message[0], message[3]):
                yield message
            else:
                unknown += 1
        self._newest_ns = contents.last_ns
        if unknown:
            self._note(Damage(offset, 0, f"{unknown} messages belong to no known channel"))

    def _recall_channel(self, channel_id: int, payload: memoryview | bytes) -> bool:
        """Define a channel whose chunk was lost, from the metadata this program writes, or, where
        the beginning of the file is lost with it, from what its messages are."""
        listed = [items for name, items in self.metadata if name == CHANNELS_METADATA]
        named = [items[str(channel_id)] for items in listed if str(channel_id) in items]
        topic = TOPICS.get(named[-1]) if named else None
        if topic is None and not listed and not self.library:
            topic = usual_topic(channel_id, payload)
        if topic is None:
            return False
        self.schemas[channel_id] = Schema(
            id=channel_id,
            name=topic.schema_name,
            encoding=topic.schema_encoding,
            data=topic.schema,
        )
        self.channels[channel_id] = Channel(
            id=channel_id,
            topic=topic.name,
            message_encoding=topic.message_encoding,
            schema_id=channel_id,
            metadata={},
        )
        return True

    def _add_metadata(self, body: memoryview) -> None:
        record = parsed(Metadata, body)
        name, items = record.name, record.metadata
        checksum = items.pop(CHECKSUM_KEY, None)
        if checksum is None and not self.is_ours:
            pass
        elif checksum != metadata_checksum(name, items.items()):
            raise DamagedContentError("a metadata record is damaged", RECORD.size + len(body))
        self.metadata.append((name, items))

    def _check_end(self, offset: int, body: memoryview) -> None:
        """The checksum over all before, and the index behind."""
        crc = parsed(DataEnd, body).data_section_crc
        if self._data_crc not in (None, crc) and (crc or self.is_ours):
            reason = (
                "checksum of the whole does not match; the messages have their own and are good"
            )
            self._note(Damage(offset, 0, reason))
        if self._index_fault:
            self._note(Damage(offset + RECORD.size + 4, 0, self._index_fault))

    def _read_index(self) -> str:
        """Take the definitions from the summary; a line where there is none or it is bad."""
        fault = "the index at the end is damaged; all messages are read without it"
        at = self._file.size - _FOOTER_BYTES
        if at < self._start:
            return fault
        tail = bytes(self._file.view(at, _FOOTER_BYTES))
        if tail[-len(MCAP0_MAGIC) :] != MCAP0_MAGIC or RECORD.unpack_from(tail) != (
            Opcode.FOOTER,
            20,
        ):
            return fault
        footer = parsed(Footer, tail[RECORD.size : -len(MCAP0_MAGIC)])
        start, crc = footer.summary_start, footer.summary_crc
        if not start:
            return ""
        if not self._start <= start <= at or at - start > _LARGEST_CHUNK:
            return fault
        summary = bytes(self._file.view(start, at - start))
        if (crc or self.is_ours) and zlib.crc32(tail[:-12], zlib.crc32(summary)) != crc:
            return fault
        try:
            self._define(parse_contents(summary))
        except ValueError:
            return fault
        return ""

    def _define(self, contents: Contents) -> None:
        self.schemas.update((schema.id, schema) for schema in contents.schemas)
        self.channels.update((channel.id, channel) for channel in contents.channels)

    def _note(self, damage: Damage) -> None:
        damage.before_ns = self._newest_ns
        self.damage.append(damage)
        self._unplaced.append(damage)

    def _place(self, time_ns: int) -> None:
        """A good message follows: the damage since the last one lies before it."""
        if self.start_ns is None:
            self.start_ns = time_ns
        for damage in self._unplaced:
            damage.after_ns = time_ns
        self._unplaced.clear()


# What a folder of recordings holds, from the ends of its files: fast, and always true.


_SUMMARY_MOST = 1 << 26
_LAST_NS = 1 << 62
"""Unix time of the year 2116."""


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One file. state: finished, recording (by whomever), or torn (it was never finished) or
    damaged: see ``recover``.

    What only a finished file tells is None for another.
    """

    file: str
    bytes: int
    state: str
    link: str | None = None
    session: str | None = None
    part: int | None = None
    start_ns: int | None = None
    duration_s: float | None = None
    samples: int | None = None
    raw_packets: int | None = None
    marks: int | None = None

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def catalogue(folder: Path, *, recording: Path | None = None) -> list[CatalogueEntry]:
    """Every MCAP file of ``folder`` by name; ``recording`` is the one being written.

    Raises RecordingError for a folder that cannot be read; none at all is an empty one.
    """
    try:
        with os.scandir(folder) as found:
            names = [one.name for one in found if one.name.endswith(".mcap") and one.is_file()]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be read: {error.strerror}") from error
    entries = []
    for name in sorted(names):
        path = folder / name
        with contextlib.suppress(FileNotFoundError):  # deleted meanwhile
            entries.append(_entry(path, is_open=path == recording))
    return entries


def _entry(path: Path, *, is_open: bool) -> CatalogueEntry:
    size = path.stat().st_size
    if is_open:
        return CatalogueEntry(path.name, size, "recording")
    try:
        with open(open_regular(path), "rb") as file:
            if not _has_end(file):
                return CatalogueEntry(path.name, size, "recording" if is_held(path) else "torn")
            (start_ns, end_ns), metadata = _end_of(file)
    except (OSError, ValueError):
        return CatalogueEntry(path.name, size, "damaged")
    session, totals = metadata.get("session", {}), metadata.get(TOTALS, {})
    return CatalogueEntry(
        file=path.name,
        bytes=size,
        state="finished",
        link=session.get("link"),
        session=session.get("session"),
        part=_number(session, "part"),
        start_ns=start_ns,
        duration_s=round((end_ns - start_ns) * 1e-9, 3),
        samples=_number(totals, "samples"),
        raw_packets=_number(totals, "raw_packets"),
        marks=_number(totals, "marks"),
    )


def _has_end(file: BinaryIO) -> bool:
    """Whether it ends as a finished file does, one damaged byte allowed."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - len(MCAP0_MAGIC)))
    return looks_like_mcap(file.read())


def is_held(path: Path) -> bool:
    """Whether somebody is writing the file: a recorder holds a lock. Raises OSError."""
    with open(open_regular(path), "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _end_of(file: BinaryIO) -> tuple[tuple[int, int], dict[str, dict[str, str]]]:
    """First and last time and the metadata, by way of the footer. Raises ValueError where that is
    damaged."""
    tail = RECORD.size + 20 + len(MCAP0_MAGIC)
    end = file.seek(0, os.SEEK_END) - tail
    ((opcode, body),) = _records(_read(file, end, RECORD.size + 20))
    footer = parsed(Footer, body)
    summary, offsets = footer.summary_start, footer.summary_offset_start
    if opcode != Opcode.FOOTER or not 0 < summary <= offsets <= end:
        raise ValueError("no index")
    content = _read(file, summary, end - summary + RECORD.size + 20)
    if footer.summary_crc and zlib.crc32(content[:-4]) != footer.summary_crc:
        raise ValueError("the index is damaged")
    times, places = None, []
    for _, offset in _records(content[offsets - summary : end - summary]):
        group = parsed(SummaryOffset, offset)
        start = group.group_start - summary
        if group.group_opcode not in (Opcode.STATISTICS, Opcode.METADATA_INDEX) or start < 0:
            continue  # of chunks there are thousands
        for kind, record in _records(content[start : start + group.group_length]):
            if kind == Opcode.STATISTICS:
                statistics = parsed(Statistics, record)
                times = (statistics.message_start_time, statistics.message_end_time)
            else:
                index = parsed(MetadataIndex, record)
                places.append((index.offset, index.length))
    if times is None or not times[0] <= times[1] < _LAST_NS:
        raise ValueError("no statistics")
    metadata = {}
    for offset, size in places:
        for _, record in _records(_read(file, offset, size)):
            metadatum = parsed(Metadata, record)
            name, items = metadatum.name, metadatum.metadata
            if items.pop(CHECKSUM_KEY, None) not in (None, metadata_checksum(name, items.items())):
                raise ValueError("a metadata record is damaged")
            metadata[name] = items
    return times, metadata


def _read(file: BinaryIO, offset: int, length: int) -> bytes:
    if not (0 <= offset < 1 << 62 and length <= _SUMMARY_MOST):
        raise ValueError("not an index")
    file.seek(offset)
    content = file.read(length)
    if len(content) != length:
        raise ValueError("ends too early")
    return content


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Kind and body of each record. Raises ValueError."""
    return ((kind, content[at : at + length]) for kind, at, length in records(content))


def _number(items: dict[str, str], key: str) -> int | None:
    text = items.get(key, "")
    return int(text) if text.isdecimal() else None


# Repair of torn and damaged MCAP files: what is readable goes into a fresh file.


RECOVERY_METADATA = "recovery"


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What a recovery found and did.

    output: the new file; None where the input is sound and nothing was done.
    messages: kept, of all topics.
    chunks_skipped: chunks whose framing was found and whose content was bad.
    bytes_lost: bytes of the input passed over.
    seconds_lost: upper bound of the recording time inside the damaged places, seconds; what
        is missing at a torn end is not in the file and not counted.
    damage: one line for each damaged place.
    """

    path: Path
    sound: bool
    output: Path | None
    messages: int
    chunks_skipped: int = 0
    bytes_lost: int = 0
    seconds_lost: float = 0.0
    damage: list[str] = field(default_factory=list)


def recover(path: Path, output: Path | None = None) -> RecoveryReport:
    """Rewrite what is readable of an MCAP file, of any program, into a fresh file.

    Keeps every topic, definition, attachment and metadata record that can be read, adds a
    metadata record that says what was lost, needs memory for one chunk at a time, and never
    touches its input. A sound file is left alone.

    output: by default ``<stem>.recovered.mcap`` beside the input.

    Raises BadInputError where there is no such file, it is being written, or the output exists;
    RecordingError where nothing can be read or the output cannot be written, and then leaves no
    output behind.
    """
    output = output or path.with_name(f"{path.stem}.recovered.mcap")
    report, profile = _examine(path)
    if report.sound:
        return report
    if is_held(path):
        raise BadInputError(f"{path}: is still being written; stop that recording first")
    if not report.messages:
        raise RecordingError(f"{path}: nothing to recover: no message can be read")
    if output.exists():
        raise BadInputError(taken(output))
    file = McapFile(output, profile=profile)
    try:
        with writing(output):
            with McapScan(path) as scan:
                _copy(scan, file)
            file.add_metadata(_free_name(scan), _summary(report))
            file.finish()
    except BaseException:
        file.abandon()
        with contextlib.suppress(OSError):
            output.unlink()
        raise
    return replace(report, output=output)


def _examine(path: Path) -> tuple[RecoveryReport, str]:
    """What can be read, and the file's profile."""
    with McapScan(path) as scan:
        messages = sum(1 for _ in scan.messages())
        report = RecoveryReport(
            path=path,
            sound=not scan.damage,
            output=None,
            messages=messages,
            chunks_skipped=sum(damage.chunks for damage in scan.damage),
            bytes_lost=sum(damage.length for damage in scan.damage),
            seconds_lost=sum(after - before for before, after in _lost_spans(scan)) / 1e9,
            damage=[damage.line(scan.start_ns) for damage in scan.damage],
        )
        return report, scan.profile


def _lost_spans(scan: McapScan) -> set[tuple[int, int]]:
    """Log times of the good messages around each place where bytes were passed over."""
    return {
        (damage.before_ns, damage.after_ns)
        for damage in scan.damage
        if damage.length
        and damage.before_ns is not None
        and damage.after_ns is not None
        and damage.before_ns < damage.after_ns
    }


def _copy(scan: McapScan, file: McapFile) -> None:
    """All messages, with the channels and definitions they need, then the metadata."""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}

    def register(channel: Channel) -> int:
        schema = scan.schemas.get(channel.schema_id)
        if channel.schema_id not in schemas:
            schemas[channel.schema_id] = (
                file.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            )
        return file.register_channel(
            channel.topic,
            channel.message_encoding,
            schemas[channel.schema_id],
            channel.metadata,
        )

    scan.on_attachment = file.add_attachment
    for channel_id, log_ns, publish_ns, payload in scan.messages():
        if channel_id not in channels:
            channels[channel_id] = register(scan.channels[channel_id])
        file.add_message(channels[channel_id], log_ns, payload, publish_ns)
    for channel_id, channel in scan.channels.items():  # those without a message
        if channel_id not in channels:
            channels[channel_id] = register(channel)
    for name, items in scan.metadata:
        if name != CHANNELS_METADATA:
            file.add_metadata(name, items)
    topics = {str(number): scan.topic(channel_id) for channel_id, number in channels.items()}
    file.add_metadata(CHANNELS_METADATA, topics)


def _free_name(scan: McapScan) -> str:
    """``recovery``, or ``recovery 2`` and so on where the input was a recovery itself."""
    taken = {name for name, _ in scan.metadata}
    name, number = RECOVERY_METADATA, 2
    while name in taken:
        name, number = f"{RECOVERY_METADATA} {number}", number + 1
    return name


def _summary(report: RecoveryReport) -> dict[str, str]:
    places = {f"damage_{n}": line for n, line in enumerate(report.damage, start=1)}
    return {
        "source": report.path.name,
        "messages": str(report.messages),
        "chunks_skipped": str(report.chunks_skipped),
        "bytes_lost": str(report.bytes_lost),
        "seconds_lost": f"{report.seconds_lost:.3f}",
        **places,
    }
