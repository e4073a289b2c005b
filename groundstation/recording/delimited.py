"""Delimited text as spreadsheets and loggers write it, read block by block into numbers.

Accepted: comma, semicolon or tab; decimal comma; quotes; CRLF; a byte-order mark; Excel's
``sep=;`` line; a leading column of row numbers with or without a name; a separator at the end
of each line; ``1,23E+09`` unquoted in the last column of a comma-separated line; comments and other
lines before the header, and units below it (``table_header``). A last line
without its end that does not read is taken for a torn write: it is left out and named in
``damage``. Any other cell that is not a number is an error with its line and column.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.table_header import (
    SPLIT_EXPONENT,
    find_header,
    is_number,
    plain,
)

BLOCK_BYTES = 8 << 20
_HEAD_BYTES = 1 << 16


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive rows of a table.

    values: (rows, columns asked for), NaN in an empty cell.
    """

    table: TextTable
    columns: Sequence[int]
    values: NDArray[np.float64]
    _text: bytes
    _first_line: int

    def error(self, row: int, column: int, why: str) -> BadInputError:
        """An error that names the line and column of ``values[row, column]``."""
        filled = [n for n, line in enumerate(self._text.split(b"\n")) if line.strip()]
        return self.table.cell_error(self._first_line + filled[row], self.columns[column], why)


@dataclass(slots=True)
class TextTable:
    """The layout of a delimited file; ``blocks`` reads the numbers.

    names: one per field of a row, "" where the header has none. Empty for a file without a
        header line.
    units: one per name, as the file says them, "" where it does not.
    said: key -> text of lines before the header.
    damage: filled while reading.
    """

    path: Path
    separator: bytes
    names: list[str]
    width: int
    damage: list[str] = field(default_factory=list)
    _data_offset: int = 0
    _data_line: int = 1
    units: list[str] = field(default_factory=list)
    said: dict[str, str] = field(default_factory=dict)

    def blocks(self, columns: Sequence[int], *, whole: bool = False) -> Iterator[Block]:
        """The numbers in ``columns`` (positions in a row), in blocks of many rows.

        With ``whole`` every cell must be a whole number below 2**53 in magnitude.

        Raises BadInputError naming line and column of a cell that does not read.
        """
        for first_line, text, torn in self._texts():
            if not text.strip():
                continue
            try:
                block = Block(
                    self, columns, self._numbers(text, first_line, columns, whole), text, first_line
                )
                if whole:
                    _require_whole(block)
            except BadInputError as error:
                if not torn:
                    raise
                self.damage.append(f"the last line is torn and was left out ({error})")
            else:
                yield block

    def cell_error(self, line: int, column: int, why: str) -> BadInputError:
        """An error that names the place in the file."""
        name = self.names[column] if self.names else ""
        label = name or f"number {column + 1}"
        return BadInputError(f"{self.path}, line {line}, column {label}: {why}")

    def _texts(self) -> Iterator[tuple[int, bytes, bool]]:
        """Number of the first line, plain lines, and whether they lack their end."""
        line, rest = self._data_line, b""
        with self.path.open("rb") as file:
            file.seek(self._data_offset)
            while chunk := file.read(BLOCK_BYTES):
                cut = chunk.rfind(b"\n") + 1
                if cut == 0:
                    rest += chunk
                    continue
                text = self._normalise(rest + chunk[:cut])
                rest = chunk[cut:]
                yield line, text, False
                line += text.count(b"\n")
        yield line, self._normalise(rest), True

    def _normalise(self, text: bytes) -> bytes:
        """Plain cells: no quotes, decimal points, one separator, line feeds only."""
        text = plain(text, self.separator)
        if self.separator == b"," and (b"E+" in text or b"e+" in text):
            rows = text.count(b"\n") + (not text.endswith(b"\n"))
            if text.count(b",") > rows * (self.width - 1):
                text = SPLIT_EXPONENT.sub(rb",\1.\2", text)
        return text

    def _numbers(
        self, text: bytes, first_line: int, columns: Sequence[int], whole: bool
    ) -> NDArray[np.float64]:
        from pyarrow import ArrowInvalid, BufferReader, csv, float64

        wanted = [str(column) for column in columns]
        try:
            table = csv.read_csv(
                BufferReader(text),
                csv.ReadOptions(column_names=list(map(str, range(self.width))), use_threads=False),
                csv.ParseOptions(delimiter=self.separator.decode(), quote_char=False),
                csv.ConvertOptions(
                    include_columns=wanted,
                    column_types=dict.fromkeys(wanted, float64()),
                    null_values=[] if whole else [""],
                ),
            )
        except ArrowInvalid:
            return self._one_by_one(text, first_line, columns, whole)
        return np.column_stack([table.column(name).to_numpy() for name in wanted])

    def _one_by_one(
        self, text: bytes, first_line: int, columns: Sequence[int], whole: bool
    ) -> NDArray[np.float64]:
        """Cell by cell: names the one that is no number, and reads what only Python takes for one
        (blanks in an empty cell, on an empty line)."""
        rows = []
        for number, line in enumerate(text.split(b"\n"), first_line):
            if not line.strip():
                continue
            cells = line.split(self.separator)
            if len(cells) != self.width:
                raise BadInputError(
                    f"{self.path}, line {number}: {len(cells)} fields, "
                    f"but the lines before have {self.width}"
                )
            chosen = [cells[column].strip() for column in columns]
            for column, cell in zip(columns, chosen, strict=True):
                if (cell or whole) and not is_number(cell):
                    shown = cell[:40].decode("latin-1")
                    why = f"{shown!r} is not a number" if cell else "the cell is empty"
                    raise self.cell_error(number, column, why)
            rows.append([float(cell) if cell else np.nan for cell in chosen])
        return np.array(rows)


