"""Any other CSV through a column map: a TOML file that says column, unit and sign per field.

    [time]
    column = "t"
    unit = "ms"

    [gyro.x]
    column = "wx"
    unit = "deg/s"
    sign = -1

``column`` is a name of the header line or a number counted from 1 (the only choice for a file
without a header). ``sign = -1`` turns an axis into the design's frame: body x forward, y left,
z up; roll left side up, pitch nose down, yaw counter-clockwise positive. Fields: time;
battery; duty.m1..m4; gyro.x..z; accelerometer.x..z; attitude.roll, .pitch, .yaw;
rotor.m1..m4; debug. Only time is required. ``[tables]`` names further columns, kept as they stand
under a name of their own; ``vehicle`` is the profile of the craft that flew, ``title`` says what
such files are.

The maps in ``maps/`` ship with the program, under the name of their file.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.documents import decode_toml, read_document
from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.craft_family import family_of
from groundstation.recording.delimited import Block, TextTable, open_table
from groundstation.recording.device_time import SYNTHESISED, host_time_from_ticks, segments_of
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.packet import (
    ACCELEROMETER_M_S2,
    ANGLE_RAD,
    BATTERY_V,
    DUTY,
    GYRO_RAD_S,
    STANDARD_GRAVITY,
    TICK_S,
)
from groundstation.telemetry.samples import SampleBatch, empty_samples

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "ticks": TICK_S},
    "battery": {"V": 1.0, "mV": BATTERY_V},
    "duty": {
        "fraction": 1.0,
        "%": 0.01,
        "8-bit": 1 / 255,
        "12-bit": DUTY,
        "16-bit": 1 / 65535,
    },
    "gyro": {"rad/s": 1.0, "deg/s": math.radians(1), "counts": GYRO_RAD_S},
    "accelerometer": {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "counts": ACCELEROMETER_M_S2},
    "attitude": {"rad": 1.0, "deg": math.radians(1), "counts": ANGLE_RAD},
    "rotor": {"rev/s": 1.0, "rpm": 1 / 60, "rad/s": 1 / math.tau},
}
"""Unit names per quantity and their size: s, V, duty 0..1, rad/s, m/s^2, rad, rev/s.

``ticks`` and ``counts`` are the telemetry packet's (73/72 us; 1/16.384 deg/s; 1/4096 g;
0.01 deg); ``12-bit`` is its duty of 1/4096, 8 and 16 bits count to 255 and 65535.
"""

NAMED = {path.stem: path for path in sorted((Path(__file__).parent / "maps").glob("*.toml"))}
"""The maps that ship with the program."""
_TICK_S = 1e-9
"""Tick of a mapped recording whose time is not in the packet's ticks."""
_LIMITS = {"ticks": (-4e18, 4e18), "debug": (0.0, 2.0**32 - 1)}


class Column(msgspec.Struct, forbid_unknown_fields=True):
    """Where one channel comes from."""

    column: Annotated[str, msgspec.Meta(min_length=1)] | Annotated[int, msgspec.Meta(ge=1)]
    unit: str
    sign: Literal[1, -1] = 1


class Clock(msgspec.Struct, forbid_unknown_fields=True):
    """Where device time comes from."""

    column: Annotated[str, msgspec.Meta(min_length=1)] | Annotated[int, msgspec.Meta(ge=1)]
    unit: str


class Plain(msgspec.Struct, forbid_unknown_fields=True):
    """Where the debug word comes from: a whole number as it stands."""

    column: Annotated[str, msgspec.Meta(min_length=1)] | Annotated[int, msgspec.Meta(ge=1)]


class Axes(msgspec.Struct, forbid_unknown_fields=True):
    x: Column | None = None
    y: Column | None = None
    z: Column | None = None


class Angles(msgspec.Struct, forbid_unknown_fields=True):
    roll: Column | None = None
    pitch: Column | None = None
    yaw: Column | None = None


class Motors(msgspec.Struct, forbid_unknown_fields=True):
    m1: Column | None = None
    m2: Column | None = None
    m3: Column | None = None
    m4: Column | None = None


class ColumnMap(msgspec.Struct, forbid_unknown_fields=True):
    """A column map as its TOML file spells it."""

    time: Clock
    battery: Column | None = None
    duty: Motors = msgspec.field(default_factory=Motors)
    gyro: Axes = msgspec.field(default_factory=Axes)
    accelerometer: Axes = msgspec.field(default_factory=Axes)
    attitude: Angles = msgspec.field(default_factory=Angles)
    rotor: Motors = msgspec.field(default_factory=Motors)
    debug: Plain | None = None
    tables: dict[str, list[Annotated[str, msgspec.Meta(min_length=1)]]] = {}
    vehicle: str | None = None
    title: str = ""


def map_of_header(names: Collection[str]) -> str | None:
    """The one named map of which every column stands in a header, or None."""
    fitting = [name for name, path in NAMED.items() if _all_columns(path) <= set(names)]
    return fitting[0] if len(fitting) == 1 else None


