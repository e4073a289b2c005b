"""Text tables: their delimiter, their header, cells that are times, and their numbers."""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.paths import reading
from groundstation.recording.session import Rows
from groundstation.telemetry.arrays import Array
from groundstation.text import NAMED_MOST

# Times that are no plain number: dates and times of the day as text, and seconds whose fraction is
# in a column of its own.


DAY_S, HOUR_S = 86_400.0, 3600.0
CELLS = 20
"""First cells by which a column is known to be dates."""
UNNAMED_TIME = "time"
"""What an index of dates is called that pandas writes without a name."""
FRACTION = "of a second"
"""The unit of a column that is only the fraction of another's seconds, and no time by itself."""
_TIME = re.compile(
    r"(?:(?P<date>\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}|\d{1,6} days?)"
    r"(?:[T/_]|,? +))?"
    r"(?P<clock>\d{1,2}:\d\d(?::\d\d)?(?:[.,]\d+)?) *(?P<half>[AaPp][Mm])?"
    r" *(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?"
)
"""A date or none, a time of the day, and its zone: ``2026-01-01T10:00:00.25Z``, ``10:00:00.25``,
``0 days 00:00:00.25``."""
_FRACTION = re.compile(
    r"(?P<stem>.*?)(?P<size>n|nano|u|micro|m|milli)_?(?:s|secs?|seconds?)", re.IGNORECASE
)
_SIZES = {"n": 1e-9, "u": 1e-6, "m": 1e-3}
_SECONDS = ("s", "sec", "secs", "second", "seconds")


def seconds_of(cell: str) -> tuple[float, float] | None:
    """A time in s, and after how many s it begins anew (0: never, it has a date); None where a cell
    is none. With a date: since 1970, in UTC where no zone is named."""
    read = _TIME.fullmatch(cell.strip())
    if read is None:
        return None
    parts = [float(one) for one in read["clock"].replace(",", ".").split(":")]
    if read["date"] and len(parts) == 2:
        parts.append(0.0)  # hours and minutes; without a date minutes and seconds
    if any(one >= 60.0 for one in parts[-2:]):
        return None
    if read["half"]:
        parts[0] = parts[0] % 12 + 12 * (read["half"].lower() == "pm")
    seconds = sum(one * 60.0**place for place, one in enumerate(reversed(parts)))
    if not read["date"]:
        return seconds, DAY_S if len(parts) == 3 else HOUR_S
    days = _days(read["date"])
    return None if days is None else (days * DAY_S + seconds - _zone_s(read["zone"] or ""), 0.0)


def begins_anew(cells: Iterable[str]) -> float | None:
    """After how many s the times of a column begin anew, by the first of its cells that have a
    value; None where one is no time, or there is none."""
    found = [seconds_of(one) for one in islice(cells, CELLS)]
    times = [one for one in found if one is not None]
    return times[0][1] if times and len(times) == len(found) else None


def unwrapped(values: Array, period_s: float, before_s: float = np.nan) -> Array:
    """Times (n,) that go on over midnight. before_s: the last time before them."""
    known = np.isfinite(values)
    if not period_s or not known.any():
        return values
    line = np.concatenate([[before_s] if np.isfinite(before_s) else [], values[known]])
    values = values.copy()
    values[known] = np.unwrap(line, period=period_s)[-int(known.sum()) :]
    return values


def go_on(
    numbers: Array, columns: Sequence[int], dated: Mapping[int, float], before_s: dict[int, float]
) -> None:
    """Unwrap the times among a block of columns (n, k). dated: column -> after how many s it begins
    anew. before_s: column -> its last time in the blocks before, which is renewed."""
    for place, column in enumerate(columns):
        if period_s := dated.get(column, 0.0):
            times = unwrapped(numbers[:, place], period_s, before_s[column])
            known = times[np.isfinite(times)]
            numbers[:, place] = times
            before_s[column] = float(known[-1]) if len(known) else before_s[column]


def fractions_of(
    names: Sequence[str], numbers: Callable[[str], Array | None]
) -> dict[str, tuple[str, float]]:
    """Columns of whole seconds -> the column of their fraction, and its unit in s: ``sec`` and
    ``nanosec``, ``header.stamp.secs`` and ``header.stamp.nsecs``. numbers: some of a column, None
    where it holds none."""
    found: dict[str, tuple[str, float]] = {}
    by_small = {name.lower(): name for name in names}
    for name in names:
        read = _FRACTION.fullmatch(name)
        for ending in _SECONDS if read else ():
            whole = by_small.get(f"{read['stem']}{ending}".lower()) if read else None
            if read is None or whole is None:
                continue
            size = _SIZES[read["size"][0].lower()]
            if _are_one(numbers(whole), numbers(name), size):
                found[whole] = name, size
    return found


