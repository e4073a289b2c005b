"""Formats that are known and not read: what a file is by its content, and what converts it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from groundstation.errors import BadInputError

_LFS = re.compile(rb"version https://git-lfs\.github\.com/spec/v1\s.*?size (\d+)", re.DOTALL)
_TLOG_US = (10**15, 4 * 10**15)
"""Unix time in us of a flight after 2001 and before 2096, with which a tlog begins."""


@dataclass(frozen=True, slots=True)
class Unread:
    """begins: how such files begin, at ``at``. what: the format. way: what makes something that is
    read of it."""

    begins: bytes | tuple[bytes, ...]
    what: str
    way: str
    at: int = 0

    def has(self, head: bytes) -> bool:
        return head[self.at :].startswith(self.begins)


_UNPACK = "unpack it first"
_AS_CSV = "save its table as CSV, and name the columns with --columns"
UNREAD = (
    Unread(b"H Product:Blackbox", "a raw Betaflight blackbox log", "blackbox_decode makes CSV"),
    Unread(b"\xa3\x95", "an ArduPilot dataflash log", "mavlogdump.py --format csv makes CSV"),
    Unread(b"FMT, ", "a text dump of an ArduPilot log", "mavlogdump.py --format csv makes CSV"),
    Unread(b"\x89HDF\r\n\x1a\n", "HDF5 (also MATLAB since 7.3)", _AS_CSV),
    Unread(b"MATLAB 5.0 MAT-file", "a MATLAB file", "writetable makes CSV"),
    Unread(b"\x93NUMPY", "a single numpy array", "numpy.savetxt makes CSV with a header"),
    Unread(b"ARROW1", "an Arrow (Feather) file", "pyarrow.parquet.write_table makes Parquet"),
    Unread(b"TDSm", "a LabVIEW TDMS file", _AS_CSV),
    Unread(
        (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf", b"\x04\x22\x4d\x18"),
        "a compressed file",
        _UNPACK,
    ),
    Unread(
        (b"RRF2", b"RRF1", b"RRF0", b"RRIO"),
        "a rerun recording",
        "give the recording that it was made of",
    ),
    Unread(b"ustar", "a tar archive", _UNPACK, at=257),
    Unread(
        (b"\xd4\xc3\xb2\xa1", b"\x0a\x0d\x0d\x0a"),
        "a packet capture (pcap)",
        "record what its packets carry instead",
    ),
    Unread(
        (b"\x80\x03", b"\x80\x04", b"\x80\x05"),
        "a Python pickle",
        "to_csv or to_parquet in the program that made it",
    ),
    Unread(
        (b"<!DOCTYPE", b"<!doctype", b"<html", b"<HTML"),
        "a web page and no recording",
        "download the file itself ('raw')",
    ),
    Unread(b"<?xml", "an XML document", _AS_CSV),
    Unread(b"%PDF", "a PDF", "take the recording it was made of"),
    Unread((b"\xd0\xcf\x11\xe0",), "an old Excel workbook", _AS_CSV),
)
"""By what a file begins with."""


def refuse_unread(path: Path, head: bytes) -> None:
    """Raises BadInputError where a file's first bytes are those of a known format that is not read,
    or of a Git LFS pointer in its place."""
    pointer = _LFS.match(head)
    if pointer:
        raise BadInputError(
            f"{path}: a Git LFS pointer, not the file itself ({int(pointer[1])} bytes):"
            " git lfs pull"
        )
    for one in UNREAD:
        if one.has(head):
            raise BadInputError(f"{path}: {one.what}, which is not read; {one.way}")
    for has, what, way in _BY_RULE:
        if has(head):
            raise BadInputError(f"{path}: {what}, which is not read; {way}")


def _is_workbook(head: bytes) -> bool:
    return head.startswith(b"PK\x03\x04") and (
        b"[Content_Types].xml" in head or b"xl/" in head or b"mimetypeapplication/vnd.oasis" in head
    )


def _is_tlog(head: bytes) -> bool:
    stamp_us = int.from_bytes(head[:8], "big")
    return head[8:9] in (b"\xfe", b"\xfd") and _TLOG_US[0] < stamp_us < _TLOG_US[1]


def _is_c3d(head: bytes) -> bool:
    return head[1:2] == b"P" and head[:1] < b" "


def _is_optitrack(head: bytes) -> bool:
    return head.removeprefix(b"\xef\xbb\xbf").startswith(b"Format Version,")


_Rule = tuple[Callable[[bytes], bool], str, str]
_BY_RULE: tuple[_Rule, ...] = (
    (_is_workbook, "a spreadsheet", _AS_CSV),
    (_is_tlog, "a MAVLink telemetry log", "mavlogdump.py --format csv makes CSV"),
    (_is_c3d, "a motion capture C3D file", "export it as CSV"),
    (
        _is_optitrack,
        "motion capture by OptiTrack alone, without gyro and motors",
        "join it with the craft's own log, or read it with 'skip' in a column map",
    ),
)
"""What takes more than its first bytes to tell."""
