"""A column map as a document: read from TOML, and written."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from groundstation.documents import decode_toml, read_document
from groundstation.errors import BadInputError, RecordingError
from groundstation.telemetry.packet import (
    ACCELEROMETER_M_S2,
    ANGLE_RAD,
    BATTERY_V,
    DUTY,
    FULL_16_BIT,
    GYRO_RAD_S,
    STANDARD_GRAVITY,
    TICK_S,
)
from groundstation.text import printable

# Any other CSV through a column map: a TOML file that says column, unit and sign per field.
#
#     [time]
#     column = "t"
#     unit = "ms"
#
#     [gyro.x]
#     column = "wx"
#     unit = "deg/s"
#     sign = -1
#
# ``column`` is a name of the header line, with its unit or without (``gyro (deg/s)``), or a
# number counted from 1 (the only choice for a file without a header). Where a header says the
# unit of a name given without, that unit holds. ``scale`` is multiplied with a cell to be in
# ``unit``; ``per`` names a line before the header that says how many are one unit instead.
# ``unit`` may list several that begin elsewhere: the numbers tell it, or ``told_by`` a line
# before the header that holds their least and largest. ``sign = -1`` turns an axis into the
# design's frame: body x forward, y left, z up; roll left side up, pitch nose down, yaw counter-
# clockwise positive. Fields: time; battery; duty.m1..m4; gyro.x..z; accelerometer.x..z;
# attitude.roll, .pitch, .yaw or quaternion.w..z; rotor.m1..m4; debug. Only time is required: a
# column, or ``step``, the seconds from one row to the next, where the file has none. A field may
# list several columns: the first that the file has is taken. ``[tables]`` names further columns,
# kept as they stand under a name of their own. Of the map itself:
#
# - ``title``: what such files are; ``vehicle``: the profile of the craft that flew; ``family``:
# what is known of a craft that the file does not name. - ``partial``: any column but time may be
# missing; ``signature``: columns by which such a file is recognised (without: all of them). -
# ``yaw_from``: where a yaw of 0 looks. - ``skip``: lines before the header. - ``commands``: its
# motors are a Crazyflie's ``motor.m1..m4`` under other names: of old firmware the thrust that was
# asked for (``thrust_command``). - ``kind``, ``rows``: in a log of many series (``"ulog"``,
# ``"rosbag"``) a column is ``SERIES.FIELD`` and ``rows`` the series that gives the rows:
# ``series_map`` reads those.
#
# The maps in ``maps/`` ship with the program, under the name of their file.


UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "ticks": TICK_S},
    "battery": {"V": 1.0, "mV": BATTERY_V},
    "duty": {
        "fraction": 1.0,
        "%": 0.01,
        "8-bit": 1 / 255,
        "12-bit": DUTY,
        "16-bit": 1 / FULL_16_BIT,
        "dshot": 1 / 1999,
        "pwm-us": 1e-3,
    },
    "gyro": {"rad/s": 1.0, "deg/s": math.radians(1), "counts": GYRO_RAD_S},
    "accelerometer": {
        "m/s^2": 1.0,
        "g": STANDARD_GRAVITY,
        "counts": ACCELEROMETER_M_S2,
        "g/2048": STANDARD_GRAVITY / 2048,
    },
    "attitude": {"rad": 1.0, "deg": math.radians(1), "counts": ANGLE_RAD},
    "quaternion": {"1": 1.0},
    "rotor": {"rev/s": 1.0, "rpm": 1 / 60, "rad/s": 1 / math.tau},
}
"""Unit names per quantity and their size: s, V, duty 0..1, rad/s, m/s^2, rad, rev/s.

``ticks`` and ``counts`` are the telemetry packet's (73/72 us; 1/16.384 deg/s; 1/4096 g;
0.01 deg); ``12-bit`` is its duty of 1/4096, 8 and 16 bits count to 255 and 65535; ``dshot`` from 48
to 2047, ``pwm-us`` from 1000 to 2000.
"""
ZERO = {"dshot": 48.0, "pwm-us": 1000.0}
"""What stands for nothing in the units that begin elsewhere; less is nothing as well."""
MOST = {"dshot": 2047.0, "pwm-us": 2000.0}
"""What stands for all in these."""

NAMED = {path.stem: path for path in sorted((Path(__file__).parent / "maps").glob("*.toml"))}
"""The maps that ship with the program."""


class Column(msgspec.Struct, forbid_unknown_fields=True):
    """Where one channel comes from."""

    column: Annotated[str, msgspec.Meta(min_length=1)] | Annotated[int, msgspec.Meta(ge=1)]
    unit: str | Annotated[list[str], msgspec.Meta(min_length=2)]
    sign: Literal[1, -1] = 1
    scale: Annotated[float, msgspec.Meta(gt=0.0)] = 1.0
    per: str = ""
    told_by: str = ""

    @property
    def units(self) -> list[str]:
        return self.unit if isinstance(self.unit, list) else [self.unit]


class Clock(msgspec.Struct, forbid_unknown_fields=True):
    """Where device time comes from: a column, or ``step``, s from row to row of a file without.
    unit: of the column; empty: the header's, or what its numbers tell."""

    column: (
        Annotated[str, msgspec.Meta(min_length=1)] | Annotated[int, msgspec.Meta(ge=1)] | None
    ) = None
    unit: str = ""
    step: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] | None = None

    def __post_init__(self) -> None:
        if (self.column is None) == (self.step is None):
            raise ValueError("[time] needs either a column or a step")


