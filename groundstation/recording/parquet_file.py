"""Parquet: a recording's rows as one table, for pandas, DuckDB, Spark and others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
from groundstation.recording.column_map import mapped_recording, place_of
from groundstation.recording.map_document import map_for
from groundstation.recording.map_plan import Said, decided, map_of_header, plan_of
from groundstation.recording.session import Recording
from groundstation.recording.table_header import base_name, called

SHOWN = 12
"""Columns that an error names."""
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


def read_parquet(path: Path, source: str | Path | None = None) -> Recording:
    """Read a table of another program by a column map (None: the named one that knows its columns).

    Raises BadInputError where no map fits, a column is missing or holds no numbers; RecordingError
    where the file does not read, or was written here: the packets, and what came between the rows,
    are not in it.
    """
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    try:
        file = ParquetFile(path)
        schema = file.schema_arrow
        if any(key.startswith(b"groundstation.") for key in schema.metadata or {}):
            raise RecordingError(
                f"{path}: a Parquet table of ours is written for other programs and not read back;"
                " give the recording that it was made of"
            )
        return _mapped(path, file, source)
    except (OSError, ArrowException) as error:
        why = str(error).partition("\n")[0]
        raise RecordingError(f"{path}: a Parquet table that does not read: {why}") from error


def _mapped(path: Path, file: Any, source: str | Path | None) -> Recording:
    schema = file.schema_arrow
    names = list(schema.names)
    source = source or map_of_header(names)
    if source is None:
        raise BadInputError(
            f"{path}: no known map fits its columns ({', '.join(names[:SHOWN])}); name one of"
            " 'groundstation convert --list-columns' with --columns, or describe the columns in a"
            " TOML file"
        )
    column_map, map_path = map_for(path, "csv", source)
    units = dict(base_name(name) for name in names)
    units |= {name: "ns" for name in names if str(schema.field(name).type).startswith("timestamp")}
    plan = plan_of(column_map, map_path, called(names), Said(units))
    wanted = [*plan.channels, *plan.kept]
    places = [place_of(path, names, len(names), one, map_path) for one in wanted]
    table = file.read(columns=sorted({names[place] for place in places}))
    columns = [_numbers(path, table, names[place]) for place in places]
    values = np.column_stack(columns)
    plan, unclear = decided(plan, values)
    recording = mapped_recording(path, plan, column_map, values, names, unclear)
    recording.kind = "parquet"
    return recording


def _numbers(path: Path, table: Any, name: str) -> NDArray[np.float64]:
    """A column as numbers, NaN where it has none; dates in ns."""
    column = table.column(name)
    if str(column.type).startswith(("timestamp", "date")):
        column = column.cast("timestamp[ns]").cast("int64")
    try:
        return np.asarray(column.to_numpy(), np.float64)
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{path}: column {name!r} holds {column.type}, no numbers") from error
