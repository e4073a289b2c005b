"""Which column a channel may be, guessed from names and numbers, with the reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.documents import open_regular
from groundstation.errors import BadInputError
from groundstation.paths import reading
from groundstation.recording.delimited import FRACTION, TextTable, base_name, open_table
from groundstation.recording.formats import is_text, refuse_unread
from groundstation.recording.map_document import (
    ALIKE,
    ORDER,
    PARTS,
    UNITS,
    Group,
    Kind,
    goes_on,
    groups_of,
    is_count,
    nearest,
    points_down,
    ratio,
    unit_in_name,
    unit_of,
)
from groundstation.recording.ros_bag import is_bag, is_bag_folder, series_of_bag
from groundstation.recording.session import Series
from groundstation.recording.ulog_file import MAGIC as ULOG_MAGIC
from groundstation.recording.ulog_file import content_of
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

# What the columns of another program's table probably are: channel, unit and sign, and why.


KEYS = tuple(f"{name}.{part}".rstrip(".") for name, parts in PARTS.items() for part in parts)
"""Channels of a column map, ``gyro.x`` say."""
SIGNED = ("gyro", "accelerometer", "attitude", "quaternion")
"""Quantities with a direction."""
LEAST = 0.5
"""Clearness from which a name counts."""
_TURNS = {"roll": "x", "pitch": "y", "yaw": "z"}


@dataclass(frozen=True, slots=True)
class FileColumn:
    """One column of a file.

    name: as the file has it, or empty. reference: what a map calls it, a name or a number from 1.
    unit: that the file says, or empty. values: (n,) numbers, NaN where it has none; empty where it
    holds text. time_s: (n,) when each was taken, where the column has a clock of its own.
    """

    name: str
    reference: str | int
    unit: str = ""
    values: Array = field(default_factory=lambda: np.empty(0))
    time_s: Array | None = None

    @property
    def has_numbers(self) -> bool:
        return bool(np.isfinite(self.values).any())

    @property
    def moves(self) -> bool:
        known = self.values[np.isfinite(self.values)]
        return len(known) > 0 and bool((known != known[0]).any())


@dataclass(frozen=True, slots=True)
class Guess:
    """A channel's column, unit and sign, and why in a few words."""

    key: str
    column: FileColumn
    unit: str
    sign: int
    why: str


@dataclass(frozen=True, slots=True)
class Guesses:
    """channels: by their key. notes: what was not guessed, and why, in sentences."""

    channels: Mapping[str, Guess]
    notes: Sequence[str] = ()


def quantity_of(key: str) -> str:
    return key.partition(".")[0]


def guess_map(columns: Sequence[FileColumn]) -> Guesses:
    """The likeliest channel of each column of a file, by names, units and numbers."""
    chosen, notes = _chosen(columns)
    found: dict[str, Guess] = {}
    for quantity in PARTS:  # time and attitude first: a gyro's unit is measured against them
        group = {key: one for key, one in chosen.items() if quantity_of(key) == quantity}
        if group:
            unit, why = guess_unit(quantity, [column for column, _ in group.values()])
            for key, (column, by) in group.items():
                reason = why if why.startswith("its name says") else f"{by}; {why}".rstrip("; ")
                found[key] = Guess(key, column, unit, 1, reason)
    _measure_rates(found)
    _turn(found)
    return Guesses({key: found[key] for key in KEYS if key in found}, notes)


def guess_unit(quantity: str, columns: Sequence[FileColumn]) -> tuple[str, str]:
    """The unit of a quantity's columns, and why: what the file says, or else its numbers."""
    for one in columns:
        if one.unit in UNITS[quantity]:
            return one.unit, f"the file says {one.unit}"
        if said := unit_in_name(one.name, quantity):
            return said, f"its name says {said}"
    return unit_of(quantity, [one.values for one in columns])


_Chosen = dict[str, tuple[FileColumn, str]]


