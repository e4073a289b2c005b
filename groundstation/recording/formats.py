"""The formats that are read and written, and how a recording is opened."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from groundstation.documents import read_document, seems
from groundstation.errors import BadInputError, GroundStationError, RecordingError
from groundstation.recording.column_map import NO_CHANNEL, UNCLEAR_METADATA, jumps
from groundstation.recording.delimited import UTF_16
from groundstation.recording.mcap_scan import FileWindow, looks_like_mcap
from groundstation.recording.ros_bag import is_bag, is_bag_folder, read_bag
from groundstation.recording.session import CHANNELS, EVERY_ROW, Recording, Rows
from groundstation.recording.soundness import sound
from groundstation.recording.ulog_file import MAGIC as ULOG_MAGIC

# Formats that are known and not read: what a file is by its content, and what converts it.


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


# The formats of recordings: how a file is told to have one, what reads it, what writes it.
#
# Readers and writers are named, not imported: each is loaded only where it is used.


_MICROSD_MAGIC = tuple(b"\xbc" + bytes([version, 0]) for version in range(1, 10))
"""Its first byte and the version behind it; later versions are told by their reader."""
_ZIP_MAGIC = b"PK\x03\x04"
_KINDS = {
    **{"csv_file": "table", "column_map": "table", "parquet_file": "Parquet table"},
    **{"microsd": "microSD log", "ulog_file": "ULog", "ros_bag": "ROS bag or MCAP file"},
    **{"npz_file": "file of the stand-in"},
}
"""What a reader's module reads, in a user's words."""
NAMED_MOST = 12
"""Columns that are named where none is of a channel."""


def is_text(head: bytes) -> bool:
    """True for UTF-8, UTF-16 or Latin-1 text, possibly cut inside a character."""
    if head[:2] in UTF_16:
        return True
    control = set(range(32)) - {9, 10, 12, 13}
    return not control.intersection(head)


@dataclass(frozen=True, slots=True)
class Format:
    """has: told by a file's first bytes. reader, writer: ``module.function`` in this package, empty
    where the format is only written, or only read; writers go by the new file's suffix. mapped:
    reads by a column map, empty where the format takes none. chooses: reads the rows of one craft
    alone, if that is asked for."""

    has: Callable[[bytes], bool]
    reader: str
    suffix: str = ""
    writer: str = ""
    keeps_raw: bool = False
    mapped: str = ""
    chooses: bool = False


FORMATS = (
    Format(is_bag, "ros_bag.read_bag", mapped="ros_bag.read_bag", chooses=True),
    Format(
        lambda head: head.startswith(ULOG_MAGIC),
        "ulog_file.read_ulog",
        mapped="ulog_file.read_ulog",
    ),
    Format(
        looks_like_mcap,
        "ros_bag.read_recovered",
        ".mcap",
        "mcap_file.write_mcap",
        keeps_raw=True,
        mapped="ros_bag.read_bag",
    ),
    Format(
        lambda head: head.startswith(b"PAR1"),
        "parquet_file.read_parquet",
        ".parquet",
        "parquet_file.write_parquet",
        mapped="parquet_file.read_parquet",
        chooses=True,
    ),
    Format(lambda head: False, "", ".rrd", "rrd.write_rrd"),
    Format(
        lambda head: head.startswith(_MICROSD_MAGIC),
        "microsd.read_microsd",
        mapped="microsd.read_microsd",
    ),
    Format(lambda head: head.startswith(_ZIP_MAGIC), "npz_file.read_npz", keeps_raw=True),
    Format(
        is_text,
        "csv_file.read_csv",
        ".csv",
        "csv_file.write_csv",
        mapped="column_map.read_mapped_csv",
        chooses=True,
    ),
)
"""In the order in which they are tried: text is what is none of the others."""


def read_as(
    path: Path,
    head: bytes,
    raw: bool,
    source: str | Path | None = None,
    rows: Rows = EVERY_ROW,
) -> Recording:
    """Read a file by what its first bytes are, with a column map where one is given.

    Raises RecordingError for a format that is not known here, BadInputError for one that has no
    columns to name or no rows to choose, and as its reader does.
    """
    for one in FORMATS:
        if not one.has(head):
            continue
        if not one.chooses:
            require_every_row(path, rows)
        options: dict[str, Any] = {"rows": rows} if rows else {}
        if source is None:
            options |= {"raw": raw} if one.keeps_raw else {}
            return checked(_read(path, one.reader, options))
        if not one.mapped:
            break
        return checked(_read(path, one.mapped, {"source": source, **options}))
    if source is None:
        raise RecordingError(
            f"{path}: neither MCAP, CSV, a microSD log, a ROS bag, a ULog, a Parquet table"
            " nor the stand-in's .npz"
        )
    raise BadInputError(
        f"{path}: not a CSV file, Parquet table, microSD log, ROS bag or ULog, so it takes no"
        " column map"
    )


def require_every_row(path: Path, rows: Rows) -> None:
    """Raises BadInputError where rows of a file are chosen that is no table."""
    if rows:
        raise BadInputError(
            f"{path}: --only and --rate are for tables (CSV, Parquet), --only for bags"
        )


def _read(path: Path, reader: str, options: dict[str, Any]) -> Recording:
    """Raises RecordingError for whatever a reader did not expect of a stranger's file."""
    try:
        recording: Recording = _function(reader)(path, **options)
    except (GroundStationError, MemoryError):
        raise
    except Exception as error:
        name = _KINDS.get(reader.partition(".")[0], "recording")
        raise RecordingError(
            f"{path}: no {name} that this program can read: it is damaged, or written in a way that"
            " is not known here. Copy it again; if it is sound, report it with the file"
        ) from error
    return recording


