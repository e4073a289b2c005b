"""MCAP records taken apart strictly: no field reaches beyond its record, none is left over."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Schema

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


def parse_contents(content: bytes) -> Contents:
    """Messages and definitions in a chunk or a summary. Raises ValueError."""
    view = memoryview(content)
    found = Contents(view)
    first_ns, last_ns = 1 << 64, 0
    at, total = 0, len(view)
    while at < total:
        if at + RECORD.size > total:
            raise ValueError("a chunk ends inside a record")
        opcode, length = RECORD.unpack_from(view, at)
        at += RECORD.size
        if at + length > total:
            raise ValueError("a chunk ends inside a record")
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
        at += length
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
