"""Message definitions in CDR: little-endian structures of numbers and number sequences.

CDR (OMG Common Data Representation, version 1, as ROS 2 uses it) is a 4-byte header followed
by the fields in order; each number is aligned to its own size, counted from the end of the
header, and a sequence is a u32 count followed by its numbers. That is all a batch of columns
needs, and every tool that knows ROS 2 reads it, given the definition text.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

HEADER = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian."""

_TYPES = {
    "int8": "<i1",
    "uint8": "<u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
_LENGTH = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Field:
    """One line of a definition."""

    name: str
    dtype: np.dtype[Any]
    size: int
    """Bytes of one number."""
    sequence: bool


@dataclass(frozen=True, slots=True)
class Definition:
    """A flat message definition: numbers and sequences of numbers, nothing nested."""

    text: str
    fields: tuple[Field, ...]

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a ``ros2msg`` definition such as ``float32[] gyro_rad_s``.

        Raises ValueError on a line that is not a number or an unbounded number sequence.
        """
        fields = []
        for line in text.splitlines():
            words = line.split("#", 1)[0].split()
            if not words:
                continue
            kind, name = (words[0], words[1]) if len(words) == 2 else (line, "")
            base = kind.removesuffix("[]")
            if base not in _TYPES or not name:
                raise ValueError(f"definition line {line!r} is not a number or a number sequence")
            dtype = np.dtype(_TYPES[base])
            fields.append(Field(name, dtype, dtype.itemsize, kind.endswith("[]")))
        return cls(text, tuple(fields))

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """One message. ``values`` has a number or an array (any shape, row-major) per field."""
        out = bytearray()
        for field in self.fields:
            data = np.ascontiguousarray(values[field.name], field.dtype)
            size = field.size
            if field.sequence:
                out += b"\0" * (-len(out) & 3)
                out += _LENGTH.pack(data.size)
                if data.size:
                    out += b"\0" * (-len(out) & (size - 1))
            else:
                out += b"\0" * (-len(out) & (size - 1))
            out += data.tobytes()
        return HEADER + bytes(out)

    def slices(self, payload: bytes | memoryview) -> list[memoryview]:
        """The bytes of each field in order, without copying.

        Raises ValueError where the payload is not one whole message of this definition.
        """
        view = memoryview(payload)
        if view[:2] != HEADER[:2]:
            raise ValueError("message is not little-endian CDR")
        body = view[4:]
        total = len(body)
        offset = 0
        parts = []
        for field in self.fields:
            size = field.size
            count = 1
            if field.sequence:
                offset += -offset & 3
                if offset + 4 > total:
                    raise ValueError(f"message ends before {field.name}")
                count = _LENGTH.unpack_from(body, offset)[0]
                offset += 4
            if count:
                offset += -offset & (size - 1)
            end = offset + count * size
            if end > total:
                raise ValueError(f"message ends inside {field.name}")
            parts.append(body[offset:end])
            offset = end
        if total - offset > 3:  # some encoders round the length up to four bytes
            raise ValueError(f"message has {total - offset} bytes too many")
        return parts

    def decode(self, payload: bytes | memoryview) -> dict[str, NDArray[Any]]:
        """Field name -> array (of length 1 for a plain number), views into ``payload``.

        Raises ValueError where the payload is not one whole message of this definition.
        """
        return {
            field.name: np.frombuffer(part, field.dtype)
            for field, part in zip(self.fields, self.slices(payload), strict=True)
        }