def checked(recording: Recording) -> Recording:
    """A recording with what its rows leave open, whatever its format."""
    _say_without_channels(recording)
    if recording.kind != "mcap" and (jumping := jumps(recording.samples)):
        recording.metadata.setdefault(UNCLEAR_METADATA, {}).setdefault("rows", jumping)
    return recording


def _say_without_channels(recording: Recording) -> None:
    """Name the columns that a file has where none of them is a channel's."""
    if any(channel.is_in(recording.samples) for channel in CHANNELS):
        return
    names = [name for table in recording.tables.values() for name in table.columns]
    if names:
        more = f" and {len(names) - NAMED_MOST} more" if len(names) > NAMED_MOST else ""
        unclear = recording.metadata.setdefault(UNCLEAR_METADATA, {})
        unclear[NO_CHANNEL] = (
            f"there are {', '.join(names[:NAMED_MOST])}{more}; say which channel each is with"
            " 'groundstation convert FILE --map', and read the file with --columns"
        )


def writer_of(
    path: Path, *, physical: bool = False, ros2_hz: float = 0.0
) -> Callable[[Recording, Path], None]:
    """What writes a new file of this name. physical: CSV in physical units. ros2_hz: MCAP with so
    many rows a second for ROS 2's tools.

    Raises BadInputError where no format has its suffix.
    """
    suffix = path.suffix.lower()
    if ros2_hz:
        if suffix != ".mcap":
            raise BadInputError(f"{path}: --ros2 is for MCAP files")
        return partial(_function("mcap_file.write_mcap"), ros2_hz=ros2_hz)
    if physical:
        if suffix != ".csv":
            raise BadInputError(f"{path}: --physical is for CSV files")
        return _function("csv_file.write_table_csv")
    for one in FORMATS:
        if one.writer and one.suffix == suffix:
            return _function(one.writer)
    known = sorted(one.suffix for one in FORMATS if one.writer)
    raise BadInputError(f"{path}: the name must end in {', '.join(known[:-1])} or {known[-1]}")


def _function(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(".")
    found: Callable[..., Any] = getattr(
        import_module(f"groundstation.recording.{module}"), function
    )
    return found


# Any readable recording, told by its content.


_HEAD_BYTES = 4096


def open_recording(
    path: str | Path,
    *,
    raw: bool = False,
    column_map: str | Path | None = None,
    rows: Rows = EVERY_ROW,
) -> Recording:
    """Read an MCAP, CSV or microSD recording, a ROS bag (also its folder), a ULog or a
    Parquet table, whatever its name ends with.

    raw: also the packets as received, where the file has them.
    column_map: what the columns of another program's file mean: the name of a map that ships with
        the program (``column_map.NAMED``), or a TOML file.
    rows: which of a table are read, and how many a second there are where no column says it.

    Raises BadInputError or RecordingError, one line each, where the file does not exist,
    cannot be read, or is nothing that is known here.
    """
    path = Path(path)
    if is_bag_folder(path):
        return checked(read_bag(path, column_map, rows))
    window = FileWindow(path)
    try:
        head = bytes(window.view(0, min(window.size, _HEAD_BYTES)))
    finally:
        window.close()
    if not head:
        raise RecordingError(f"{path}: is empty (0 bytes)")
    if column_map is None or not is_text(head):
        refuse_unread(path, head)
    if head.lstrip()[:1] == b"{":
        raise BadInputError(f"{path}: not a recording{seems(read_document(path))}")
    return read_as(path, head, raw, column_map, rows)


# A recording as every analysis takes it: what is not believed of it is missing.


def open_for_analysis(path: str | Path) -> Recording:
    """Read a recording as ``open_recording`` does, and take as missing (NaN) what
    ``soundness.rejections`` does not believe; ``soundness.rejected`` says what that is.

    Raises BadInputError or RecordingError, one line each, for what cannot be read.
    """
    return sound(open_recording(path))
