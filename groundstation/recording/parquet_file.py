"""Parquet: a recording's rows as one table, for pandas, DuckDB, Spark and others."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
from groundstation.recording.column_map import LOOKED_AT, read_mapped
from groundstation.recording.delimited import (
    CELLS,
    DAY_S,
    FRACTION,
    UNNAMED_TIME,
    ColumnTable,
    Said,
    base_name,
    begins_anew,
    fractions_of,
    seconds_of,
    unwrapped,
)
from groundstation.recording.session import EVERY_ROW, Recording, Rows
from groundstation.text import NAMED_MOST

_WHOSE = ("string", "large_string", "dictionary", "int", "uint", "bool", "float", "double", "half")
"""Types whose cells are shown as text."""
_NO_NAME = "__index_level_"
"""What pandas calls an index that has no name."""
ROW_GROUP = 1 << 16
"""Rows that are read at once: two minutes of flight."""


def write_parquet(recording: Recording, path: str | Path) -> None:
    """Write the samples, columns as ``SampleBatch.to_arrow`` names them; the metadata, events and
    commands are JSON in the file's own metadata.

    Raises BadInputError where ``path`` exists, RecordingError where it cannot be written.
    """
    from pyarrow import ArrowException
    from pyarrow.parquet import write_table

    path = Path(path)
    said = {
        "metadata": recording.metadata,
        "events": recording.events,
        "commands": recording.commands,
    }
    table = recording.samples.to_arrow()
    table = table.replace_schema_metadata(
        {
            **(table.schema.metadata or {}),
            **{f"groundstation.{name}": json.dumps(one, default=str) for name, one in said.items()},
        }
    )
    try:
        with path.open("xb") as file:
            write_table(table, file, compression="zstd", row_group_size=ROW_GROUP)
    except FileExistsError as error:
        raise BadInputError(taken(path)) from error
    except (OSError, ArrowException) as error:
        path.unlink(missing_ok=True)
        raise RecordingError(f"{path}: cannot be written: {error}") from error


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A block that reads a Parquet file. Raises RecordingError where the file is damaged."""
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    try:
        yield ParquetFile(path)
    except (OSError, ArrowException, UnicodeDecodeError) as error:
        raise RecordingError(
            f"{path}: a Parquet table that is damaged or was not finished; copy or write it again"
        ) from error


def read_parquet(path: Path, source: str | Path | None = None, rows: Rows = EVERY_ROW) -> Recording:
    """Read a table of another program by a column map (None: the named one that knows its columns).

    Raises BadInputError where no map fits, a column is missing or holds no numbers; RecordingError
    where the file does not read, or was written here: the packets, and what came between the rows,
    are not in it.
    """
    with opened(path) as file:
        if any(key.startswith(b"groundstation.") for key in file.schema_arrow.metadata or {}):
            raise RecordingError(
                f"{path}: a Parquet table of ours is written for other programs and not read back;"
                " give the recording that it was made of"
            )
        table, units = with_times(file.read())
        units |= {base_name(name)[0]: unit for name, unit in units.items()}
        table = _of_one_craft(path, table, rows)
        names = list(table.column_names)
        said = Said(dict(base_name(name) for name in names) | units)
        columns = ColumnTable(
            path, names, partial(numbers_of, path, table), said, partial(_texts, table)
        )
        recording = read_mapped(columns, source, rows)
    recording.kind = "parquet"
    return recording


def with_times(table: Any) -> tuple[Any, dict[str, str]]:
    """An Arrow table with its times as numbers, and their units: dates and times of the day in ns,
    as text in s, whole seconds with their fraction in s. The index of pandas has a name, and is
    there where it is stored as a range alone."""
    table, units = _with_index(table), {}
    for place, name in enumerate(table.column_names):
        found = _times(table.column(place))
        if found is None:
            continue
        if name.startswith(_NO_NAME) and UNNAMED_TIME not in table.column_names:
            name = UNNAMED_TIME
        numbers, units[name] = found
        table = table.set_column(place, name, numbers)
    return _with_fractions(table, units)


