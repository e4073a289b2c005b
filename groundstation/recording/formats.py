"""The formats of recordings: how a file is told to have one, what reads it, what writes it.

Readers and writers are named, not imported: each is loaded only where it is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from groundstation.errors import BadInputError, GroundStationError, RecordingError
from groundstation.recording.channels import CHANNELS
from groundstation.recording.column_map import NO_CHANNEL, UNCLEAR_METADATA
from groundstation.recording.delimited import UTF_16
from groundstation.recording.mcap_scan import looks_like_mcap
from groundstation.recording.ros_bag import is_bag
from groundstation.recording.rows import EVERY_ROW, Rows
from groundstation.recording.session import Recording
from groundstation.recording.takes_turns import jumps
from groundstation.recording.ulog_file import MAGIC as ULOG_MAGIC

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
        "recording_file.write_mcap",
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
        return partial(_function("recording_file.write_mcap"), ros2_hz=ros2_hz)
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