def _chosen(columns: Sequence[FileColumn]) -> tuple[_Chosen, list[str]]:
    """A column for each channel and by what it was found; and what was refused."""
    found: _Chosen = {}
    notes: list[str] = []
    taken: set[int] = set()
    groups = [_of_moving(one, columns) for one in groups_of([one.name for one in columns])]
    has_clocks = any(one.time_s is not None for one in columns)
    for quantity in (*ORDER[1:], "time") if has_clocks else ORDER:
        if quantity == "attitude" and any(key.startswith("quaternion") for key in found):
            continue
        fitting = [one for one in groups if one.quantity == quantity]
        if quantity == "time" and has_clocks:
            fitting = _of_rows(fitting, columns, found)
        if quantity == "time":
            fitting = [one for one in fitting if columns[one.places[""]].unit != FRACTION]
        if quantity == "quaternion" and _any_moves("attitude", groups, columns):
            fitting = [one for one in fitting if _any_moves(quantity, [one], columns)]
        usable = [one for one in fitting if not taken & set(one.places.values())]
        best = max(usable, key=lambda one: _merit(one, columns), default=None)
        if best is None or not _merit(best, columns):
            many = max((len(one.many) for one in fitting), default=0)
            if many and quantity == "duty":
                notes.append(f"{many} motors are no quadrotor's: none is guessed.")
            continue
        for part, place in best.places.items():
            found[f"{quantity}.{part}".rstrip(".")] = columns[place], "by its name"
        taken |= set(best.places.values())
    named = {quantity_of(key) for key in found}
    for key, place, why in () if has_clocks else _by_numbers(columns, taken):
        if quantity_of(key) not in named and place not in taken:
            found[key] = (columns[place], why)
            taken.add(place)
    return found, notes


def _any_moves(quantity: str, groups: Sequence[Group], columns: Sequence[FileColumn]) -> bool:
    """Whether any column changes that may be of a quantity."""
    places = [k for one in groups if one.quantity == quantity for k in one.places.values()]
    return any(columns[place].moves for place in places)


def _of_moving(group: Group, columns: Sequence[FileColumn]) -> Group:
    """Of more numbered columns than a quantity has, as the sixteen outputs of PX4, those that
    move, where they are as many as it has."""
    moving = [place for _, place in sorted(group.many.items()) if columns[place].moves]
    parts = PARTS[group.quantity]
    if len(moving) > len(parts):
        return replace(group, many=dict(enumerate(moving)))
    places = dict(zip(parts, moving, strict=False)) if group.many else group.places
    return Group(group.quantity, group.weight, places)


def _of_rows(times: Sequence[Group], columns: Sequence[FileColumn], found: _Chosen) -> list[Group]:
    """The clocks of the series that gives the rows: the gyro's, or that of the first channel."""
    first = found.get("gyro.x") or next(iter(found.values()), None)
    if first is None:
        return list(times)
    return [one for one in times if columns[one.places[""]].time_s is first[0].time_s]


def _merit(group: Group, columns: Sequence[FileColumn]) -> float:
    """How clear a group is: by its name, how whole it is, and whether its numbers can be it."""
    members = [columns[place] for place in group.places.values()]
    if group.weight < LEAST or not members or not all(one.has_numbers for one in members):
        return 0.0
    if group.quantity == "time" and not goes_on(members[0].values):
        return 0.0
    moving = sum(one.moves for one in members) / len(members)
    whole = len(members) / len(PARTS[group.quantity])
    return group.weight * float(np.sqrt(whole)) * (0.5 + 0.5 * moving)


def _by_numbers(columns: Sequence[FileColumn], taken: set[int]) -> Iterator[tuple[str, int, str]]:
    """What the numbers of neighbouring columns alone tell: a clock, a unit quaternion, gravity."""
    free = [place for place in range(len(columns)) if place not in taken]
    free = [place for place in free if columns[place].has_numbers]
    has_name = any(one.name for one in columns)
    clocks = [place for place in free if goes_on(columns[place].values)]
    clocks = [place for place in clocks if bool((np.diff(columns[place].values) > 0).all())]
    counts = [place for place in clocks if is_count(columns[place].values)]
    for place in [one for one in clocks if one not in counts][:1]:
        yield "time", place, "it always grows"
    if has_name:
        return
    for quantity, size in (("quaternion", 4), ("accelerometer", 3)):
        for first in free:
            places = [first + step for step in range(size)]
            if not set(places) <= set(free):
                continue
            values = np.column_stack([columns[one].values for one in places])
            length = np.linalg.norm(values, axis=1)
            unit = 1.0 if quantity == "quaternion" else STANDARD_GRAVITY
            near = np.abs(length / unit - 1.0) < (0.01 if size == 4 else 0.2)
            if near.mean() > 0.9 and any(columns[one].moves for one in places):
                what = "length 1" if size == 4 else "length of gravity"
                for part, place in zip(PARTS[quantity], places, strict=True):
                    yield f"{quantity}.{part}", place, f"{size} columns of {what}"
                break


