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
from groundstation.recording.column_map import jumps
from groundstation.recording.delimited import UTF_16
from groundstation.recording.mcap_scan import FileWindow, looks_like_mcap
from groundstation.recording.quality import sound
from groundstation.recording.ros_bag import is_bag, is_bag_folder, read_bag
from groundstation.recording.session import (
    CHANNELS,
    EVERY_ROW,
    NO_CHANNEL,
    UNCLEAR_METADATA,
    Recording,
    Rows,
)
from groundstation.recording.ulog_file import MAGIC as ULOG_MAGIC
from groundstation.text import some

# Formats that are known and not read: what a file is by its content, and what converts it.


_LFS = re.compile(rb"version https://git-lfs\.github\.com/spec/v1\s.*?size (\d+)", re.DOTALL)
_TLOG_US = (10**15, 4 * 10**15)
"""Unix time in us of a flight after 2001 and before 2096, with which a tlog begins."""


def _begins(*marks: bytes, at: int = 0) -> Callable[[bytes], bool]:
    """Whether a file has one of the marks at a place."""
    return lambda head: head[at:].startswith(marks)


def _is_workbook(head: bytes) -> bool:
    return head.startswith(b"PK\x03\x04") and (
        b"[Content_Types].xml" in head or b"xl/" in head or b"mimetypeapplication/vnd.oasis" in head
    )


def _is_tlog(head: bytes) -> bool:
    stamp_us = int.from_bytes(head[:8], "big")
    return head[8:9] in (b"\xfe", b"\xfd") and _TLOG_US[0] < stamp_us < _TLOG_US[1]


_UNPACK = "unpack it first"
_AS_CSV = "save its table as CSV, and name the columns with --columns"
_MAVLOGDUMP = "mavlogdump.py --format csv makes CSV"
UNREAD: tuple[tuple[Callable[[bytes], bool], str, str], ...] = (
    (_begins(b"H Product:Blackbox"), "a raw Betaflight blackbox log", "blackbox_decode makes CSV"),
    (_begins(b"\xa3\x95"), "an ArduPilot dataflash log", _MAVLOGDUMP),
    (_begins(b"FMT, "), "a text dump of an ArduPilot log", _MAVLOGDUMP),
    (_begins(b"\x89HDF\r\n\x1a\n"), "HDF5 (also MATLAB since 7.3)", _AS_CSV),
    (_begins(b"MATLAB 5.0 MAT-file"), "a MATLAB file", "writetable makes CSV"),
    (_begins(b"\x93NUMPY"), "a single numpy array", "numpy.savetxt makes CSV with a header"),
    (_begins(b"ARROW1"), "an Arrow (Feather) file", "pyarrow.parquet.write_table makes Parquet"),
    (_begins(b"TDSm"), "a LabVIEW TDMS file", _AS_CSV),
    (
        _begins(
            b"\x1f\x8b",
            b"BZh",
            b"\xfd7zXZ",
            b"\x28\xb5\x2f\xfd",
            b"7z\xbc\xaf",
            b"\x04\x22\x4d\x18",
        ),
        "a compressed file",
        _UNPACK,
    ),
    (
        _begins(b"RRF2", b"RRF1", b"RRF0", b"RRIO"),
        "a rerun recording",
        "give the recording that it was made of",
    ),
    (_begins(b"ustar", at=257), "a tar archive", _UNPACK),
    (
        _begins(b"\xd4\xc3\xb2\xa1", b"\x0a\x0d\x0d\x0a"),
        "a packet capture (pcap)",
        "record what its packets carry instead",
    ),
    (
        _begins(b"\x80\x03", b"\x80\x04", b"\x80\x05"),
        "a Python pickle",
        "to_csv or to_parquet in the program that made it",
    ),
    (
        _begins(b"<!DOCTYPE", b"<!doctype", b"<html", b"<HTML"),
        "a web page and no recording",
        "download the file itself ('raw')",
    ),
    (_begins(b"<?xml"), "an XML document", _AS_CSV),
    (_begins(b"%PDF"), "a PDF", "take the recording it was made of"),
    (_begins(b"\xd0\xcf\x11\xe0"), "an old Excel workbook", _AS_CSV),
    (_is_workbook, "a spreadsheet", _AS_CSV),
    (_is_tlog, "a MAVLink telemetry log", _MAVLOGDUMP),
    (
        lambda head: head[1:2] == b"P" and head[:1] < b" ",
        "a motion capture C3D file",
        "export it as CSV",
    ),
    (
        _begins(b"Format Version,", b"\xef\xbb\xbfFormat Version,"),
        "motion capture by OptiTrack alone, without gyro and motors",
        "join it with the craft's own log, or read it with 'skip' in a column map",
    ),
)
"""How such files begin, the format, and what makes something that is read of it."""


