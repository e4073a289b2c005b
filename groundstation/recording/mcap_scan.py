"""Reading an MCAP file front to back, trusting nothing that no checksum covers.

Torn, flipped and foreign files are the normal case here. Every record is taken apart
strictly; a chunk counts only when its CRC agrees; where the framing is broken, the next chunk
whose CRC agrees is looked for. What was passed over is listed, never hidden.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    Metadata,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from groundstation.errors import RecordingError
from groundstation.recording.file_window import FileWindow
from groundstation.recording.mcap_file import CHECKSUM_KEY
from groundstation.recording.mcap_records import (
    RECORD,
    Contents,
    Damage,
    DamagedContentError,
    Message,
    parse_attachment,
    parse_contents,
    parsed,
)
from groundstation.recording.mcap_schemas import TOPICS, metadata_checksum, usual_topic
from groundstation.recording.recording_file import CHANNELS_METADATA

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