class Plain(msgspec.Struct, forbid_unknown_fields=True):
    """Where the debug word comes from: a whole number as it stands."""

    column: Annotated[str, msgspec.Meta(min_length=1)] | Annotated[int, msgspec.Meta(ge=1)]


Choice = Column | list[Column]
"""One column, or several of which the first that a file has is taken."""
Kind = Literal["csv", "ulog", "rosbag"]


class Axes(msgspec.Struct, forbid_unknown_fields=True):
    x: Choice | None = None
    y: Choice | None = None
    z: Choice | None = None


class Angles(msgspec.Struct, forbid_unknown_fields=True):
    roll: Choice | None = None
    pitch: Choice | None = None
    yaw: Choice | None = None


class Quaternion(msgspec.Struct, forbid_unknown_fields=True):
    """Attitude of the body (x forward, y left, z up) in a frame with z up, by its components."""

    w: Choice | None = None
    x: Choice | None = None
    y: Choice | None = None
    z: Choice | None = None


class Motors(msgspec.Struct, forbid_unknown_fields=True):
    m1: Choice | None = None
    m2: Choice | None = None
    m3: Choice | None = None
    m4: Choice | None = None


class ColumnMap(msgspec.Struct, forbid_unknown_fields=True):
    """A column map as its TOML file spells it."""

    time: Clock
    battery: Choice | None = None
    duty: Motors = msgspec.field(default_factory=Motors)
    gyro: Axes = msgspec.field(default_factory=Axes)
    accelerometer: Axes = msgspec.field(default_factory=Axes)
    attitude: Angles = msgspec.field(default_factory=Angles)
    quaternion: Quaternion = msgspec.field(default_factory=Quaternion)
    rotor: Motors = msgspec.field(default_factory=Motors)
    debug: Plain | None = None
    tables: dict[str, list[Annotated[str, msgspec.Meta(min_length=1)]]] = {}
    vehicle: str | None = None
    family: Literal["2.x", "unknown"] | None = None
    title: str = ""
    partial: bool = False
    signature: list[str] = []
    kind: Kind = "csv"
    rows: str = ""
    skip: Annotated[int, msgspec.Meta(ge=0)] = 0
    commands: bool = False
    yaw_from: Literal["east", "north"] = "east"


def map_for(path: Path, kind: Kind, source: str | Path) -> tuple[ColumnMap, Path]:
    """The map by which a file of a kind is read: one of ``NAMED``, or a TOML file; and where it is.

    Raises BadInputError where it is a map of another kind, and as ``load_column_map``.
    """
    map_path = NAMED.get(str(source), Path(source))
    column_map = load_column_map(map_path)
    if column_map.kind != kind:
        raise BadInputError(
            f"{path}: {source} is a map of {column_map.kind} files, and this is none"
        )
    return column_map, map_path


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


# A column map as the text of its TOML file.


_HEADING = ("attitude.yaw", "quaternion.z")
"""What has a heading: PX4's is from the north, by the frame of its ULog."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """A channel's column, unit and sign. step_s: seconds between rows, of time without a column."""

    key: str
    column: str | int
    unit: str
    sign: int = 1
    step_s: float = 0.0


def map_text(
    chosen: Sequence[Chosen], file: str, kind: Kind = "csv", rows: str = "", command: str = ""
) -> str:
    """The TOML text of a map. file: that it was made for. rows: series that gives the rows of a log
    of many. command: that reads the file with it, for a remark.

    Raises BadInputError where no channel but time is chosen, or a unit or column is none.
    """
    if not any(one.key != "time" for one in chosen):
        raise BadInputError(f"{file}: no channel was given a column; a map needs one beside time")
    remarks = (f"Columns of {file}", command)
    lines = [f"# {printable(one)}" for one in remarks if one]
    if kind != "csv":
        lines += [f"kind = {_text(kind)}", f"rows = {_text(rows)}"]
    if kind == "ulog" and any(one.key in _HEADING for one in chosen):
        lines.append('yaw_from = "north"')
    for one in chosen:
        lines += ["", f"[{one.key}]"]
        if one.step_s:
            lines.append(f"step = {one.step_s!r}")
            continue
        column = one.column if isinstance(one.column, int) else _text(one.column)
        lines += [f"column = {column}", f"unit = {_text(one.unit)}"]
        if one.sign < 0:
            lines.append("sign = -1")
    text = "\n".join(lines) + "\n"
    try:
        decode_toml(text.encode(), ColumnMap)
    except ValueError as error:
        raise BadInputError(f"{file}: no column map: {error}") from error
    return text


def rows_of(series: Sequence[str], chosen: Sequence[Chosen]) -> str:
    """The series that gives the rows of a log of many: that of the gyro, or else of another
    channel; empty for a table."""
    order = {"gyro.x": 0, "gyro.y": 1, "accelerometer.x": 2, "time": 4}
    first = min(chosen, key=lambda one: order.get(one.key, 3), default=None)
    named = "" if first is None else str(first.column)
    return max((one for one in series if named.startswith(f"{one}.")), key=len, default="")


def command_with(file: Path, map_path: Path) -> str:
    """The command that reads a file by a map, as a shell takes it."""
    return f"groundstation inspect {shlex.quote(str(file))} --columns {shlex.quote(str(map_path))}"


def _text(value: str) -> str:
    """A string of TOML: JSON's, but for DEL, which TOML wants escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
