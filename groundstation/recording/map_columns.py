"""The columns of another program's file, with their first numbers: what a column map can name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.errors import BadInputError
from groundstation.recording.delimited import TextTable, open_table
from groundstation.recording.formats import is_text
from groundstation.recording.map_document import Kind
from groundstation.recording.map_guess import FileColumn
from groundstation.recording.ros_bag import is_bag, is_bag_folder
from groundstation.recording.series import Series
from groundstation.recording.table_header import base_name
from groundstation.recording.ulog_file import MAGIC as ULOG_MAGIC
from groundstation.recording.unread import refuse_unread

ROWS_MOST = 50_000
"""Rows by which guesses are made."""
_HEAD_BYTES = 4096
_MICROSD_MAGIC = b"\xbc"
_FEWEST = 2
"""Columns of numbers; fewer are no table."""


@dataclass(frozen=True, slots=True)
class FileColumns:
    """kind: of map that such a file takes. series: names of those of a log of many."""

    path: Path
    kind: Kind
    columns: Sequence[FileColumn]
    series: Sequence[str] = ()


@np.errstate(invalid="ignore")  # damage may leave a NaN that numpy signals when it is converted
def columns_of(path: Path) -> FileColumns:
    """The columns that a column map can name.

    Raises BadInputError for a file that takes no column map or holds no numbers, RecordingError
    where it does not read.
    """
    found = _of_bag(path) if is_bag_folder(path) else _reader_of(path)(path)
    if sum(one.has_numbers for one in found.columns) < _FEWEST:
        raise BadInputError(f"{path}: no table: fewer than two of its columns hold numbers")
    return found


def _reader_of(path: Path) -> Callable[[Path], FileColumns]:
    with _opened(path) as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        raise BadInputError(f"{path}: is empty (0 bytes)")
    refuse_unread(path, head)
    for begins, read in _READERS:
        if begins(head):
            return read
    raise BadInputError(f"{path}: its channels have fixed names: it takes no column map")


def _opened(path: Path) -> Any:
    from groundstation.documents import open_regular
    from groundstation.errors import RecordingError

    try:
        return open(open_regular(path), "rb")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


def _of_text(path: Path) -> FileColumns:
    table = open_table(path)
    names = table.names or [""] * table.width
    units = table.units or [""] * table.width
    columns = []
    for place, values in enumerate(_first_numbers(table)):
        name = names[place] if place < len(names) else ""
        unit = units[place] if place < len(units) else ""
        columns.append(FileColumn(name, _reference(names, place), unit, values))
    return FileColumns(path, "csv", columns)


def _reference(names: Sequence[str], place: int) -> str | int:
    """What a map calls a column: its name where it alone has it, else its number."""
    name = names[place]
    return name if name and list(names).count(name) == 1 else place + 1


def _first_numbers(table: TextTable) -> list[Any]:
    """The first numbers of each column, none where one holds text."""
    places = list(range(table.width))

    def first(wanted: list[int]) -> Any:
        for block in table.blocks(wanted):
            return block.values[:ROWS_MOST].T
        return np.empty((len(wanted), 0))

    try:
        return list(first(places))
    except BadInputError as error:
        columns, failed = [], 0
        for place in places:
            try:
                columns.append(first([place])[0])
            except BadInputError:
                columns.append(np.empty(0))
                failed += 1
        if failed == len(places) >= _FEWEST:
            raise error
        return columns


def _of_parquet(path: Path) -> FileColumns:
    from pyarrow import ArrowException, Table
    from pyarrow.parquet import ParquetFile

    from groundstation.errors import RecordingError
    from groundstation.recording.parquet_file import numbers_of, with_times

    try:
        file = ParquetFile(path)
        batches = [*islice(file.iter_batches(batch_size=ROWS_MOST), 1)]
        table, units = with_times(Table.from_batches(batches, file.schema_arrow))
    except (OSError, ArrowException, UnicodeDecodeError) as error:
        raise RecordingError(
            f"{path}: a Parquet table that is damaged or was not finished; copy or write it again"
        ) from error
    columns = []
    for name in table.column_names:
        try:
            values = numbers_of(path, table, name)
        except BadInputError:
            values = np.empty(0)
        columns.append(FileColumn(name, name, units.get(name, base_name(name)[1]), values))
    return FileColumns(path, "csv", columns)


def _of_microsd(path: Path) -> FileColumns:
    """The variables of the event that gives the rows."""
    from groundstation.recording.microsd import read_microsd

    tables = read_microsd(path).tables
    table = tables.get("fixedFrequency") or max(
        tables.values(), key=lambda one: len(one.time_s), default=None
    )
    if table is None:
        raise BadInputError(f"{path}: the microSD log has no events")
    columns = [FileColumn("time", "time", "us", table.time_s[:ROWS_MOST] * 1e6)]
    for name, values in table.columns.items():
        numbers = np.asarray(values[:ROWS_MOST], np.float64)
        columns.append(FileColumn(name, name, "", numbers))
    return FileColumns(path, "csv", columns)


def _of_series(path: Path, kind: Kind, series: Sequence[Series]) -> FileColumns:
    """A column is ``SERIES.FIELD``, on the clock of its series."""
    first_ns = min((int(one.time_ns[0]) for one in series if len(one.time_ns)), default=0)
    columns = []
    for one in series:
        time_s = np.asarray((one.time_ns[:ROWS_MOST] - first_ns) * 1e-9, np.float64)
        for name, values in one.columns.items():
            whole = f"{one.name}.{name}"
            numbers = np.asarray(values[:ROWS_MOST], np.float64)
            columns.append(FileColumn(whole, whole, "", numbers, time_s))
    return FileColumns(path, kind, columns, [one.name for one in series])


def _of_ulog(path: Path) -> FileColumns:
    from groundstation.recording.ulog_file import content_of

    return _of_series(path, "ulog", content_of(path).series)


def _of_bag(path: Path) -> FileColumns:
    from groundstation.recording.ros_bag import series_of_bag

    return _of_series(path, "rosbag", series_of_bag(path)[0])


_READERS: tuple[tuple[Callable[[bytes], bool], Callable[[Path], FileColumns]], ...] = (
    (lambda head: head.startswith(b"PAR1"), _of_parquet),
    (lambda head: head.startswith(_MICROSD_MAGIC), _of_microsd),
    (is_bag, _of_bag),
    (lambda head: head.startswith(ULOG_MAGIC), _of_ulog),
    (is_text, _of_text),
)