def open_table(path: Path, skip: int = 0) -> TextTable:
    """Find out how a delimited file is laid out. skip: lines before its header.

    Lines that begin with ``#``, ``%`` or ``//`` and lines of another width before the header are
    passed over, and lines without a number below it; units among these are kept.

    Raises RecordingError where the file cannot be opened, BadInputError where it is empty or
    not a table of text.
    """
    head, offset = _head(path)
    lines = [one for one in _lines(head, offset) if one[0] > skip]
    if len(head) == _HEAD_BYTES and len(lines) > 1:
        lines.pop()  # possibly cut
    if not lines:
        raise BadInputError(f"{path}: nothing behind the first {skip} lines")
    announced = re.fullmatch(rb"sep=([,;\t])", lines[0][2].strip())
    if announced and len(lines) > 1:
        lines = lines[1:]
    found = find_header([line for _, _, line in lines], announced.group(1) if announced else b"")
    layout = TextTable(path, found.separator, found.names, len(found.names), [])
    layout.said, layout.units = found.said, found.units
    if found.data < len(lines):
        layout._data_line, layout._data_offset, first = lines[found.data]
        if found.names:
            row = plain(first, found.separator)
            layout.names = _align(found.names, row, found.separator)
            if layout.names[:1] == [""]:
                layout.units = ["", *layout.units]
        else:
            layout.width = len(
                plain(first, found.separator, keep_commas=True).split(found.separator)
            )
    else:
        layout._data_line, layout._data_offset = lines[-1][0] + 1, len(head)
    layout.width = len(layout.names) or layout.width
    return layout


def _head(path: Path) -> tuple[bytes, int]:
    """The file's first bytes, and where its text begins."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    if not head.strip():
        raise BadInputError(f"{path}: the file is empty")
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise BadInputError(f"{path}: the text is UTF-16; save it as CSV (UTF-8)")
    if b"\0" in head.split(b"\n", 1)[0]:
        raise BadInputError(f"{path}: not a text file")
    return head, 3 if head.startswith(b"\xef\xbb\xbf") else 0


def _lines(head: bytes, offset: int) -> Iterator[tuple[int, int, bytes]]:
    """Number, offset and text of the lines that are not blank."""
    number = 0
    while offset < len(head):
        end = head.find(b"\n", offset)
        end = len(head) if end < 0 else end
        number += 1
        if head[offset:end].strip():
            yield number, offset, head[offset:end].rstrip(b"\r")
        offset = end + 1


def _align(names: list[str], first_row: bytes, separator: bytes) -> list[str]:
    """Give each field of the first row its name: row numbers and end separators have none."""
    fields = first_row.split(separator)
    if separator == b"," and len(fields) > len(names):
        fields = SPLIT_EXPONENT.sub(rb",\1.\2", first_row).split(separator)
    if len(fields) == len(names) + 1:
        return [*names, ""] if not fields[-1].strip() else ["", *names]
    return names


def _require_whole(block: Block) -> None:
    wrong = ~(np.abs(block.values) < 2**53) | (block.values != np.rint(block.values))
    if wrong.any():
        row, column = (int(place) for place in np.argwhere(wrong)[0])
        raise block.error(
            row, column, f"{block.values[row, column]:g} is not a whole number below 2^53"
        )
