"""Which columns of a file a map takes, and in which units: what the file says of itself, what its
first numbers tell, and what the map leaves to them."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.recording.map_document import (
    MOST,
    NAMED,
    UNITS,
    ZERO,
    Choice,
    Column,
    ColumnMap,
    Kind,
    load_column_map,
)
from groundstation.recording.motor_columns import siblings
from groundstation.recording.table_header import called
from groundstation.recording.unit_guess import RATES_HZ, unit_of
from groundstation.telemetry.packet import TICK_S

_TICK_S = 1e-9
"""Tick of a mapped recording whose time is not in the packet's ticks."""
_FIELDS = {
    "duty": "duty",
    "gyro": "gyro",
    "accelerometer": "accelerometer",
    "attitude": "attitude",
    "rotor": "rotor_rev_s",
    "quaternion": "quaternion",
}


def map_of_header(names: Collection[str]) -> str | None:
    """The one named map of which every column, or the signature, stands in a header, or None."""
    return _fitting("csv", called(list(names)))


def map_of_series(kind: Kind, names: Collection[str]) -> str | None:
    """The same for a log of many series, of which every column is named ``SERIES.FIELD``."""
    return _fitting(kind, set(names))


@dataclass(frozen=True, slots=True)
class Channel:
    """One mapped channel: the sample's value = ``scale`` x (the cell - ``zero``)."""

    key: str
    column: str | int
    field: str
    index: int | None
    scale: float
    zero: float | None = None
    units: tuple[str, ...] = ()
    """In which of these the cells are; more than one until ``decided``. Of time: none where it is
    the map that says so, and not the file."""


@dataclass(frozen=True, slots=True)
class Said:
    """What a file says of itself: column -> unit, and key -> text of lines before its header."""

    units: Mapping[str, str] = dataclass_field(default_factory=dict)
    lines: Mapping[str, str] = dataclass_field(default_factory=dict)

    def unit_of(self, column: str | int) -> str:
        return self.units.get(str(column), "")

    def numbers(self, key: str) -> list[float]:
        """The numbers of a line, none where there is no such line."""
        found = re.findall(r"[-+]?\d+(?:\.\d+)?", self.lines.get(key, "")) if key else []
        return [float(one) for one in found]

    def number(self, key: str) -> float:
        """The one number of a line, or 0."""
        return (*self.numbers(key), 0.0)[0]


SILENT = Said()


@dataclass(frozen=True, slots=True)
class Plan:
    """What is read: channels with time first, columns for tables, the tick in s, and the map as
    text for the recording's metadata. step_s: between rows that have no time; 0: they have. beside:
    columns that are named like the motors', of which no more than four may move. by_angles: the
    attitude is the angles', for the quaternion rests."""

    channels: tuple[Channel, ...]
    kept: tuple[Channel, ...]
    tick_s: float
    text: dict[str, str]
    from_north: bool = False
    step_s: float = 0.0
    beside: tuple[Channel, ...] = ()
    by_angles: bool = False

    @property
    def wanted(self) -> tuple[Channel, ...]:
        """Every column that is read, in this order."""
        return (*self.channels, *self.kept, *self.beside)


