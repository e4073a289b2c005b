"""What a folder of recordings holds, from the ends of its files: fast, and always true."""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata, MetadataIndex, Statistics, SummaryOffset
from mcap.writer import MCAP0_MAGIC

TOTALS = "totals"
"""Metadata record that a finished recording ends with."""

_FOOTER = struct.Struct("<BQQQI")
_RECORD = struct.Struct("<BQ")
_SUMMARY_MOST = 1 << 20


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One file. state: finished, torn (it was never finished, see ``recover``) or recording.

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
    """Every MCAP file of ``folder`` by name; ``recording`` is the one being written."""
    entries = []
    for path in sorted(folder.glob("*.mcap")) if folder.is_dir() else ():
        if not path.is_file():
            continue  # a pipe would be waited for for ever
        try:
            entries.append(_entry(path, is_open=path == recording))
        except FileNotFoundError:
            continue  # deleted meanwhile
    return entries


def _entry(path: Path, *, is_open: bool) -> CatalogueEntry:
    size = path.stat().st_size
    if is_open:
        return CatalogueEntry(path.name, size, "recording")
    try:
        with path.open("rb") as file:
            statistics, metadata = _end_of(file)
    except (OSError, ValueError, struct.error):
        return CatalogueEntry(path.name, size, "torn")
    session, totals = metadata.get("session", {}), metadata.get(TOTALS, {})
    start_ns, end_ns = statistics.message_start_time, statistics.message_end_time
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


def _end_of(file: BinaryIO) -> tuple[Statistics, dict[str, dict[str, str]]]:
    """Statistics and metadata by way of the footer. Raises ValueError where there is none."""
    tail = _FOOTER.size + len(MCAP0_MAGIC)
    size = file.seek(0, os.SEEK_END)
    if size < tail:
        raise ValueError("too short")
    file.seek(size - tail)
    opcode, _, summary, offsets, _ = _FOOTER.unpack(file.read(_FOOTER.size))
    if opcode != Opcode.FOOTER or file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise ValueError("no footer")
    if not 0 < summary <= offsets <= size - tail:
        raise ValueError("no index")
    statistics, places = None, []
    for opcode, body in _records(file, offsets, size - tail - offsets):
        if opcode != Opcode.SUMMARY_OFFSET:
            continue
        group = SummaryOffset.read(ReadDataStream(body))
        for kind, content in _records(file, group.group_start, group.group_length):
            if kind == Opcode.STATISTICS:
                statistics = Statistics.read(ReadDataStream(content))
            elif kind == Opcode.METADATA_INDEX:
                places.append(MetadataIndex.read(ReadDataStream(content)))
            else:
                break
    if statistics is None:
        raise ValueError("no statistics")
    metadata = {}
    for place in places:
        for _, content in _records(file, place.offset, place.length):
            record = Metadata.read(ReadDataStream(content))
            metadata[record.name] = record.metadata
    return statistics, metadata


def _records(file: BinaryIO, start: int, length: int) -> Iterator[tuple[int, BinaryIO]]:
    at = start
    while at + _RECORD.size <= start + length:
        file.seek(at)
        opcode, size = _RECORD.unpack(file.read(_RECORD.size))
        if size > _SUMMARY_MOST:
            raise ValueError("not an index")
        yield opcode, io.BytesIO(file.read(size))
        at += _RECORD.size + size


def _number(items: dict[str, str], key: str) -> int | None:
    text = items.get(key, "")
    return int(text) if text.isdecimal() else None
