"""MCAP records taken apart strictly: no field reaches beyond its record, none is left over."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

RECORD = struct.Struct("<BQ")
"""Opcode and length before every record's body."""
_MESSAGE = struct.Struct("<HIQQ")

Message = tuple[int, int, int, memoryview]
"""Channel id, log time (ns), publish time (ns), payload."""


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
            if log_ns < first_ns:
                first_ns = log_ns
            if log_ns > last_ns:
                last_ns = log_ns
            found.places.extend((at, length))
        elif opcode == Opcode.SCHEMA:
            fields = Fields(view[at : at + length])
            schema_id, name, encoding = fields.u16(), fields.text(), fields.text()
            data = bytes(fields.rest(fields.u32()))
            fields.end()
            found.schemas.append(Schema(id=schema_id, name=name, encoding=encoding, data=data))
        elif opcode == Opcode.CHANNEL:
            fields = Fields(view[at : at + length])
            channel_id, schema_id = fields.u16(), fields.u16()
            topic, encoding, metadata = fields.text(), fields.text(), fields.table()
            fields.end()
            found.channels.append(
                Channel(
                    id=channel_id,
                    topic=topic,
                    message_encoding=encoding,
                    metadata=metadata,
                    schema_id=schema_id,
                )
            )
        at += length
    if found.places:
        found.first_ns, found.last_ns = first_ns, last_ns
    return found


def parse_attachment(body: memoryview) -> Attachment:
    """Raises ValueError, DamagedContentError where its checksum does not match."""
    fields = Fields(body)
    log_time, create_time = fields.u64(), fields.u64()
    name, media_type = fields.text(), fields.text()
    data = bytes(fields.rest(fields.u64()))
    crc = fields.u32()
    fields.end()
    if crc and zlib.crc32(body[:-4]) != crc:
        raise DamagedContentError("an attachment is damaged", RECORD.size + len(body))
    return Attachment(
        create_time=create_time,
        log_time=log_time,
        name=name,
        media_type=media_type,
        data=data,
    )


class DamagedContentError(ValueError):
    """The record's framing is sound, so the next one can be found; its content is not."""

    def __init__(self, reason: str, length: int, chunks: int = 0) -> None:
        super().__init__(reason)
        self.length = length
        self.chunks = chunks


class Fields:
    """The fields of one record, none beyond its end. Raises ValueError."""

    def __init__(self, body: memoryview) -> None:
        self._body = body
        self._at = 0

    def rest(self, length: int) -> memoryview:
        part = self._body[self._at : self._at + length]
        if len(part) != length:
            raise ValueError("a record's parts are longer than the record")
        self._at += length
        return part

    def u16(self) -> int:
        return int.from_bytes(self.rest(2), "little")

    def u32(self) -> int:
        return int.from_bytes(self.rest(4), "little")

    def u64(self) -> int:
        return int.from_bytes(self.rest(8), "little")

    def text(self) -> str:
        try:
            return str(self.rest(self.u32()), "utf-8")
        except UnicodeDecodeError as error:
            raise ValueError("a record's text is damaged") from error

    def table(self) -> dict[str, str]:
        inner = Fields(self.rest(self.u32()))
        items = {}
        while not inner.at_end:
            key = inner.text()
            items[key] = inner.text()
        return items

    @property
    def at_end(self) -> bool:
        return self._at == len(self._body)

    def end(self) -> None:
        if not self.at_end:
            raise ValueError("a record is longer than its parts")
