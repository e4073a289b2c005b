"""Any other CSV through a column map: what ``map_document`` describes, applied to numbers."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import attitude_of_quaternion
from groundstation.errors import BadInputError
from groundstation.recording.craft_family import family_of
from groundstation.recording.delimited import TextTable, open_table
from groundstation.recording.device_time import SYNTHESISED, host_time_from_ticks
from groundstation.recording.map_document import (
    NAMED,
    UNITS,
    ZERO,
    Choice,
    Column,
    ColumnMap,
    Kind,
    load_column_map,
)
from groundstation.recording.row_order import ROWS_METADATA, in_order
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.packet import TICK_S
from groundstation.telemetry.samples import SampleBatch, empty_samples

_TICK_S = 1e-9
"""Tick of a mapped recording whose time is not in the packet's ticks."""
_LIMITS = {"ticks": (-4e18, 4e18), "debug": (0.0, 2.0**32 - 1)}


def map_of_header(names: Collection[str]) -> str | None:
    """The one named map of which every column, or the signature, stands in a header, or None."""
    return _fitting("csv", set(names))


def map_of_series(kind: Kind, names: Collection[str]) -> str | None:
    """The same for a log of many series, of which every column is named ``SERIES.FIELD``."""
    return _fitting(kind, set(names))


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


def read_mapped_csv(path: Path, source: str | Path) -> Recording:
    """Read any CSV by the columns that a map names: one of ``NAMED``, or a TOML file.

    A time that goes backwards starts a new segment; an empty cell is NaN; a channel that is
    not mapped is NaN. There are no raw packets.

    Raises RecordingError where a file cannot be opened, BadInputError where the map is wrong
    (file and key), a column is missing, or a cell does not read (file, line, column).
    """
    map_path = NAMED.get(str(source), Path(source))
    column_map = load_column_map(map_path)
    if column_map.kind != "csv":
        raise BadInputError(f"{path}: a CSV file, and {source} is a map of {column_map.kind} files")
    table = open_table(path)
    plan = plan_of(column_map, map_path, table.names)
    places = [_place(table, channel, map_path) for channel in (*plan.channels, *plan.kept)]
    batches, rest = [], [np.empty((0, len(plan.kept)))]
    for block in table.blocks(places):
        batches.append(samples_of(plan, block.values, block.error))
        rest.append(block.values[:, len(plan.channels) :])
    samples = SampleBatch.concatenate(batches) if batches else empty_samples(0, plan.tick_s)
    return mapped_recording(
        path, plan, column_map, samples, np.concatenate(rest), table.names, table.damage
    )


def mapped_recording(
    path: Path,
    plan: Plan,
    column_map: ColumnMap,
    samples: SampleBatch,
    kept: NDArray[np.float64],
    names: Collection[str],
    damage: list[str],
) -> Recording:
    """What a map makes of a file: samples with their clock, tables from the columns that are kept
    (n, len(plan.kept)), and metadata. names: every column of the file."""
    samples, order = in_order(samples, [kept])
    kept = order.of(kept)
    samples.host_time_ns[:] = host_time_from_ticks(samples.ticks, plan.tick_s, samples.segment)
    metadata = {"host_time": dict(SYNTHESISED), "column_map": plan.text}
    if order.notes:
        metadata[ROWS_METADATA] = order.notes
    if column_map.vehicle is not None:
        metadata["vehicle"] = {"profile": column_map.vehicle}
    elif column_map.family is not None:
        metadata["vehicle"] = {"family": column_map.family, "because": column_map.title}
    else:
        metadata["vehicle"] = family_of(names, samples)
    return Recording(
        path=path,
        kind=column_map.kind,
        samples=samples,
        tables=_tables(plan.kept, kept, samples.time_s),
        metadata=metadata,
        damage=damage,
    )


def _tables(
    kept: Sequence[Channel], values: NDArray[np.float64], time_s: NDArray[np.float64]
) -> dict[str, Table]:
    """The columns (n, len(kept)) that are no channel of the samples, by the map's table names."""
    tables: dict[str, Table] = {}
    for channel, column in zip(kept, values.T, strict=True):
        table = tables.setdefault(channel.field, Table(time_s, {}))
        table.columns[str(channel.column)] = column
    return tables


@dataclass(frozen=True, slots=True)
class Channel:
    """One mapped channel: the sample's value = ``scale`` x (the cell - ``zero``)."""

    key: str
    column: str | int
    field: str
    index: int | None
    scale: float
    zero: float | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """What is read: channels with time first, columns for tables, the tick in s, and the map as
    text for the recording's metadata."""

    channels: tuple[Channel, ...]
    kept: tuple[Channel, ...]
    tick_s: float
    text: dict[str, str]
    from_north: bool = False


