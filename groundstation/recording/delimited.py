"""Delimited text as spreadsheets and loggers write it, read block by block into numbers.

Accepted: comma, semicolon or tab; decimal comma; quotes; CRLF; a byte-order mark; Excel's
``sep=;`` line; a leading column of row numbers with or without a name; a separator at the end
of each line; ``1,23E+09`` unquoted in the last column of a comma-separated line; comments and other
lines before the header, and units below it (``table_header``). A last line
without its end that does not read is taken for a torn write: it is left out and named in
``damage``. Any other cell that is not a number is an error with its line and column.
"""

from __future__ import annotations

import contextlib
import functools
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
_EXPONENT = re.compile(rb",(\d),(\d+[eE]\+\d+)$", re.MULTILINE)
"""A last number whose decimal comma was taken for a separator."""
_EXPONENT = re.compile(rb"\d\.\d+[eE]\+\d+")


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive rows of a table.

    values: (rows, columns asked for), int64 if the caller takes integers, else float64.
    """

    table: TextTable
    columns: Sequence[int]
    values: NDArray[Any]
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

    def blocks(self, columns: Sequence[int], *, integers: bool = False) -> Iterator[Block]:
        """The numbers in ``columns`` (positions in a row), in blocks of many rows.

        With ``integers`` a cell must be a whole number below 2**53 in magnitude (int64);
        otherwise an empty cell reads as NaN (float64).

        Raises BadInputError naming line and column of a cell that does not read.
        """
        for first_line, text, torn in self._texts():
            try:
                block = self._parse(text, first_line, columns, integers)
            except BadInputError as error:
                if not torn:
                    raise
                self.damage.append(f"the last line is torn and was left out ({error})")
            else:
                if block is not None:
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

    def _parse(
        self, text: bytes, first_line: int, columns: Sequence[int], integers: bool
    ) -> Block | None:
        if not text.strip():
            return None
        self._require_width(text, first_line)
        if integers and (b"E+" in text or b"e+" in text):
            text = _EXPONENT.sub(_expand, text)
        try:
            values = self._numbers(text, columns, integers)
        except ValueError as error:
            self._diagnose(text, first_line, columns, integers)
            raise BadInputError(f"{self.path}, after line {first_line}: {error}") from error
        block = Block(self, columns, values, text, first_line)
        return _as_integers(block) if integers else block

    def _numbers(self, text: bytes, columns: Sequence[int], integers: bool) -> NDArray[Any]:
        if not integers:
            return self._load(_fill_empty(text, self.separator), np.float64, columns)
        if not any(mark in text for mark in (b".", b"e", b"E", b"n")):
            with contextlib.suppress(ValueError):  # beyond 64 bits, or no number at all
                return self._load(text, np.int64, columns)
        return self._load(text, np.float64, columns)

    def _load(self, text: bytes, kind: type[Any], columns: Sequence[int]) -> NDArray[Any]:
        return np.loadtxt(
            io.StringIO(text.decode("latin-1")),
            dtype=kind,
            comments=None,
            delimiter=self.separator.decode(),
            usecols=columns,
            ndmin=2,
        )

    def _require_width(self, text: bytes, first_line: int) -> None:
        """Every row has as many fields as the first: a shifted row never passes for data."""
        codes = np.frombuffer(text if text.endswith(b"\n") else text + b"\n", np.uint8)
        ends = np.flatnonzero(codes == ord("\n"))
        separators = np.flatnonzero(codes == ord(self.separator))
        counts = np.diff(np.searchsorted(separators, ends), prepend=0)
        wrong = np.flatnonzero(counts != self.width - 1)
        if len(wrong) == 0:
            return
        lines = text.split(b"\n")
        for line in wrong:
            if lines[line].strip():
                raise BadInputError(
                    f"{self.path}, line {first_line + int(line)}: {counts[line] + 1} fields, "
                    f"but the lines before have {self.width}"
                )

    def _diagnose(
        self, text: bytes, first_line: int, columns: Sequence[int], integers: bool
    ) -> None:
        """Name the cell that the fast parser could not read."""
        for number, line in enumerate(text.split(b"\n")):
            if not line.strip():
                continue
            cells = line.split(self.separator)
            for column in columns:
                cell = cells[column].strip()
                if (cell or integers) and not is_number(cell):
                    shown = cell[:40].decode("latin-1")
                    why = f"{shown!r} is not a number" if cell else "the cell is empty"
                    raise self.cell_error(first_line + number, column, why)


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


def _expand(number: re.Match[bytes]) -> bytes:
    """Whole numbers written out, which the integer parser reads five times as fast."""
    return _expanded(number.group())


@functools.lru_cache(4096)
def _expanded(number: bytes) -> bytes:
    value = float(number)
    return b"%d" % value if value.is_integer() else number


def _fill_empty(text: bytes, separator: bytes) -> bytes:
    """NaN in each empty cell."""
    if separator + b" " in text:
        text = re.sub(rb"(?<=%s) +(?=%s|\n|$)" % (separator, separator), b"", text)
    edged = b"\n" + text + (b"" if text.endswith(b"\n") else b"\n")
    for empty in (separator + separator, b"\n" + separator, separator + b"\n"):
        if empty in edged:
            filled = empty[:1] + b"nan" + empty[1:]
            edged = edged.replace(empty, filled).replace(empty, filled)
    return edged[1:]


def _as_integers(block: Block) -> Block:
    if block.values.dtype == np.int64:
        return block
    wrong = ~(np.abs(block.values) < 2**53) | (block.values != np.rint(block.values))
    if wrong.any():
        row, column = (int(place) for place in np.argwhere(wrong)[0])
        raise block.error(
            row, column, f"{block.values[row, column]:g} is not a whole number below 2^53"
        )
    return Block(
        block.table,
        block.columns,
        block.values.astype(np.int64),
        block._text,
        block._first_line,
    )
