"""Delimited text as spreadsheets and loggers write it, read block by block into numbers.

Accepted: comma, semicolon or tab; decimal comma; quotes; CRLF; a byte-order mark; Excel's
``sep=;`` line; a leading column of row numbers with or without a name; a separator at the end
of each line; ``1,23E+09`` unquoted in the last column of a comma-separated line. A last line
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

BLOCK_BYTES = 8 << 20
_HEAD_BYTES = 1 << 16
_SPLIT_EXPONENT = re.compile(rb",(\d),(\d+[eE]\+\d+)$", re.MULTILINE)
"""A last number whose decimal comma was taken for a separator."""
_EXPONENT = re.compile(rb"\d\.\d+[eE]\+\d+")
_QUOTED = re.compile(rb'"((?:[^"\n]|"")*)"')


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
    damage: filled while reading.
    """

    path: Path
    separator: bytes
    names: list[str]
    width: int
    damage: list[str] = field(default_factory=list)
    _data_offset: int = 0
    _data_line: int = 1

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
        text = _plain(text, self.separator)
        if self.separator == b"," and (b"E+" in text or b"e+" in text):
            rows = text.count(b"\n") + (not text.endswith(b"\n"))
            if text.count(b",") > rows * (self.width - 1):
                text = _SPLIT_EXPONENT.sub(rb",\1.\2", text)
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
                if (cell or integers) and not _is_number(cell):
                    shown = cell[:40].decode("latin-1")
                    why = f"{shown!r} is not a number" if cell else "the cell is empty"
                    raise self.cell_error(first_line + number, column, why)


def open_table(path: Path) -> TextTable:
    """Find out how a delimited file is laid out.

    Raises RecordingError where the file cannot be opened, BadInputError where it is empty or
    not a table of text.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    if not head.strip():
        raise BadInputError(f"{path}: the file is empty")
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise BadInputError(f"{path}: the text is UTF-16; save it as CSV (UTF-8)")
    offset = 3 if head.startswith(b"\xef\xbb\xbf") else 0
    if b"\0" in head.split(b"\n", 1)[0]:
        raise BadInputError(f"{path}: not a text file")
    lines = _lines(head, offset)
    number, offset, first = next(lines)
    announced = re.fullmatch(rb"sep=([,;\t])", first.strip())
    if announced:
        number, offset, first = next(lines, (2, len(head), b""))
    separator = announced.group(1) if announced else _separator(first)
    header = _plain(first, separator, keep_commas=True).split(separator)
    names = [_text(cell) for cell in header]
    if all(not cell.strip() or _is_number(cell.replace(b",", b".")) for cell in header):
        return TextTable(path, separator, [], len(header), [], offset, number)
    data_number, data_offset, second = next(lines, (number + 1, len(head), b""))
    if second:
        names = _align(names, _plain(second, separator), separator)
    return TextTable(path, separator, names, len(names), [], data_offset, data_number)


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


def _separator(line: bytes) -> bytes:
    bare = _QUOTED.sub(b"", line)
    return next((mark for mark in (b"\t", b";") if mark in bare), b",")


def _plain(text: bytes, separator: bytes, *, keep_commas: bool = False) -> bytes:
    if b'"' in text:
        text = _QUOTED.sub(
            lambda cell: cell.group(1).replace(separator, b"." if separator == b"," else b" "),
            text,
        )
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").rstrip(b"\r")
    if separator != b"," and not keep_commas:
        text = text.replace(b",", b".")
    return text


def _align(names: list[str], first_row: bytes, separator: bytes) -> list[str]:
    """Give each field of the first row its name: row numbers and end separators have none."""
    fields = first_row.split(separator)
    if separator == b"," and len(fields) > len(names):
        fields = _SPLIT_EXPONENT.sub(rb",\1.\2", first_row).split(separator)
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


def _is_number(cell: bytes) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _text(cell: bytes) -> str:
    try:
        return cell.strip().decode("utf-8")
    except UnicodeDecodeError:
        return cell.strip().decode("latin-1")