def _are_one(seconds: Array | None, fraction: Array | None, size: float) -> bool:
    """Whether two columns are whole seconds and their fraction: together they go on."""
    if seconds is None or fraction is None or len(seconds) != len(fraction):
        return False
    known = np.isfinite(seconds) & np.isfinite(fraction)
    whole, rest = seconds[known], fraction[known]
    if not len(whole) or (whole % 1.0 != 0.0).any() or (rest < 0.0).any():
        return False
    steps = np.diff(whole - whole[0] + rest * size)
    return bool((rest * size < 1.0).all() and (steps >= 0.0).mean() > 0.9)


@lru_cache(maxsize=64)
def _days(text: str) -> int | None:
    """Days since 1970 of year, month, day; day, month, year with points; else month, day, year as
    far as that is a date; or days of a duration."""
    if "day" in text:
        return int(text.split()[0])
    mark = next(one for one in "-/." if one in text)
    parts = [int(one) for one in re.split(r"[-/.]", text)]
    if parts[0] < 1000:
        american = mark == "/" and parts[0] <= 12
        parts = [parts[2], parts[0], parts[1]] if american else parts[::-1]
    try:
        return date(*parts).toordinal() - date(1970, 1, 1).toordinal()
    except ValueError:
        return None


def _zone_s(zone: str) -> float:
    if zone[:1] not in ("+", "-"):
        return 0.0
    minutes = int(zone[1:3]) * 60 + int(zone[-2:])
    return 60.0 * minutes if zone[0] == "+" else -60.0 * minutes


# The header of a delimited file: which line it is, what is said before it and just below.
#
# Loggers write remarks, keys and values before the names of their columns, and units behind or
# below them: ``gyroADC[0] (deg/s)``, ``acc [g]``, or a line ``ms,deg/s,g``.