_FIELDS = {
    "duty": "duty",
    "gyro": "gyro",
    "accelerometer": "accelerometer",
    "attitude": "attitude",
    "rotor": "rotor_rev_s",
    "quaternion": "quaternion",
}


def plan_of(column_map: ColumnMap, path: Path, names: Collection[str] | None = None) -> Plan:
    """Which of the columns that a file has (None: not known) the map at ``path`` takes.

    Raises BadInputError for a unit that is none, and where a partial map finds nothing but time.
    """
    tick_s = TICK_S if column_map.time.unit == "ticks" else _TICK_S
    time_scale = _scale("time", "time", column_map.time.unit, path) / tick_s
    channels = [Channel("time", column_map.time.column, "ticks", None, time_scale)]
    text = {"time": f"{column_map.time.column} {column_map.time.unit}"}
    for key, quantity, field, index, choice in _columns(column_map):
        listed = choice if isinstance(choice, list) else [choice]
        scales = [_scale(key, quantity, one.unit, path) * one.sign for one in listed]
        place = _first_there(listed, names)
        if place is None:
            if column_map.partial:
                continue
            place = 0
        column = listed[place]
        zero = ZERO.get(column.unit)
        channels.append(Channel(key, column.column, field, index, scales[place], zero))
        text[key] = f"{column.column} {'-' if column.sign < 0 else ''}{column.unit}"
    if column_map.debug is not None:
        channels.append(Channel("debug", column_map.debug.column, "debug", None, 1.0))
        text["debug"] = str(column_map.debug.column)
    if column_map.partial and len(channels) == 1:
        raise BadInputError(f"{path}: the file has none of the columns that this map knows")
    kept = tuple(
        Channel(f"tables.{name}", column, name, None, 1.0)
        for name, columns in column_map.tables.items()
        for column in columns
        if names is None or not column_map.partial or column in names
    )
    return Plan(tuple(channels), kept, tick_s, text, column_map.yaw_from == "north")


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


def _place(table: TextTable, channel: Channel, map_path: Path) -> int:
    """Position in a row of the column that a channel names."""
    if isinstance(channel.column, int):
        if channel.column > table.width:
            raise BadInputError(
                f"{map_path}: {channel.key}.column is {channel.column}, but {table.path} has "
                f"{table.width} columns"
            )
        return channel.column - 1
    found = table.names.count(channel.column)
    if found == 1:
        return table.names.index(channel.column)
    if found > 1:
        raise BadInputError(
            f"{table.path}: {found} columns are named {channel.column!r} "
            f"({channel.key} in {map_path}); give the column's number instead"
        )
    if not table.names:
        raise BadInputError(
            f"{table.path}: no header line, so {channel.key}.column in {map_path} must be a number"
        )
    near = difflib.get_close_matches(channel.column, table.names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise BadInputError(
        f"{table.path}: no column {channel.column!r} ({channel.key} in {map_path}){hint}"
    )


def samples_of(
    plan: Plan,
    values: NDArray[np.float64],
    error: Callable[[int, int, str], BadInputError],
) -> SampleBatch:
    """Samples from the columns (n, len(plan.channels) or more) that a plan names.

    error: what to raise for the cell at a row and column, and why.
    """
    samples = empty_samples(len(values), plan.tick_s)
    quaternion = np.full((len(values), 4), np.nan)
    mapped = {channel.field for channel in plan.channels}
    for place, channel in enumerate(plan.channels):
        cells = values[:, place]
        if channel.field in _LIMITS:
            low, high = _LIMITS[channel.field]
            scaled = np.rint(cells * channel.scale)
            wrong = np.flatnonzero(~((scaled >= low) & (scaled <= high)))
            if len(wrong):
                row = int(wrong[0])
                raise error(row, place, f"{cells[row]:g} cannot be {channel.key}")
            getattr(samples, channel.field)[:] = scaled
            continue
        if channel.zero is not None:
            cells = np.maximum(cells - channel.zero, 0.0)
        if channel.field == "quaternion":
            quaternion[:, channel.index] = cells * channel.scale
        else:
            target = getattr(samples, channel.field)
            target = target if channel.index is None else target[:, channel.index]
            target[:] = cells * channel.scale
    if "quaternion" in mapped:
        size = np.linalg.norm(quaternion, axis=1)
        known = np.isfinite(size) & (size > 0)
        unit = quaternion[known] / size[known, None]
        samples.attitude[known] = attitude_of_quaternion(unit)
    if plan.from_north:
        yaw = samples.attitude[:, 2]
        yaw[:] = np.remainder(yaw + 1.5 * np.pi, math.tau) - np.pi
    return samples
