"""What a folder of recordings holds, from the ends of its files: fast, and always true."""

from __future__ import annotations

import contextlib
import fcntl
import os
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

from mcap.opcode import Opcode
from mcap.records import Footer, Metadata, MetadataIndex, Statistics, SummaryOffset
from mcap.writer import MCAP0_MAGIC

from groundstation.documents import open_regular
from groundstation.errors import RecordingError
from groundstation.recording.mcap_file import CHECKSUM_KEY
from groundstation.recording.mcap_records import RECORD, parsed
from groundstation.recording.mcap_scan import looks_like_mcap
from groundstation.recording.mcap_schemas import metadata_checksum

TOTALS = "totals"
"""Metadata record that a finished recording ends with."""

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
    at = 0
    while at < len(content):
        if at + RECORD.size > len(content):
            raise ValueError("ends inside a record")
        kind, length = RECORD.unpack_from(content, at)
        at += RECORD.size
        yield kind, content[at : at + length]
        at += length


def _number(items: dict[str, str], key: str) -> int | None:
    text = items.get(key, "")
    return int(text) if text.isdecimal() else None