def refuse_unread(path: Path, head: bytes) -> None:
    """Raises BadInputError where a file's first bytes are those of a known format that is not read,
    or of a Git LFS pointer in its place."""
    pointer = _LFS.match(head)
    if pointer:
        raise BadInputError(
            f"{path}: a Git LFS pointer, not the file itself ({int(pointer[1])} bytes):"
            " git lfs pull"
        )
    for has, what, way in UNREAD:
        if has(head):
            raise BadInputError(f"{path}: {what}, which is not read; {way}")


# The formats of recordings: how a file is told to have one, what reads it, what writes it.
#
# Readers and writers are named, not imported: each is loaded only where it is used.


_MICROSD_MAGIC = tuple(b"\xbc" + bytes([version, 0]) for version in range(1, 10))
"""Its first byte and the version behind it; later versions are told by their reader."""
_ZIP_MAGIC = b"PK\x03\x04"
_KINDS = {
    **{"csv_file": "table", "parquet_file": "Parquet table"},
    **{"microsd": "microSD log", "ulog_file": "ULog", "ros_bag": "ROS bag or MCAP file"},
    **{"npz_file": "file of the stand-in"},
}
"""What a reader's module reads, in a user's words."""


def is_text(head: bytes) -> bool:
    """True for UTF-8, UTF-16 or Latin-1 text, possibly cut inside a character."""
    if head[:2] in UTF_16:
        return True
    control = set(range(32)) - {9, 10, 12, 13}
    return not control.intersection(head)


@dataclass(frozen=True, slots=True)
class Format:
    """has: told by a file's first bytes. reader, writer: ``module.function`` in this package, empty
    where the format is only written, or only read; writers go by the new file's suffix. takes_map:
    a column map may say what its columns are. chooses: reads the rows of one craft alone, if that
    is asked for."""

    has: Callable[[bytes], bool]
    reader: str
    suffix: str = ""
    writer: str = ""
    keeps_raw: bool = False
    takes_map: bool = False
    chooses: bool = False


# A CSV of another program is no row here: it is a file in ``maps/`` (``map_document.py``).
FORMATS = (
    Format(is_bag, "ros_bag.read_bag", takes_map=True, chooses=True),
    Format(_begins(ULOG_MAGIC), "ulog_file.read_ulog", takes_map=True),
    Format(
        looks_like_mcap,
        "ros_bag.read_recovered",
        ".mcap",
        "mcap_file.write_mcap",
        keeps_raw=True,
        takes_map=True,
    ),
    Format(
        _begins(b"PAR1"),
        "parquet_file.read_parquet",
        ".parquet",
        "parquet_file.write_parquet",
        takes_map=True,
        chooses=True,
    ),
    Format(_begins(), "", ".rrd", "rrd.write_rrd"),
    Format(_begins(*_MICROSD_MAGIC), "microsd.read_microsd", takes_map=True),
    Format(_begins(_ZIP_MAGIC), "npz_file.read_npz", keeps_raw=True),
    Format(
        is_text, "csv_file.read_csv", ".csv", "csv_file.write_csv", takes_map=True, chooses=True
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
        if rows and not one.chooses:
            raise BadInputError(
                f"{path}: --only and --rate are for tables (CSV, Parquet), --only for bags"
            )
        if source is not None and not one.takes_map:
            break
        options: dict[str, Any] = {"rows": rows} if rows else {}
        options |= {"raw": raw} if one.keeps_raw else {}
        options |= {"source": source} if source is not None else {}
        return checked(_read(path, one.reader, options))
    if source is None:
        raise RecordingError(
            f"{path}: neither MCAP, CSV, a microSD log, a ROS bag, a ULog, a Parquet table"
            " nor the stand-in's .npz"
        )
    raise BadInputError(
        f"{path}: not a CSV file, Parquet table, microSD log, ROS bag or ULog, so it takes no"
        " column map"
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
    unclear = recording.metadata.setdefault(UNCLEAR_METADATA, {})
    names = [name for table in recording.tables.values() for name in table.columns]
    if names and not any(channel.is_in(recording.samples) for channel in CHANNELS):
        unclear[NO_CHANNEL] = (
            f"there are {some(names)}; say which channel each is with"
            " 'groundstation convert FILE --map', and read the file with --columns"
        )
    if recording.kind != "mcap" and (jumping := jumps(recording.samples)):
        unclear.setdefault("rows", jumping)
    if not unclear:
        del recording.metadata[UNCLEAR_METADATA]
    return recording


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
        the program (``map_document.NAMED``), or a TOML file.
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
    ``quality.rejections`` does not believe; ``quality.rejected`` says what that is.

    Raises BadInputError or RecordingError, one line each, for what cannot be read.
    """
    return sound(open_recording(path))
