"""Parquet: a recording's rows as one table, for pandas, DuckDB, Spark and others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NoReturn

from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
from groundstation.recording.session import Recording

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


def read_parquet(path: Path) -> NoReturn:
    """Raises RecordingError: the packets, and what came between the rows, are not in it."""
    raise RecordingError(
        f"{path}: a Parquet table is written for other programs and not read back; give the"
        " recording that it was made of"
    )