def _times(column: Any) -> tuple[Any, str] | None:
    """A column's times as numbers, and their unit; None where it has none, or beyond what ns
    reach."""
    from pyarrow import ArrowInvalid, array, float64, types

    kind = column.type
    if types.is_string(kind) or types.is_large_string(kind):
        period_s = begins_anew(one for one in column[:CELLS].to_pylist() if one)
        if period_s is None:
            return None
        read = [seconds_of(one or "") for one in column.to_pylist()]
        values = np.array([np.nan if one is None else one[0] for one in read])
        return array(unwrapped(values, period_s), float64(), from_pandas=True), "s"
    try:
        if types.is_time(kind):
            values = np.asarray(column.cast("time64[ns]").cast("int64").to_numpy(), np.float64)
            return array(unwrapped(values, DAY_S * 1e9), from_pandas=True), "ns"
        if types.is_timestamp(kind) or types.is_date(kind):
            return column.cast("timestamp[ns]").cast("int64"), "ns"
    except ArrowInvalid:
        return None
    return None


def _with_fractions(table: Any, units: dict[str, str]) -> tuple[Any, dict[str, str]]:
    """The same with the fraction of each column of whole seconds in it."""
    from pyarrow import array

    def numbers(name: str) -> NDArray[np.float64] | None:
        try:
            return numbers_of(Path(name), table, name)
        except BadInputError:
            return None

    names = [one for one in table.column_names if table.column_names.count(one) == 1]
    for whole, (rest, size) in fractions_of(names, numbers).items():
        values = numbers_of(Path(whole), table, whole) + size * numbers_of(Path(rest), table, rest)
        place = table.column_names.index(whole)
        table = table.set_column(place, whole, array(values, from_pandas=True))
        units |= {whole: "s", rest: FRACTION}
    return table, units


def _with_index(table: Any) -> Any:
    """A table with the index of pandas that has a name and is stored as a range alone."""
    from pyarrow import array

    indices = (table.schema.pandas_metadata or {}).get("index_columns", [])
    for index in indices:
        if isinstance(index, dict) and index.get("kind") == "range" and index.get("name"):
            steps = range(index["start"], index["stop"], index["step"])
            if len(steps) == len(table) and index["name"] not in table.column_names:
                table = table.append_column(index["name"], array(steps))
    return table


def _of_one_craft(path: Path, table: Any, rows: Rows) -> Any:
    """The rows that are asked for. Raises BadInputError where there are none."""
    if rows.only is None:
        return table
    name, value = rows.only
    if name not in table.column_names:
        raise BadInputError(f"{path}: --only {name}={value}: there is no column {name!r}")
    cells = table.column(name).to_pylist()
    kept = [_same(one, value) for one in cells]
    if not any(kept):
        listed = ", ".join(list(dict.fromkeys(map(str, cells)))[:NAMED_MOST])
        raise BadInputError(f"{path}: --only {name}={value}: the column has {listed}")
    return table.filter(kept)


def _same(cell: Any, value: str) -> bool:
    """Whether a cell is what the user asked for: 1 and 1.0 are the same."""
    return str(cell) == value or (isinstance(cell, float) and str(cell).removesuffix(".0") == value)


def _texts(table: Any, place: int) -> list[str]:
    """The cells of a column in the first rows, and in the last."""
    column = table.column(place)
    if not str(column.type).startswith(_WHOSE):
        return []
    ends = [column.slice(0, LOOKED_AT), column.slice(max(LOOKED_AT, len(column) - LOOKED_AT))]
    return ["" if one is None else str(one) for end in ends for one in end.to_pylist()]


def numbers_of(path: Path, table: Any, name: str) -> NDArray[np.float64]:
    """A column as numbers, NaN where it has none.

    Raises BadInputError where it holds none."""
    column = table.column(name)
    try:
        return np.asarray(column.to_numpy(), np.float64)
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{path}: column {name!r} holds {column.type}, no numbers") from error