def plan_of(
    column_map: ColumnMap,
    path: Path,
    names: Collection[str] | None = None,
    header: Said = SILENT,
) -> Plan:
    """Which of the columns that a file has (None: not known) the map at ``path`` takes.

    header: what the file itself says of them.

    Raises BadInputError for a unit that is none, and where a partial map finds nothing but time.
    """
    clock = column_map.time
    channels, tick_s = [], _TICK_S
    text = {"time": f"a row every {clock.step:g} s" if clock.step else ""}
    if clock.column is not None:
        said = header.unit_of(clock.column)
        time_unit = said if said in UNITS["time"] else clock.unit
        if time_unit:
            _scale("time", "time", time_unit, path)
        tick_s = TICK_S if time_unit == "ticks" else _TICK_S
        time_scale = UNITS["time"][time_unit or "s"] / tick_s
        units = tuple(UNITS["time"]) if not time_unit else (said,) if said == time_unit else ()
        channels = [Channel("time", clock.column, "ticks", None, time_scale, units=units)]
        text = {"time": f"{clock.column} {time_unit}".rstrip()}
    for key, quantity, field, index, choice in _columns(column_map):
        listed = choice if isinstance(choice, list) else [choice]
        for one in listed:
            for unit in one.units:
                _scale(key, quantity, unit, path)
        place = _first_there(listed, names)
        if place is None:
            if column_map.partial:
                continue
            place = 0
        channel = _channel(key, quantity, field, index, listed[place], header)
        channels.append(channel)
        sign = "-" if listed[place].sign < 0 else ""
        text[key] = f"{listed[place].column} {sign}{' or '.join(channel.units)}"
    if column_map.debug is not None:
        channels.append(Channel("debug", column_map.debug.column, "debug", None, 1.0))
        text["debug"] = str(column_map.debug.column)
    if column_map.partial and all(one.key == "time" for one in channels):
        raise BadInputError(f"{path}: the file has none of the columns that this map knows")
    kept = tuple(
        Channel(f"tables.{name}", column, name, None, 1.0)
        for name, columns in column_map.tables.items()
        for column in columns
        if names is None or not column_map.partial or column in names
    )
    motors = [str(one.column) for one in channels if one.field == "duty"]
    beside = tuple(
        Channel(f"beside.{name}", name, "beside", None, 1.0)
        for name in siblings(motors, set(names or ()) - {str(one.column) for one in channels})
    )
    north = column_map.yaw_from == "north"
    return Plan(tuple(channels), kept, tick_s, text, north, clock.step or 0.0, beside)


def decided(
    plan: Plan, values: NDArray[np.float64], named: bool = False
) -> tuple[Plan, dict[str, str]]:
    """The plan with one unit for each field where the map leaves several that begin elsewhere, or
    that of time, and angles in the place of a quaternion that rests, told by the first numbers
    (n, k) of a file; and what they leave open, by field.

    named: by a map that ships: its unit of time holds as far as the numbers allow it.

    Pulses that rest lie between 1000 and 2000 and stand at exactly 1000, DShot at 0 or 48.
    """
    clock_open = bool(plan.channels) and plan.channels[0].key == "time" and len(values) > 0
    units = plan.channels[0].units if clock_open else ()
    doubted = not units and named
    if clock_open and (len(units) > 1 or (doubted and _cannot_be(plan, values[:, 0]))):
        unit, _ = unit_of("time", [values[:, 0]])
        clock = replace(plan.channels[0], scale=UNITS["time"][unit] / plan.tick_s, units=())
        text = {**plan.text, "time": f"{clock.column} {unit} by its numbers"}
        plan = replace(plan, channels=(clock, *plan.channels[1:]), text=text)
    if _moves(plan, "attitude", values) and not _moves(plan, "quaternion", values):
        text = {key: one for key, one in plan.text.items() if not key.startswith("quaternion.")}
        plan = replace(plan, by_angles=True, text=text)
    open_fields = [k for k, one in enumerate(plan.channels) if len(one.units) > 1]
    if not open_fields or not len(values):
        return plan, {}
    numbers = values[:, open_fields]
    numbers = numbers[np.isfinite(numbers)]
    units = plan.channels[open_fields[0]].units
    within = [
        unit
        for unit in units
        if len(numbers) and ZERO[unit] <= numbers.min() and numbers.max() <= MOST[unit]
    ]
    rests = [unit for unit in within if numbers.min() == ZERO[unit]]
    chosen = (rests or [units[0]])[0]
    unclear = {}
    if len(within) > 1 and not rests:
        field = plan.channels[open_fields[0]].field
        other = next(one for one in within if one != chosen)
        unclear[field] = (
            f"{field} between {numbers.min():g} and {numbers.max():g}, never at rest, may be"
            f" {chosen} or {other}: read as {chosen}, a map with the other unit reads it so"
        )
    channels = list(plan.channels)
    for k in open_fields:
        one = channels[k]
        scale = one.scale / UNITS["duty"][one.units[0]] * UNITS["duty"][chosen]
        channels[k] = replace(one, scale=scale, zero=ZERO[chosen], units=(chosen,))
    text = {key: said.replace(" or ".join(units), chosen) for key, said in plan.text.items()}
    return replace(plan, channels=tuple(channels), text=text), unclear


