"""Times that are no plain number: dates and times of the day as text, and seconds whose fraction is
in a column of its own."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date
from functools import lru_cache
from itertools import islice

import numpy as np

from groundstation.telemetry.arrays import Array

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
