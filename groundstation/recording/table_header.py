"""The header of a delimited file: which line it is, what is said before it and just below.

Loggers write remarks, keys and values before the names of their columns, and units behind or below
them: ``gyroADC[0] (deg/s)``, ``acc [g]``, or a line ``ms,deg/s,g``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from groundstation.recording.time_cells import seconds_of

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
    "%",
    "rad/s",
    "deg/s",
    "m/s^2",
    "g",
    "rad",
    "deg",
    "rev/s",
    "rpm",
    "m",
    "m/s",
    "mm",
    "A",
    "mA",
    "W",
    "Pa",
    "flags",
    "1",
    "-",
    "C",
    "degC",
}


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