def _moves(plan: Plan, field: str, values: NDArray[np.float64]) -> bool:
    """Whether any column of a field changes within the first rows (n, k)."""
    columns = [values[:, k] for k, one in enumerate(plan.channels) if one.field == field]
    known = [one[np.isfinite(one)] for one in columns]
    return any(len(one) and bool((one != one[0]).any()) for one in known)


def _cannot_be(plan: Plan, time: NDArray[np.float64]) -> bool:
    """Whether no log has as many rows a second as the time's unit makes of the numbers (n,)."""
    steps = np.diff(time[np.isfinite(time)])
    steps = steps[steps > 0.0]
    if not len(steps):
        return False
    step_s = float(np.median(steps)) * plan.channels[0].scale * plan.tick_s
    return not RATES_HZ[0] <= 1.0 / step_s <= RATES_HZ[1]


def _fitting(kind: Kind, names: set[str]) -> str | None:
    fitting = []
    for name, path in NAMED.items():
        column_map = load_column_map(path)
        if column_map.kind == kind and _is_known(column_map, path, names):
            fitting.append(name)
    return fitting[0] if len(fitting) == 1 else None


def _is_known(column_map: ColumnMap, path: Path, names: set[str]) -> bool:
    if not column_map.partial:
        plan = plan_of(column_map, path)
        return {str(channel.column) for channel in (*plan.channels, *plan.kept)} <= names
    if not column_map.signature or not set(column_map.signature) <= names:
        return False
    choices = [choice for *_, choice in _columns(column_map)]
    return any(
        _first_there(one if isinstance(one, list) else [one], names) is not None for one in choices
    )


def _channel(
    key: str, quantity: str, field: str, index: int | None, column: Column, header: Said
) -> Channel:
    """A field's column in the unit that the file says, or else the map."""
    units, scale = column.units, column.scale
    said = header.unit_of(column.column)
    if said in UNITS[quantity]:
        units, scale = [said], 1.0
    elif (counts := header.number(column.per)) > 0.0:
        scale = 1.0 / counts
    limits = header.numbers(column.told_by)
    if len(units) > 1 and limits:
        units = [min(units, key=lambda one: abs(ZERO.get(one, 0.0) - limits[0]))]
    zero = ZERO.get(units[0])
    factor = UNITS[quantity][units[0]] * scale * column.sign
    return Channel(key, column.column, field, index, factor, zero, tuple(units))


def _first_there(listed: Sequence[Column], names: Collection[str] | None) -> int | None:
    """Place of the first column that the file has."""
    there = [
        place
        for place, one in enumerate(listed)
        if names is None or isinstance(one.column, int) or one.column in names
    ]
    return there[0] if there else None


def _columns(mapping: ColumnMap) -> Iterator[tuple[str, str, str, int | None, Choice]]:
    if mapping.battery is not None:
        yield "battery", "battery", "battery_v", None, mapping.battery
    for quantity, field in _FIELDS.items():
        group = getattr(mapping, quantity)
        for index, name in enumerate(group.__struct_fields__):
            column = getattr(group, name)
            if column is not None:
                yield f"{quantity}.{name}", quantity, field, index, column


def _scale(key: str, quantity: str, unit: str, path: Path) -> float:
    units = UNITS[quantity]
    if unit not in units:
        raise BadInputError(f"{path}: {key}.unit is {unit!r}; choose one of {', '.join(units)}")
    return units[unit]