def _clock(found: Mapping[str, Guess], column: FileColumn) -> Array | None:
    """When a column's rows were taken, s; None where the file has no clock."""
    if column.time_s is not None:
        return column.time_s
    if "time" not in found:
        return None
    time = found["time"]
    return time.column.values * UNITS["time"][time.unit]


def _rate(found: Mapping[str, Guess], angle: str) -> tuple[float, float] | None:
    """``ratio`` of an angle to the gyro about its axis."""
    turns, gyro = found.get(f"attitude.{angle}"), found.get(f"gyro.{_TURNS[angle]}")
    if turns is None or gyro is None:
        return None
    clocks = _clock(found, turns.column), _clock(found, gyro.column)
    if clocks[0] is None or clocks[1] is None:
        return None
    if len(clocks[0]) != len(turns.column.values) or len(clocks[1]) != len(gyro.column.values):
        return None
    return ratio(turns.column.values, clocks[0], gyro.column.values, clocks[1])


def _measure_rates(found: dict[str, Guess]) -> None:
    """Where the file does not say the gyro's unit, take the one in which it turns as the attitude
    does."""
    gyro = [one for key, one in found.items() if key.startswith("gyro.")]
    if not gyro or "says" in gyro[0].why:
        return
    for angle in _TURNS:
        measured = _rate(found, angle)
        if measured is None or abs(measured[1]) < ALIKE:
            continue
        attitude = found[f"attitude.{angle}"].unit
        size = UNITS["attitude"][attitude]
        unit, times = nearest(measured[0] * size, UNITS["gyro"])
        if times > 2.0:
            continue
        for one in gyro:
            by = one.why.partition("; ")[0]
            found[one.key] = replace(
                one, unit=unit, why=f"{by}; turns as fast as {angle} in {unit}"
            )
        return


def _turn(found: dict[str, Guess]) -> None:
    """Signs: an accelerometer whose z reads gravity downwards, and angles that turn against the
    gyro."""
    z = found.get("accelerometer.z")
    down = z is not None and points_down(z.column.values)
    if down:
        for quantity in ("gyro", "accelerometer", "quaternion"):
            for axis in "yz":
                _sign(found, f"{quantity}.{axis}", -1, "z points down")
    for angle, axis in _TURNS.items():
        key = f"attitude.{angle}"
        if key not in found:
            continue
        measured = _rate(found, angle)
        if measured is not None and abs(measured[1]) >= ALIKE:
            sign = found[f"gyro.{axis}"].sign * (1 if measured[1] > 0 else -1)
            way = "with" if measured[1] > 0 else "against"
            _sign(found, key, sign, f"turns {way} gyro.{axis}")
        elif angle == "pitch":
            _sign(found, key, -1, "most programs count nose up")
        elif angle == "yaw" and down:
            _sign(found, key, -1, "z points down")


def _sign(found: dict[str, Guess], key: str, sign: int, why: str) -> None:
    if key in found:
        found[key] = replace(found[key], sign=sign, why=f"{found[key].why}; {why}")


# The columns of another program's file, with their first numbers: what a column map can name.


ROWS_MOST = 50_000
"""Rows by which guesses are made."""
_HEAD_BYTES = 4096
_MICROSD_MAGIC = b"\xbc"
_FEWEST = 2
"""Columns of numbers; fewer are no table."""


@dataclass(frozen=True, slots=True)
class FileColumns:
    """kind: of map that such a file takes. series: names of those of a log of many."""

    path: Path
    kind: Kind
    columns: Sequence[FileColumn]
    series: Sequence[str] = ()


@np.errstate(invalid="ignore")  # damage may leave a NaN that numpy signals when it is converted
def columns_of(path: Path) -> FileColumns:
    """The columns that a column map can name.

    Raises BadInputError for a file that takes no column map or holds no numbers, RecordingError
    where it does not read.
    """
    found = _of_bag(path) if is_bag_folder(path) else _reader_of(path)(path)
    if sum(one.has_numbers for one in found.columns) < _FEWEST:
        raise BadInputError(f"{path}: no table: fewer than two of its columns hold numbers")
    return found


