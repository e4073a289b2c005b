"""A table that grows while results arrive: a folder of Parquet files, each whole or not there.

A run that is killed leaves what it had finished; the next run goes on. For a key that stands in
several files the newest counts, and ``compact`` writes it once.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from groundstation.errors import BadInputError, RecordingError, TakenError
from groundstation.paths import written_whole

Row = dict[str, Any]
PART_ROWS = 10_000
"""A file of a compacted table: some MB, read in some hundredths of a second."""
_SUFFIX = ".parquet"


class Parts:
    """Rows by key in a folder.

    columns: name -> kind (text, number, count, texts, numbers); any value may be None. key: the
    column that tells rows apart.
    """

    def __init__(self, folder: Path, columns: Mapping[str, str], key: str) -> None:
        self._folder = folder
        self._columns = columns
        self._key = key

    def rows(self, columns: Sequence[str] | None = None) -> dict[str, Row]:
        """The newest row of each key, by key in alphabetical order.

        columns: only these and the key, for a table may have more rows than memory.

        Raises RecordingError where a file cannot be read.
        """
        while True:
            found: dict[str, Row] = {}
            try:
                for path in self._files():
                    for row in self._read(path, columns).to_pylist():
                        found[row[self._key]] = row
            except FileNotFoundError:  # another run has just put it together with others
                continue
            return dict(sorted(found.items()))

    def append(self, rows: Sequence[Row]) -> None:
        """Adds a file with these rows, or nothing.

        Raises RecordingError where it cannot be written.
        """
        import pyarrow as pa

        if rows:
            table = pa.Table.from_pylist(list(rows), schema=self._schema())
            self._write(self._next(), table)

    def compact(self, keys: Sequence[str] | None = None) -> None:
        """Each row once, in few files; of ``keys`` alone where given. Nothing is written where it
        is so already."""
        import pyarrow as pa

        old = self._files()
        if not old:
            return
        table = pa.concat_tables(self._read(path) for path in old)
        newest = {key: row for row, key in enumerate(table.column(self._key).to_pylist())}
        wanted = newest.keys() if keys is None else newest.keys() & set(keys)
        if len(table) == len(wanted) and len(old) <= 2 + 2 * (len(table) // PART_ROWS):
            return
        table = table.take(pa.array(sorted(newest[key] for key in wanted), pa.int64()))
        first = self._next()
        numbers = range(first, first - (-len(table) // PART_ROWS))
        try:
            for number, row in zip(numbers, range(0, len(table), PART_ROWS), strict=True):
                self._write(number, table.slice(row, PART_ROWS))
        except RecordingError:
            for number in numbers:  # the old ones are whole: leave the disk as it was
                self._path(number).unlink(missing_ok=True)
            raise
        for path in old:  # the new ones are newer, so that a crash in between changes nothing
            path.unlink()

    def _files(self) -> list[Path]:
        if not self._folder.is_dir():
            return []
        named = (one for one in self._folder.iterdir() if one.suffix == _SUFFIX)
        return sorted(one for one in named if one.stem.isdecimal())  # what others put there stays

    def _next(self) -> int:
        files = self._files()
        return int(files[-1].stem) + 1 if files else 0

    def _schema(self) -> Any:
        import pyarrow as pa

        kinds = {
            "text": pa.string(),
            "number": pa.float64(),
            "count": pa.int64(),
            "texts": pa.list_(pa.string()),
            "numbers": pa.list_(pa.float64()),
        }
        return pa.schema([(name, kinds[kind]) for name, kind in self._columns.items()])

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:08d}{_SUFFIX}"

    def _read(self, path: Path, columns: Sequence[str] | None = None) -> Any:
        """An Arrow table of all our columns, or of these and the key."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        schema = self._schema()
        wanted = [name for name in schema.names if columns is None or name in (*columns, self._key)]
        try:
            # a table of an older version has fewer columns: those are null
            table = pq.read_table(path, columns=wanted, schema=schema, partitioning=None)
            if table.column(self._key).null_count:
                raise pa.ArrowInvalid(f"rows without {self._key!r}: not a part of this")
        except FileNotFoundError:
            raise
        except (OSError, pa.ArrowException) as error:
            raise RecordingError(
                f"{path}: cannot be read ({error}); remove it, what it held is computed again"
            ) from error
        return table

    def _write(self, number: int, table: Any) -> None:
        import pyarrow.parquet as pq

        path = self._path(number)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with written_whole(path) as file:
                pq.write_table(table, file, compression="zstd")
        except OSError as error:
            why = os.strerror(error.errno) if error.errno else str(error)
            raise RecordingError(
                f"{path}: cannot be written: {why}; what came before is kept, run it again when"
                " there is space"
            ) from error


@contextmanager
def held(catalogue: Path) -> Iterator[None]:
    """Only one run at a time changes a catalogue.

    Raises TakenError where another does, BadInputError where the folder cannot be used.
    """
    try:
        catalogue.mkdir(exist_ok=True)
        lock = os.open(catalogue / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise BadInputError(f"{catalogue}: cannot be used: {error.strerror}") from error
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise TakenError(
                f"{catalogue}: another run is working on this catalogue; wait for it to end"
            ) from error
        yield
    finally:
        os.close(lock)