COMMENTS = (b"#", b"%", b"//")
UNITS_BELOW = 6
"""Lines below a header that may hold no number: units, kinds, names of bodies."""
LOOKED_AT = 40
"""Lines by whose number of fields a table's is known."""
SPLIT_EXPONENT = re.compile(rb",(\d),(\d+[eE]\+\d+)$", re.MULTILINE)
"""A last number whose decimal comma was taken for a separator."""
FEWEST_SPACED = 3
"""Words of a line from which spaces separate them."""
_SPACES, _ENDS = re.compile(rb"  +"), re.compile(rb"^ +| +$", re.MULTILINE)
_QUOTED = re.compile(rb'"((?:[^"\n]|"")*)"')
_UNIT = re.compile(r"(.*\S)\s*[(\[]\s*([^()\[\]]{1,12}?)\s*[)\]]")
ALIASES = {
    **{"sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "milliseconds": "ms"},
    **{"usec": "us", "\u00b5s": "us", "\u03bcs": "us", "microseconds": "us", "nsec": "ns"},
    **{"dps": "deg/s", "\u00b0/s": "deg/s", "degrees/s": "deg/s", "deg/sec": "deg/s"},
    **{"rad/sec": "rad/s", "radians/s": "rad/s", "m/s2": "m/s^2", "m/s\u00b2": "m/s^2"},
    **{"m/s/s": "m/s^2", "ms^-2": "m/s^2", "ms-2": "m/s^2", "m/s**2": "m/s^2"},
    **{"\u00b0": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad"},
    **{"volt": "V", "volts": "V", "v": "V", "mv": "mV", "RPM": "rpm", "rev/min": "rpm", "G": "g"},
}
"""Other spellings of the units that column maps know."""
KNOWN = {
    "s",
    "ms",
    "us",
    "ns",
    "V",
    "mV",
    "A",
    "mA",
    "W",
    "Pa",
    "C",
    "degC",
    "%",
    "flags",
    "1",
    "-",
} | {"rad/s", "deg/s", "rad", "deg", "rev/s", "rpm", "m/s^2", "g", "m", "m/s", "mm"}


@dataclass(frozen=True, slots=True)
class Header:
    """names, units: of each column, units "" where not said; both empty without a header line.
    data: index of the first line of numbers. said: key -> text of lines before the header."""

    separator: bytes
    names: list[str]
    units: list[str]
    data: int
    said: dict[str, str] = field(default_factory=dict)


def find_header(lines: Sequence[bytes], separator: bytes = b"") -> Header:
    """The header among a file's first lines that are not blank. separator: where it is known."""
    first = 0
    while first < len(lines) - 1 and lines[first].lstrip().startswith(COMMENTS):
        first += 1
    first += _preamble(lines[first:], separator)
    mark = separator or separator_of(lines[first])
    if mark == b" " and not separator and not _even(lines[first:]):
        mark = b","
    cells = plain(lines[first], mark, keep_commas=True).split(mark)
    above = lines[first - 1].lstrip() if first else b""
    if _is_numbers(cells):
        bare = above.lstrip(b"#%/ \t")
        named = plain(bare, mark, keep_commas=True).split(mark)
        if above.startswith(COMMENTS) and len(named) == len(cells) > 1 and not _is_numbers(named):
            return Header(mark, *_named(named), first)
        return Header(mark, [], [], first)
    names, units = _named(cells)
    data = first + 1
    for _ in range(UNITS_BELOW):
        if data + 1 >= len(lines):
            break
        below = plain(lines[data], mark).split(mark)
        if any(is_number(one) for one in below) or not _has_number(lines[data + 1 :], mark):
            break
        said = [canonical(_text(one).strip("()[]")) for one in below]
        if len(said) == len(names) and any(said):
            units = [
                old or (new if new in KNOWN else "") for old, new in zip(units, said, strict=True)
            ]
        data += 1
    return Header(mark, names, units, data, _said(lines[:first]))


def base_name(name: str) -> tuple[str, str]:
    """A column's name without the unit behind it, and the unit in its usual spelling, or empty."""
    found = _UNIT.fullmatch(name)
    if found is None or canonical(found[2]) not in KNOWN:
        return name, ""
    return found[1], canonical(found[2])


def called(names: Sequence[str]) -> set[str]:
    """Every name by which a column goes: as in the header, and without its unit."""
    return {*names, *(base_name(one)[0] for one in names)}


def canonical(unit: str) -> str:
    """A unit as column maps spell it."""
    return ALIASES.get(unit, ALIASES.get(unit.lower(), unit))


def _preamble(lines: Sequence[bytes], separator: bytes) -> int:
    """How many lines come before the header: those of another width than the table's."""
    if len(lines) < 3:
        return 0
    mark = separator or separator_of(lines[-1])
    whole = [SPLIT_EXPONENT.sub(rb",\1.\2", plain(one, mark, keep_commas=True)) for one in lines]
    widths = [len(one.split(mark)) for one in whole]
    width = Counter(widths[-LOOKED_AT:]).most_common(1)[0][0]
    if width < 3 or abs(widths[0] - width) <= 1:
        return 0
    return next((k for k, one in enumerate(widths) if abs(one - width) <= 1), 0)


def _named(cells: Sequence[bytes]) -> tuple[list[str], list[str]]:
    names = [_text(one) for one in cells]
    return names, [base_name(one)[1] for one in names]


def _said(lines: Sequence[bytes]) -> dict[str, str]:
    """Lines of a key and a value, quoted or not."""
    found = {}
    for line in lines:
        key, mark, value = line.lstrip(b"#% ").partition(b",")
        if not mark:
            key, mark, value = line.lstrip(b"#% ").partition(b":")
        if mark:
            found[_text(key).strip('"')] = _text(value).strip('"')
    return found


def _is_numbers(cells: Sequence[bytes]) -> bool:
    return all(
        not one.strip() or is_number(one.replace(b",", b".")) or seconds_of(one.decode("latin-1"))
        for one in cells
    )


def _has_number(lines: Sequence[bytes], mark: bytes) -> bool:
    return any(
        is_number(one) for line in lines[:UNITS_BELOW] for one in plain(line, mark).split(mark)
    )


def separator_of(line: bytes) -> bytes:
    """Tab, semicolon, pipe or comma, whichever a line has outside quotes, or else spaces."""
    bare = _QUOTED.sub(b"", line)
    for mark in (b"\t", b";"):
        if mark in bare:
            return mark
    if bare.count(b"|") > bare.count(b","):
        return b"|"
    words = bare.split()
    spaced = b"," not in bare or all(is_number(one.replace(b",", b".")) for one in words)
    return b" " if spaced and len(words) >= FEWEST_SPACED else b","


def _even(lines: Sequence[bytes]) -> bool:
    """Whether lines are rows of as many words each, and no sentences."""
    words = [len(one.split()) for one in lines[:LOOKED_AT]]
    usual = Counter(words[1:]).most_common(1)
    return bool(usual) and all(abs(one - usual[0][0]) <= 1 for one in words[:-1])


def plain(text: bytes, separator: bytes, *, keep_commas: bool = False) -> bytes:
    """Text without quotes and carriage returns, decimal commas as points."""
    if b'"' in text:
        text = _QUOTED.sub(
            lambda cell: cell.group(1).replace(separator, b"." if separator == b"," else b" "),
            text,
        )
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").rstrip(b"\r")
    if separator != b"," and not keep_commas:
        text = text.replace(b",", b".")
    if separator == b" ":
        text = _SPACES.sub(b" ", text)
        text = _ENDS.sub(b"", text)
    return text


def is_number(cell: bytes) -> bool:
    """Whether a cell reads as one."""
    try:
        float(cell)
    except ValueError:
        return False
    return b"_" not in cell


def _text(cell: bytes) -> str:
    try:
        return cell.strip().decode("utf-8")
    except UnicodeDecodeError:
        return cell.strip().decode("latin-1")


# Delimited text as spreadsheets and loggers write it, read block by block into numbers.
#
# Accepted: comma, semicolon, tab, pipe or spaces; decimal comma; quotes; CRLF; a byte-order mark;
# Excel's ``sep=;`` line; a leading column of row numbers with or without a name; a separator at the
# end of each line; ``1,23E+09`` unquoted in the last column of a comma-separated line; comments and
# other lines before the header, and units below it; dates and times of the day, read as seconds,
# and seconds with a column of their fraction. A last line without its end that does not read is
# taken for a torn write: it is left out and named in ``damage``. Any other cell that is not a
# number is an error with its line and column.


BLOCK_BYTES = 8 << 20
_HEAD_BYTES = 1 << 16
_JUDGED_BYTES = 1 << 20
"""Of a file's first rows, by whose texts its columns are judged."""
MISSING = (
    b"",
    *b"NA N/A n/a #N/A <NA> NULL null None none - ? NaN nan 1.#QNAN -1.#IND 1.#IND #NV".split(),
)
"""Cells without a value, as spreadsheets, R, pandas, databases and C write them."""
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
"""With which Excel's "Unicode text" begins."""


@dataclass(frozen=True, slots=True)
class Said:
    """What a file says of itself: column -> unit, and key -> text of lines before its header."""

    units: Mapping[str, str] = field(default_factory=dict)
    lines: Mapping[str, str] = field(default_factory=dict)

    def unit_of(self, column: str | int) -> str:
        return self.units.get(str(column), "")

    def numbers(self, key: str) -> list[float]:
        """The numbers of a line, none where there is no such line."""
        found = re.findall(r"[-+]?\d+(?:\.\d+)?", self.lines.get(key, "")) if key else []
        return [float(one) for one in found]


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive rows of a table.

    values: (rows, columns asked for), NaN in an empty cell. error: makes one that names the place
    of ``values[row, column]`` in the file, and why.
    """

    values: NDArray[np.float64]
    error: Callable[[int, int, str], BadInputError]


@dataclass(frozen=True, slots=True)
class ColumnTable:
    """A table whose columns are in memory: one block.

    numbers: of a column, NaN where it has none; raises BadInputError where it holds none.
    first_cells: of the column at a place, as text, where rows may be several crafts'. said: what
    the file says of its columns.
    """

    path: Path
    names: list[str]
    numbers: Callable[[str], NDArray[np.float64]]
    said: Said = field(default_factory=Said)
    first_cells: Callable[[int], list[str]] = lambda place: []
    damage: list[str] = field(default_factory=list)

    @property
    def width(self) -> int:
        return len(self.names)

    def said_by(self, named: bool) -> Said:
        return self.said

    def first_numbers(self, name: str) -> NDArray[np.float64] | None:
        """The numbers of a column; None where it holds none."""
        try:
            return self.numbers(name)
        except BadInputError:
            return None

    def blocks(self, columns: Sequence[int]) -> Iterator[Block]:
        names = [self.names[place] for place in columns]

        def error(row: int, column: int, why: str) -> BadInputError:
            return BadInputError(f"{self.path}: {names[column]}, row {row + 1}: {why}")

        yield Block(np.column_stack([self.numbers(name) for name in names]), error)


@dataclass(slots=True)
class TextTable:
    """The layout of a delimited file; ``blocks`` reads the numbers.

    names: one per field of a row, "" where the header has none. Empty for a file without a
        header line.
    units: one per name, as the file says them, "" where it does not.
    said: key -> text of lines before the header.
    damage: filled while reading.
    text: the whole, where the file is not in UTF-8 or Latin-1. only: a column's place and the value
        that it has in the rows that are read, None: all.
    dated: places of columns of dates or times of the day, and after how many s they begin anew.
    fractions: place of whole seconds -> that of their fraction, and its unit in s.
    """

    path: Path
    separator: bytes
    names: list[str]
    width: int
    damage: list[str] = field(default_factory=list)
    _data_offset: int = 0
    _data_line: int = 1
    _first_rows: list[list[bytes]] | None = None
    units: list[str] = field(default_factory=list)
    said: dict[str, str] = field(default_factory=dict)
    text: bytes | None = None
    only: tuple[int, str] | None = None
    dated: dict[int, float] = field(default_factory=dict)
    fractions: dict[int, tuple[int, float]] = field(default_factory=dict)

    def chosen(self, rows: Rows) -> Self:
        """Read the rows alone that are asked for.

        Raises BadInputError where it has no such column or no such row."""
        if rows.only is not None:
            name, value = rows.only
            refused = f"{self.path}: --only {name}={value}"
            if name not in self.names:
                raise BadInputError(f"{refused}: there is no column {name!r}")
            self.only = self.names.index(name), value
            values = list(dict.fromkeys(self.first_cells(self.only[0])))
            if value not in values:
                listed = ", ".join(values[:NAMED_MOST])
                raise BadInputError(f"{refused}: the column has {listed}")
        return self

    def said_by(self, named: bool) -> Said:
        """What the header says. named: by a map that ships, which knows a format and not a file:
        the file's own unit holds for a column's whole name too, and so does that of a date."""
        units: dict[str, str] = {}
        names = self.names or [str(place + 1) for place in range(self.width)]
        for place, (name, unit) in enumerate(zip(names, self.units, strict=True)):
            if unit:
                units |= {base_name(name)[0]: unit} if base_name(name)[0] != name else {}
                is_time = unit == FRACTION or place in self.dated | self.fractions
                units |= {name: unit} if named or is_time else {}
        return Said(units, self.said)

    def first_cells(self, column: int) -> list[str]:
        """The cells of a column in the first rows, and in the last."""
        if self._first_rows is None:
            with self._open() as file:
                file.seek(self._data_offset)
                head = file.read(_JUDGED_BYTES)
                size = file.seek(0, io.SEEK_END)
                file.seek(max(size - _JUDGED_BYTES // 16, self._data_offset + len(head)))
                tail = file.read()
            whole = self._data_offset + len(head) >= size
            lines = head.split(b"\n") if whole else head.split(b"\n")[:-1]
            lines += tail.split(b"\n")[1:]
            rows = [plain(one, self.separator, keep_commas=True) for one in lines if one.strip()]
            cells = [one.split(self.separator) for one in rows]
            self._first_rows = [one for one in cells if len(one) == self.width]
        return [row[column].decode("latin-1").strip().strip('"') for row in self._first_rows]

    def first_numbers(self, name: str) -> NDArray[np.float64] | None:
        """The first numbers of a column, NaN in an empty cell; None where a cell is none."""
        place = self.names.index(name)
        values = self._numbers_of_first(place)
        if values is not None and place in self.fractions:
            other, size = self.fractions[place]
            fraction = self._numbers_of_first(other)
            return None if fraction is None else values + size * fraction
        return values

    def _numbers_of_first(self, place: int) -> NDArray[np.float64] | None:
        cells = [one.encode("latin-1") for one in self.first_cells(place)]
        if self.separator != b",":
            cells = [one.replace(b",", b".") for one in cells]
        values = [self._value(cell, place) for cell in cells]
        known = [one for one in values if one is not None]
        if len(known) < len(values) or all(map(math.isnan, known)):
            return None
        return np.array(known)

    def _value(self, cell: bytes, column: int) -> float | None:
        """The number of a cell, NaN where it is empty, None where it is none."""
        if cell in MISSING:
            return math.nan
        if column in self.dated:
            return (seconds_of(cell.decode("latin-1")) or (None,))[0]
        return float(cell) if is_number(cell) else None

    def _open(self) -> BinaryIO:
        return self.path.open("rb") if self.text is None else io.BytesIO(self.text)

    def blocks(self, columns: Sequence[int], *, whole: bool = False) -> Iterator[Block]:
        """The numbers in ``columns`` (positions in a row), in blocks of many rows.

        With ``whole`` every cell must be a whole number below 2**53 in magnitude.

        Raises BadInputError naming line and column of a cell that does not read.
        """
        fractions = {
            k: self.fractions[one] for k, one in enumerate(columns) if one in self.fractions
        }
        wanted = [*columns, *(place for place, _ in fractions.values())]
        before_s = dict.fromkeys(self.dated, np.nan)
        for first_line, text, torn in self._texts():
            if not text.strip():
                continue
            try:
                numbers = self._numbers(text, first_line, wanted, whole)
                for further, (place, (_, size)) in enumerate(fractions.items(), len(columns)):
                    numbers[:, place] += size * numbers[:, further]
                go_on(numbers, columns, self.dated, before_s)
                error_at = partial(self._error, text, first_line, columns)
                block = Block(numbers[:, : len(columns)], error_at)
                if whole:
                    _require_whole(block)
            except BadInputError as error:
                if not torn:
                    raise
                self.damage.append(f"the last line is torn and was left out ({error})")
            else:
                yield block

    def _error(
        self, text: bytes, first_line: int, columns: Sequence[int], row: int, column: int, why: str
    ) -> BadInputError:
        """An error that names the line and column of a cell of a block."""
        filled = [n for n, line in enumerate(text.split(b"\n")) if line.strip(b" \r")]
        line = filled[min(row, len(filled) - 1)]  # a row of tabs alone is one as well
        return self._cell_error(first_line + line, columns[column], why)

    def _cell_error(self, line: int, column: int, why: str) -> BadInputError:
        """An error that names the place in the file."""
        name = self.names[column] if self.names else ""
        label = name or f"number {column + 1}"
        return BadInputError(f"{self.path}, line {line}, column {label}: {why}")

    def _texts(self) -> Iterator[tuple[int, bytes, bool]]:
        """Number of the first line, plain lines, and whether they lack their end."""
        line, rest = self._data_line, b""
        with self._open() as file:
            file.seek(self._data_offset)
            while chunk := file.read(BLOCK_BYTES):
                cut = chunk.rfind(b"\n") + 1
                if cut == 0:
                    rest += chunk
                    continue
                text = self._normalise(self._chosen(rest + chunk[:cut]))
                rest = chunk[cut:]
                yield line, text, False
                line += text.count(b"\n")
        yield line, self._normalise(self._chosen(rest)), True

    def _chosen(self, text: bytes) -> bytes:
        """Lines of the rows that were asked for, the others empty."""
        if self.only is None:
            return text
        column, value = self.only
        kept = []
        for line in text.split(b"\n"):
            cells = plain(line, self.separator, keep_commas=True).split(self.separator)
            there = len(cells) > column
            cell = cells[column].decode("latin-1").strip().strip('"') if there else ""
            kept.append(line if cell == value else b"")
        return b"\n".join(kept)

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
        from pyarrow import BufferReader, csv, float64, string

        wanted = [str(column) for column in columns]
        try:
            table = csv.read_csv(
                BufferReader(text),
                csv.ReadOptions(column_names=list(map(str, range(self.width))), use_threads=False),
                csv.ParseOptions(delimiter=self.separator.decode(), quote_char=False),
                csv.ConvertOptions(
                    include_columns=list(dict.fromkeys(wanted)),
                    column_types=dict.fromkeys(wanted, float64())
                    | dict.fromkeys(map(str, self.dated), string()),
                    null_values=[] if whole else [one.decode() for one in MISSING],
                ),
            )
            return np.column_stack([self._column(table.column(k), int(k)) for k in wanted])
        except ValueError:  # ArrowInvalid as well
            return self._one_by_one(text, first_line, columns, whole)

    def _column(self, column: Any, place: int) -> NDArray[np.float64]:
        """A column of Arrow's as numbers. Raises ValueError where a date is none."""
        if place not in self.dated:
            return column.to_numpy()
        found = [self._value(cell.strip().encode(), place) for cell in column.to_pylist()]
        if None in found:
            raise ValueError
        return np.array(found, np.float64)

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
            row = []
            for column in columns:
                cell = cells[column].strip()
                value = self._value(cell, column)
                if value is None or (whole and cell in MISSING):
                    shown = cell[:40].decode("latin-1")
                    kind = "date or time" if column in self.dated else "number"
                    why = f"{shown!r} is not a {kind}" if cell else "the cell is empty"
                    raise self._cell_error(number, column, why)
                row.append(value)
            rows.append(row)
        return np.array(rows)


def open_table(path: Path, skip: int = 0) -> TextTable:
    """Find out how a delimited file is laid out. skip: lines before its header.

    Lines that begin with ``#``, ``%`` or ``//`` and lines of another width before the header are
    passed over, and lines without a number below it; units among these are kept.

    Raises RecordingError where the file cannot be opened, BadInputError where it is empty or
    not a table of text.
    """
    head, offset, text = _head(path)
    lines = [one for one in _lines(head, offset) if one[0] > skip]
    if len(head) == _HEAD_BYTES and len(lines) > 1:
        lines.pop()  # possibly cut
    if not lines:
        raise BadInputError(f"{path}: nothing behind the first {skip} lines")
    announced = re.fullmatch(rb"sep=([,;\t|])", lines[0][2].strip())
    if announced and len(lines) > 1:
        lines = lines[1:]
    found = find_header([line for _, _, line in lines], announced.group(1) if announced else b"")
    layout = TextTable(path, found.separator, found.names, len(found.names), [])
    layout.said, layout.units, layout.text = found.said, found.units, text
    if found.data < len(lines):
        layout._data_line, layout._data_offset, first = lines[found.data]
        if found.names:
            row = plain(first, found.separator)
            layout.names = _align(found.names, row, found.separator)
            if len(layout.names) > len(found.names):
                behind = layout.names[-1] == ""
                layout.units = [*found.units, ""] if behind else ["", *found.units]
        else:
            layout.width = len(
                plain(first, found.separator, keep_commas=True).split(found.separator)
            )
    else:
        layout._data_line, layout._data_offset = lines[-1][0] + 1, len(head)
    layout.width = len(layout.names) or layout.width
    layout.units = layout.units or [""] * layout.width
    _find_times(layout, [line for _, _, line in lines[found.data : found.data + CELLS]])
    return layout


def _find_times(table: TextTable, lines: Sequence[bytes]) -> None:
    """Find the columns of dates and times of the day, by a table's first lines, and the seconds
    that have their fraction beside them. The index of pandas without a name is called time."""
    rows = [plain(one, table.separator, keep_commas=True).split(table.separator) for one in lines]
    for place in range(table.width):
        cells = [row[place].strip() for row in rows if len(row) > place]
        period_s = begins_anew(one.decode("latin-1") for one in cells if one not in MISSING)
        if period_s is not None:
            table.dated[place] = period_s
            if table.names and not table.names[place] and UNNAMED_TIME not in table.names:
                table.names[place] = UNNAMED_TIME
    named = [one for one in table.names if table.names.count(one) == 1]
    for whole, (rest, size) in fractions_of(named, table.first_numbers).items():
        other = table.names.index(rest)
        table.fractions[table.names.index(whole)] = other, size
        table.units[other] = FRACTION
    for place in (*table.dated, *table.fractions):
        table.units[place] = "s"


def _head(path: Path) -> tuple[bytes, int, bytes | None]:
    """The file's first bytes, where its text begins, and all of it where it is UTF-16."""
    with reading(path), path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head.strip():
        raise BadInputError(f"{path}: the file is empty")
    if head[:2] in UTF_16:
        try:
            text = path.read_bytes().decode("utf-16").encode()
        except UnicodeDecodeError as error:
            raise BadInputError(
                f"{path}: the text begins as UTF-16 and does not go on so (byte {error.start});"
                " save it as CSV (UTF-8)"
            ) from error
        if not text.strip():
            raise BadInputError(f"{path}: the file is empty")
        return text[:_HEAD_BYTES], 0, text
    if b"\0" in head.split(b"\n", 1)[0]:
        raise BadInputError(f"{path}: not a text file")
    return head, 3 if head.startswith(b"\xef\xbb\xbf") else 0, None


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