def read_mapped_csv(path: Path, source: str | Path) -> Recording:
    """Read any CSV by the columns that a map names: one of ``NAMED``, or a TOML file.

    A time that goes backwards starts a new segment; an empty cell is NaN; a channel that is
    not mapped is NaN. There are no raw packets.

    Raises RecordingError where a file cannot be opened, BadInputError where the map is wrong
    (file and key), a column is missing, or a cell does not read (file, line, column).
    """
    map_path = NAMED.get(str(source), Path(source))
    column_map = load_column_map(map_path)
    channels, tick_s, mapping = _plan(column_map, map_path)
    kept = [
        _Channel(f"tables.{name}", column, name, None, 1.0)
        for name, columns in column_map.tables.items()
        for column in columns
    ]
    table = open_table(path)
    places = [_place(table, channel, map_path) for channel in (*channels, *kept)]
    batches, rest = [], [np.empty((0, len(kept)))]
    for block in table.blocks(places):
        batches.append(_batch(block, channels, tick_s))
        rest.append(block.values[:, len(channels) :])
    samples = SampleBatch.concatenate(batches) if batches else empty_samples(0, tick_s)
    samples.segment[:] = segments_of(samples.ticks)
    samples.host_time_ns[:] = host_time_from_ticks(samples.ticks, tick_s, samples.segment)
    metadata = {"host_time": dict(SYNTHESISED), "column_map": mapping}
    if column_map.vehicle is not None:
        metadata["vehicle"] = {"profile": column_map.vehicle}
    else:
        metadata["vehicle"] = family_of(table.names, samples)
    return Recording(
        path=path,
        kind="csv",
        samples=samples,
        tables=_tables(kept, np.concatenate(rest), samples.time_s),
        metadata=metadata,
        damage=table.damage,
    )


def _tables(
    kept: list[_Channel], values: NDArray[np.float64], time_s: NDArray[np.float64]
) -> dict[str, Table]:
    """The columns (n, len(kept)) that are no channel of the samples, by the map's table names."""
    tables: dict[str, Table] = {}
    for channel, column in zip(kept, values.T, strict=True):
        table = tables.setdefault(channel.field, Table(time_s, {}))
        table.columns[str(channel.column)] = column
    return tables


def _all_columns(path: Path) -> set[str]:
    """Names of the columns that a named map asks for."""
    column_map = load_column_map(path)
    channels, _, _ = _plan(column_map, path)
    kept = [column for columns in column_map.tables.values() for column in columns]
    return {str(channel.column) for channel in channels} | set(kept)


def load_column_map(path: Path) -> ColumnMap:
    """Read and check a column map.

    Raises RecordingError where the file cannot be opened, BadInputError naming the key that is
    wrong.
    """
    try:
        return decode_toml(read_document(path), ColumnMap)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise BadInputError(f"{path}: not a column map: {error}") from error


@dataclass(frozen=True, slots=True)
class _Channel:
    """One mapped channel: the sample's value = ``scale`` x the cell."""

    key: str
    column: str | int
    field: str
    index: int | None
    scale: float


_FIELDS = {
    "duty": "duty",
    "gyro": "gyro",
    "accelerometer": "accelerometer",
    "attitude": "attitude",
    "rotor": "rotor_rev_s",
}


def _plan(mapping: ColumnMap, path: Path) -> tuple[list[_Channel], float, dict[str, str]]:
    """Channels with time first, the tick, and the map as text for the recording's metadata."""
    tick_s = TICK_S if mapping.time.unit == "ticks" else _TICK_S
    time_scale = _scale("time", "time", mapping.time.unit, path) / tick_s
    channels = [_Channel("time", mapping.time.column, "ticks", None, time_scale)]
    text = {"time": f"{mapping.time.column} {mapping.time.unit}"}
    for key, quantity, field, index, column in _columns(mapping):
        scale = _scale(key, quantity, column.unit, path) * column.sign
        channels.append(_Channel(key, column.column, field, index, scale))
        text[key] = f"{column.column} {'-' if column.sign < 0 else ''}{column.unit}"
    if mapping.debug is not None:
        channels.append(_Channel("debug", mapping.debug.column, "debug", None, 1.0))
        text["debug"] = str(mapping.debug.column)
    return channels, tick_s, text


def _columns(mapping: ColumnMap) -> Iterator[tuple[str, str, str, int | None, Column]]:
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


def _place(table: TextTable, channel: _Channel, map_path: Path) -> int:
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


def _batch(block: Block, channels: list[_Channel], tick_s: float) -> SampleBatch:
    samples = empty_samples(len(block.values), tick_s)
    for place, channel in enumerate(channels):
        values = block.values[:, place]
        if channel.field in _LIMITS:
            low, high = _LIMITS[channel.field]
            scaled = np.rint(values * channel.scale)
            wrong = np.flatnonzero(~((scaled >= low) & (scaled <= high)))
            if len(wrong):
                row = int(wrong[0])
                raise block.error(row, place, f"{values[row]:g} cannot be {channel.key}")
            getattr(samples, channel.field)[:] = scaled
        else:
            target = getattr(samples, channel.field)
            target = target if channel.index is None else target[:, channel.index]
            target[:] = values * channel.scale
    return samples
