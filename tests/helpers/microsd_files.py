"""Writes microSD logs record by record, as the card deck does."""

import struct
import zlib

FIXED = 0xFFFF


def header_bytes(events, version=2):
    """``events``: id -> (name, {variable: struct letter})."""
    parts = [struct.pack("<BHH", 0xBC, version, len(events))]
    for number, (name, variables) in events.items():
        parts.append(struct.pack("<H", number) + name.encode() + b"\0")
        parts.append(struct.pack("<H", len(variables)))
        parts += [
            f"{variable}({letter})".encode() + b"\0" for variable, letter in variables.items()
        ]
    return b"".join(parts)


def record_bytes(events, number, time, values, version=2):
    """One record; ``time`` in the version's own unit (ms or us)."""
    letters = "".join(events[number][1].values())
    return struct.pack("<H" + ("I" if version == 1 else "Q") + letters, number, time, *values)


def log_bytes(events, records, version=2):
    """A whole file; ``records``: (id, time, values)."""
    body = header_bytes(events, version)
    body += b"".join(record_bytes(events, *record, version) for record in records)
    return body + struct.pack("<I", zlib.crc32(body))