def _reader_of(path: Path) -> Callable[[Path], FileColumns]:
    with reading(path), open(open_regular(path), "rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        raise BadInputError(f"{path}: is empty (0 bytes)")
    refuse_unread(path, head)
    for begins, read in _READERS:
        if begins(head):
            return read
    raise BadInputError(f"{path}: its channels have fixed names: it takes no column map")


def _of_text(path: Path) -> FileColumns:
    table = open_table(path)
    names = table.names or [""] * table.width
    units = table.units or [""] * table.width
    columns = []
    for place, values in enumerate(_first_numbers(table)):
        name = names[place] if place < len(names) else ""
        unit = units[place] if place < len(units) else ""
        columns.append(FileColumn(name, _reference(names, place), unit, values))
    return FileColumns(path, "csv", columns)


def _reference(names: Sequence[str], place: int) -> str | int:
    """What a map calls a column: its name where it alone has it, else its number."""
    name = names[place]
    return name if name and list(names).count(name) == 1 else place + 1


def _first_numbers(table: TextTable) -> list[Any]:
    """The first numbers of each column, none where one holds text."""
    places = list(range(table.width))

    def first(wanted: list[int]) -> Any:
        for block in table.blocks(wanted):
            return block.values[:ROWS_MOST].T
        return np.empty((len(wanted), 0))

    try:
        return list(first(places))
    except BadInputError as error:
        columns, failed = [], 0
        for place in places:
            try:
                columns.append(first([place])[0])
            except BadInputError:
                columns.append(np.empty(0))
                failed += 1
        if failed == len(places) >= _FEWEST:
            raise error
        return columns


def _of_parquet(path: Path) -> FileColumns:
    from pyarrow import Table

    from groundstation.recording.parquet_file import numbers_of, opened, with_times

    with opened(path) as file:
        batches = [*islice(file.iter_batches(batch_size=ROWS_MOST), 1)]
        table, units = with_times(Table.from_batches(batches, file.schema_arrow))
    columns = []
    for name in table.column_names:
        try:
            values = numbers_of(path, table, name)
        except BadInputError:
            values = np.empty(0)
        columns.append(FileColumn(name, name, units.get(name, base_name(name)[1]), values))
    return FileColumns(path, "csv", columns)


def _of_microsd(path: Path) -> FileColumns:
    """The variables of the event that gives the rows."""
    from groundstation.recording.microsd import read_microsd

    tables = read_microsd(path).tables
    table = tables.get("fixedFrequency") or max(
        tables.values(), key=lambda one: len(one.time_s), default=None
    )
    if table is None:
        raise BadInputError(f"{path}: the microSD log has no events")
    columns = [FileColumn("time", "time", "us", table.time_s[:ROWS_MOST] * 1e6)]
    for name, values in table.columns.items():
        numbers = np.asarray(values[:ROWS_MOST], np.float64)
        columns.append(FileColumn(name, name, "", numbers))
    return FileColumns(path, "csv", columns)


def _of_series(path: Path, kind: Kind, series: Sequence[Series]) -> FileColumns:
    """A column is ``SERIES.FIELD``, on the clock of its series."""
    first_ns = min((int(one.time_ns[0]) for one in series if len(one.time_ns)), default=0)
    columns = []
    for one in series:
        time_s = np.asarray((one.time_ns[:ROWS_MOST] - first_ns) * 1e-9, np.float64)
        for name, values in one.columns.items():
            whole = f"{one.name}.{name}"
            numbers = np.asarray(values[:ROWS_MOST], np.float64)
            columns.append(FileColumn(whole, whole, "", numbers, time_s))
    return FileColumns(path, kind, columns, [one.name for one in series])


def _of_ulog(path: Path) -> FileColumns:
    return _of_series(path, "ulog", content_of(path).series)


def _of_bag(path: Path) -> FileColumns:
    return _of_series(path, "rosbag", series_of_bag(path).series)


_READERS: tuple[tuple[Callable[[bytes], bool], Callable[[Path], FileColumns]], ...] = (
    (lambda head: head.startswith(b"PAR1"), _of_parquet),
    (lambda head: head.startswith(_MICROSD_MAGIC), _of_microsd),
    (is_bag, _of_bag),
    (lambda head: head.startswith(ULOG_MAGIC), _of_ulog),
    (is_text, _of_text),
)
