"""A column map: read from TOML and written, chosen for a file, and what it takes of one."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.documents import decode_toml, read_document
from groundstation.errors import BadInputError
from groundstation.paths import reading
from groundstation.recording.delimited import (
    FRACTION,
    ColumnTable,
    Said,
    TextTable,
    base_name,
    called,
)
from groundstation.recording.motor_columns import siblings
from groundstation.recording.session import Rows
from groundstation.telemetry.arrays import Array
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
from groundstation.text import NAMED_MOST, printable

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
# ``title``: what such files are; ``vehicle``: the profile of the craft that flew; ``family``: what
# is known of a craft that the file does not name; ``partial``: any column but time may be missing;
# ``signature``: columns by which such a file is recognised (without: all of them); ``yaw_from``:
# where a yaw of 0 looks; ``skip``: lines before the header; ``commands``: its motors are a
# Crazyflie's ``motor.m1..m4`` under other names: of old firmware the thrust that was asked for;
# ``kind``, ``rows``: in a log of many series (``"ulog"``, ``"rosbag"``) a column is
# ``SERIES.FIELD`` and ``rows`` the series that gives the rows.
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
        with reading(path):
            return decode_toml(read_document(path), ColumnMap)
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


# In which unit a column is, and which way its axis points, by its numbers.


RATES_HZ, USUAL_HZ = (1.0, 10_000.0), 100.0
"""Rows a second of any log, and of most."""
FASTEST_GYRO_RAD_S = 35.0
"""2000 deg/s: no gyro of a quadrotor measures more."""
SPAN_S = 0.05
"""Over which an angle's change is compared with the gyro: longer than any of them is renewed."""
ALIKE = 0.4
"""Correlation from which two series turn together."""
_TIMES = {"ms": 1e-3, "s": 1.0, "us": 1e-6, "ns": 1e-9}
_BY_MOST = {
    "duty": (
        (1.05, "fraction", "within 0 to 1"),
        (101.0, "%", "within 0 to 100"),
        (255.5, "8-bit", "within 0 to 255"),
    ),
    "attitude": (
        (6.3, "rad", "none beyond {:.3g}"),
        (400.0, "deg", "to {:.3g}: more than a turn in rad"),
        (np.inf, "counts", "to {:.0f}: more than a turn in deg"),
    ),
    "rotor": (
        (500.0, "rev/s", "to {:.0f}"),
        (3000.0, "rad/s", "to {:.0f}"),
        (np.inf, "rpm", "to {:.0f}"),
    ),
}
"""Quantity -> the largest value up to which a unit is the likeliest, and why."""


def unit_of(quantity: str, columns: Sequence[Array]) -> tuple[str, str]:
    """The likeliest unit of a quantity's columns, and why in a few words."""
    rows = min((len(one) for one in columns), default=0)
    values = np.concatenate([one[np.isfinite(one)] for one in columns] or [np.empty(0)])
    if not len(values):
        return _USUAL[quantity], "usual; it has no numbers"
    most = float(np.abs(values).max())
    if quantity == "time":
        return _time(columns[0])
    if quantity == "gyro":
        return _gyro(values, most)
    if quantity == "accelerometer":
        return _force(np.column_stack([one[:rows] for one in columns]))
    for limit, unit, why in _BY_MOST.get(quantity, ()):
        if most <= limit:
            return unit, why.format(most)
    if quantity == "duty":
        return _counted(float(values.min()), most)
    if quantity == "battery":
        return ("mV", f"about {np.median(values):.0f}") if most > 200 else ("V", f"to {most:.3g}")
    return _USUAL[quantity], ""


_USUAL = {
    **{"time": "s", "battery": "V", "duty": "fraction", "gyro": "deg/s", "accelerometer": "m/s^2"},
    **{"attitude": "deg", "quaternion": "1", "rotor": "rpm"},
}


def goes_on(values: Array) -> bool:
    """Whether a column can be a clock: it hardly ever goes back, and it moves."""
    known = values[np.isfinite(values)]
    if len(known) < 2 or len(known) < 0.9 * len(values):
        return False
    steps = np.diff(known)
    return bool((steps >= 0).mean() > 0.9 and (steps > 0).any())


def is_count(values: Array) -> bool:
    """Whether a column numbers the rows."""
    steps = np.diff(values)
    return len(steps) > 0 and bool((steps == steps[0]).all()) and abs(steps[0]) == 1


def ratio(angle: Array, angle_s: Array, rate: Array, rate_s: Array) -> tuple[float, float] | None:
    """How fast an angle turns over what a gyro says, in their own units, and their correlation;
    None where that cannot be told. Angles beyond a turn's half are taken to jump."""
    known = np.isfinite(rate) & np.isfinite(rate_s)
    rate, rate_s = rate[known], rate_s[known]
    given = np.isfinite(angle) & np.isfinite(angle_s)
    angle, angle_s = angle[given], angle_s[given]
    if len(rate) < 20 or len(angle) < 20 or (np.diff(rate_s) < 0).any():
        return None
    place = np.clip(np.searchsorted(angle_s, rate_s, side="right") - 1, 0, len(angle) - 1)
    on_rows = angle[place]
    step_s = float(np.median(np.diff(rate_s)))
    if not step_s > 0:
        return None
    span = max(1, round(SPAN_S / step_s))
    if len(rate) < 3 * span + 10:
        return None
    half = 3.2 if np.abs(on_rows).max() < 6.4 else 180.0
    change = on_rows[span:] - on_rows[:-span]
    took_s = rate_s[span:] - rate_s[:-span]
    total = np.concatenate([[0.0], np.cumsum(rate)])
    mean = (total[span + 1 : -1] - total[1 : -span - 1]) / span
    change, took_s = change[: len(mean)], took_s[: len(mean)]
    sound = (np.abs(change) < half) & (took_s > 0) & (took_s < 4 * SPAN_S)
    if sound.sum() < 10:
        return None
    turned, said = change[sound] / took_s[sound], mean[sound]
    size = float(np.sqrt((turned**2).sum() * (said**2).sum()))
    if size == 0.0:
        return None
    alike = float((turned * said).sum()) / size
    return float(np.sqrt((turned**2).sum() / (said**2).sum())), alike


def nearest(measured: float, sizes: Mapping[str, float]) -> tuple[str, float]:
    """The unit whose size is nearest, and how many times the measure is off it."""
    off = {unit: abs(float(np.log(measured / size))) for unit, size in sizes.items()}
    unit = min(off, key=lambda one: off[one])
    return unit, float(np.exp(off[unit]))


def points_down(z: Array) -> bool:
    """Whether an accelerometer's z reads gravity the other way round."""
    known = z[np.isfinite(z)]
    return len(known) > 0 and float(np.median(known)) < -0.5 * float(np.abs(known).mean()) < 0


def _time(values: Array) -> tuple[str, str]:
    steps = np.diff(values[np.isfinite(values)])
    steps = steps[steps > 0]
    if not len(steps):
        return "s", "usual; it does not go on"
    step = float(np.median(steps))
    rates = {unit: 1.0 / (step * size) for unit, size in _TIMES.items()}
    unit = min(rates, key=lambda one: abs(np.log(rates[one] / USUAL_HZ)))
    return unit, f"a row every {step:.6g}: {rates[unit]:.4g} Hz"


def _gyro(values: Array, most: float) -> tuple[str, str]:
    usual = float(np.percentile(np.abs(values), 99))
    if most > 5000:
        return "counts", f"to {most:.0f}: too fast for deg/s"
    if most > FASTEST_GYRO_RAD_S:
        return "deg/s", f"to {most:.3g}: too fast for rad/s"
    if usual < 10:
        return "rad/s", f"to {most:.3g}: hardly moving in deg/s"
    return "deg/s", f"to {most:.3g}; may be rad/s"


def _force(values: Array) -> tuple[str, str]:
    """By the length of the vector, or what its longest part is."""
    length = np.linalg.norm(values, axis=1)
    length = length[np.isfinite(length)]
    if not len(length):
        return "m/s^2", "usual; it has no numbers"
    mean = float(np.median(length))
    if mean < 1e-9:
        return "m/s^2", "usual; it reads nothing"
    sizes = {"m/s^2": STANDARD_GRAVITY, "g": 1.0, "counts": 4096.0, "g/2048": 2048.0}
    unit, times = nearest(mean, sizes)
    if times > 1.6:
        return unit, f"mean {mean:.3g}; not sure"
    return unit, f"mean {mean:.4g}: gravity in {unit}"


def _counted(least: float, most: float) -> tuple[str, str]:
    """Of duties that go further."""
    if least >= 900 and most <= 2200:
        return "pwm-us", f"{least:.0f} to {most:.0f}: pulses in us"
    if least in (0.0, 48.0) and 1000 < most <= 2047:
        return "dshot", f"{least:.0f} to {most:.0f}"
    if most <= 4096:
        return "12-bit", f"to {most:.0f}, below 4096"
    return "16-bit", f"to {most:.0f}, below 65536"


# Which channel a column is by its name, in the spellings that loggers use.


PARTS = {
    "time": ("",),
    "battery": ("",),
    "duty": ("m1", "m2", "m3", "m4"),
    "gyro": ("x", "y", "z"),
    "accelerometer": ("x", "y", "z"),
    "attitude": ("roll", "pitch", "yaw"),
    "quaternion": ("w", "x", "y", "z"),
    "rotor": ("m1", "m2", "m3", "m4"),
}
"""Quantities of a column map and their parts."""
ORDER = ("time", "rotor", "duty", "gyro", "accelerometer", "quaternion", "attitude", "battery")
"""In which quantities choose among columns: the clearest names first."""
_DIGITS = r"(?P<part>\d{1,2})"
_AXES = r"(?P<part>[xyz]|[0-3])"
_SPELLINGS: tuple[tuple[str, float, str], ...] = (
    ("time", 1.0, r"(?:.*_)?(?:time|time_?stamps?)(?:_(?:boot|elapsed|seconds?|since_\w+))?"),
    ("time", 0.8, r"t|ts|dt_sum|stamp|secs?|seconds|elapsed|clock|millis|micros|ticks?|ms|us"),
    ("rotor", 1.0, rf"(?:.*_)?e?(?:rpm|rotor|prop\w*)(?:_[a-z]+)*?_?m?_?{_DIGITS}(?:_[a-z]+)?"),
    (
        "duty",
        1.0,
        rf"(?:.*_)?(?:motors?|mot|pwm|duty|throttle|esc)(?:_[a-z]+)*?_?m?_?{_DIGITS}"
        rf"(?:_(?:cmd|command|duty|out|output))?",
    ),
    ("duty", 1.1, rf"(?:.*_)?pwm_m_{_DIGITS}_pwm"),
    ("duty", 0.7, rf"(?:.*_)?(?:m|u|outputs?|controls?)_{_DIGITS}(?:_(?:pwm|cmd|duty|out))?"),
    (
        "gyro",
        1.0,
        rf"(?:.*_)?(?:gyr|gyro|gyroscope|angular_(?:velocity|rate)|ang_?vel|body_rates?|omega)"
        rf"(?:_[a-z]+)*?_?{_AXES}",
    ),
    ("gyro", 0.95, r"(?:.*_)?(?P<part>roll|pitch|yaw)_?(?:rates?|speed|vel|velocity|dot)"),
    ("gyro", 0.9, r"(?:.*_)?(?:rates?|vel|velocity|r)_(?P<part>roll|pitch|yaw)"),
    ("gyro", 0.7, r"(?:.*_)?[wg]_?(?P<part>[xyz])"),
    ("gyro", 0.6, r"(?:.*_)?(?P<part>[pqr])"),
    (
        "accelerometer",
        1.0,
        rf"(?:.*_)?(?:acc|accel|accelero|accelerometer|acceleration|specific_force)"
        rf"(?:_[a-z]+|_m_s_2)*?_?{_AXES}",
    ),
    ("accelerometer", 0.7, r"(?:.*_)?a_?(?P<part>[xyz])"),
    ("quaternion", 1.0, r"(?:.*_)?(?:quat|quaternion|orientation|q)_?(?P<part>[wxyz])"),
    ("quaternion", 0.9, r"(?:.*_)?(?:quat|quaternion|q)_?(?P<part>[0-4])"),
    ("attitude", 1.0, r"(?:.*_)?(?P<part>roll|pitch|yaw)(?:_angle|_est\w*)?"),
    ("attitude", 0.8, r"(?:.*_)?(?P<part>phi|theta|psi)"),
    ("attitude", 0.7, rf"(?:.*_)?(?:euler|rpy|angles?|att|attitude)_?{_AXES}"),
    ("battery", 1.0, r"(?:.*_)?(?:v_?bat\w*|bat|batt|battery)(?:_(?:voltage|volts?|v|latest))?"),
    ("battery", 0.8, r"(?:.*_)?(?:voltage|supply|vcc|vin|u_bat)(?:_v)?"),
)
"""Quantity, how clear the spelling is, and the whole of a name's words in it."""
_FIRST = {"p": 0, "q": 1, "r": 2, "phi": 0, "theta": 1, "psi": 2, "roll": 0, "pitch": 1, "yaw": 2}
_UNLIKELY = re.compile(
    r"(^|_)(setpoints?|sp|target|desired|des|ref|reference|goal|var\w*|cov\w*|std|sigma|err|error"
    r"|bias|offset|mag|temp\w*|current|integral|pid|noise|filter_state|debug|count|flags?)(_|$)"
)
"""Words of what was wanted, or is known of a value, in place of the value."""
_WORDS = {
    **{"deg_s": "deg/s", "degs": "deg/s", "dps": "deg/s", "deg_sec": "deg/s", "rad_s": "rad/s"},
    **{"rads": "rad/s", "radps": "rad/s", "rad_sec": "rad/s", "m_s_2": "m/s^2", "ms_2": "m/s^2"},
    **{"mps_2": "m/s^2", "m_ss": "m/s^2", "g": "g", "deg": "deg", "degrees": "deg", "rad": "rad"},
    **{"radians": "rad", "v": "V", "volts": "V", "mv": "mV", "rpm": "rpm", "rps": "rev/s"},
    **{"rev_s": "rev/s", "s": "s", "sec": "s", "secs": "s", "ms": "ms", "us": "us", "ns": "ns"},
    **{"usec": "us", "msec": "ms", "nsec": "ns", "pct": "%", "percent": "%"},
}
"""Units as the last words of a name."""
_LONGEST_FIRST = sorted(_WORDS, key=len, reverse=True)


@dataclass(slots=True)
class Group:
    """Columns that one spelling names: places by part of the quantity.

    weight: how clear it is. many: places by number, where more columns are numbered than the
    quantity has parts.
    """

    quantity: str
    weight: float
    places: dict[str, int] = field(default_factory=dict)
    many: dict[int, int] = field(default_factory=dict)


def groups_of(names: Sequence[str]) -> list[Group]:
    """Every group of columns that some spelling names, the clearest first."""
    found: dict[tuple[str, str], tuple[float, dict[str, int]]] = {}
    for place, name in enumerate(names):
        for quantity, stem, part, weight in _readings(name):
            _, parts = found.setdefault((quantity, stem), (weight, {}))
            parts.setdefault(part, place)
    groups = [_group(key[0], weight, parts) for key, (weight, parts) in found.items()]
    return sorted(groups, key=lambda one: -one.weight * _share(one))


def words_of(name: str) -> str:
    """A name's words in small letters with ``_`` between them: ``gyroADC[0]`` is gyro_adc_0."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    spaced = re.sub(r"(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", "_", spaced)
    return re.sub(r"[^a-z0-9]+", "_", spaced.lower()).strip("_")


def unit_in_name(name: str, quantity: str) -> str:
    """The unit that a name says of a quantity, behind it or in it, or empty."""
    base, unit = _base(name)
    unit = unit or _split(words_of(base))[1] or _within(words_of(base), quantity)
    if quantity == "duty" and unit == "us":
        return "pwm-us"
    return unit if unit in UNITS[quantity] else ""


def _base(name: str) -> tuple[str, str]:
    """A name without the unit behind it; a number in brackets is a place and no unit."""
    base, unit = base_name(name)
    return (name, "") if unit.isdigit() else (base, unit)


def _within(words: str, quantity: str) -> str:
    """A unit before a place: gyro_rad[0], accelerometer_m_s2[0]."""
    found = re.search(r"_(rad|deg|m_s_2|g)_\d$", words)
    if not found:
        return ""
    rate = "/s" if quantity == "gyro" else ""
    return _WORDS[found[1]] + rate


def _split(words: str) -> tuple[str, str]:
    """A name's words without a unit at their end, and that unit."""
    for one in _LONGEST_FIRST:
        if words.endswith(f"_{one}"):
            return words[: -len(one) - 1], _WORDS[one]
    return words, ""


def _readings(name: str) -> list[tuple[str, str, str, float]]:
    """Each quantity that a name may be: stem, part, and how clear it is."""
    words = words_of(_base(name)[0])
    core, unit = _split(words)
    doubt = 0.4 if _UNLIKELY.search(words) else 1.0
    best: dict[str, tuple[str, str, str, float]] = {}
    for quantity, weight, spelling in _SPELLINGS:
        for text in dict.fromkeys((core, words)):
            read = re.fullmatch(spelling, text)
            if not read:
                continue
            part = read.groupdict().get("part") or ""
            stem = text
            if part:
                stem = f"{text[: read.start('part')]}*{text[read.end('part') :]}"
            kind = quantity
            if quantity == "duty" and (unit in UNITS["rotor"] or "rpm" in words.split("_")):
                kind = "rotor"
            if weight * doubt > best.get(kind, ("", "", "", 0.0))[3]:
                best[kind] = (kind, stem, part, weight * doubt)
            break
    if "gyro" in best and "attitude" in best and best["gyro"][3] >= 0.9 * doubt:
        del best["attitude"]  # the rate of an angle
    return list(best.values())


def _group(quantity: str, weight: float, parts: dict[str, int]) -> Group:
    wanted = PARTS[quantity]
    if wanted == ("",):
        return Group(quantity, weight, {"": next(iter(parts.values()))})
    numbers = sorted(int(one) for one in parts if one.isdigit())
    if len(numbers) > len(wanted):
        many = {int(part): place for part, place in parts.items() if part.isdigit()}
        return Group(quantity, weight, many=many)
    first = 0 if 0 in numbers else 1
    places = {}
    for part, place in parts.items():
        if part.isdigit():
            at = int(part) - first
        elif part in wanted:
            at = wanted.index(part)
        else:
            at = _FIRST.get(part, "xyz".find(part))
        if 0 <= at < len(wanted):
            places[wanted[at]] = place
    return Group(quantity, weight, dict(sorted(places.items(), key=lambda one: one[1])))


def _share(group: Group) -> float:
    """How much of the quantity a group has, by the square root."""
    return float((len(group.places) / len(PARTS[group.quantity])) ** 0.5)


# Which columns of a file a map takes, and in which units: what the file says of itself, what its
# first numbers tell, and what the map leaves to them.


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


def known_map(kind: Kind, names: Collection[str]) -> str | None:
    """The named map of which every column, or the signature, is in a file; None where none fits, or
    several do: a new map needs a ``signature`` that no other has.

    names: of a table as in its header, of a log of many series ``SERIES.FIELD``."""
    given = called(list(names)) if kind == "csv" else set(names)
    fitting = []
    for name, path in NAMED.items():
        column_map = load_column_map(path)
        if column_map.kind == kind and _is_known(column_map, path, given):
            fitting.append(name)
    return fitting[0] if len(fitting) == 1 else None


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
class Plan:
    """What is read by a map: channels with time first, columns for tables, the tick in s, and the
    map as text for the recording's metadata. beside: columns that are named like the motors', of
    which no more than four may move. by_angles: the attitude is the angles', for the quaternion
    rests."""

    map: ColumnMap
    channels: tuple[Channel, ...]
    kept: tuple[Channel, ...]
    tick_s: float
    text: dict[str, str]
    beside: tuple[Channel, ...] = ()
    by_angles: bool = False

    @property
    def step_s(self) -> float:
        """Between rows that have no time; 0: they have."""
        return self.map.time.step or 0.0

    @property
    def wanted(self) -> tuple[Channel, ...]:
        """Every column that is read, in this order."""
        return (*self.channels, *self.kept, *self.beside)


def plan_of(
    column_map: ColumnMap,
    path: Path,
    names: Collection[str] | None = None,
    header: Said | None = None,
) -> Plan:
    """Which of the columns that a file has (None: not known) the map at ``path`` takes.

    header: what the file itself says of them.

    Raises BadInputError for a unit that is none, and where a partial map finds nothing but time.
    """
    header = header or Said()
    clock = column_map.time
    channels, tick_s = [], _TICK_S
    text = {"time": f"a row every {clock.step:g} s" if clock.step else ""}
    if clock.column is not None:
        said = header.unit_of(clock.column)
        time_unit = said if said in UNITS["time"] else clock.unit
        if time_unit:
            _require_unit("time", "time", time_unit, path)
        tick_s = TICK_S if time_unit == "ticks" else _TICK_S
        time_scale = UNITS["time"][time_unit or "s"] / tick_s
        units = tuple(UNITS["time"]) if not time_unit else (said,) if said == time_unit else ()
        channels = [Channel("time", clock.column, "ticks", None, time_scale, units=units)]
        text = {"time": f"{clock.column} {time_unit}".rstrip()}
    for key, quantity, name, index, listed in _columns(column_map):
        for unit in (unit for one in listed for unit in one.units):
            _require_unit(key, quantity, unit, path)
        column = _first_there(listed, names)
        if column is None:
            if column_map.partial:
                continue
            column = listed[0]
        channel = _channel(key, quantity, name, index, column, header)
        channels.append(channel)
        sign = "-" if column.sign < 0 else ""
        text[key] = f"{column.column} {sign}{' or '.join(channel.units)}"
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
    return Plan(column_map, tuple(channels), kept, tick_s, text, beside)


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
    units, name = plan.channels[open_fields[0]].units, plan.channels[open_fields[0]].field
    within = [
        unit
        for unit in units
        if len(numbers) and ZERO[unit] <= numbers.min() and numbers.max() <= MOST[unit]
    ]
    rests = [unit for unit in within if numbers.min() == ZERO[unit]]
    chosen = (rests or [units[0]])[0]
    unclear = {}
    if len(within) > 1 and not rests:
        other = next(one for one in within if one != chosen)
        unclear[name] = (
            f"{name} between {numbers.min():g} and {numbers.max():g}, never at rest, may be"
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


def _is_known(column_map: ColumnMap, path: Path, names: set[str]) -> bool:
    if not column_map.partial:
        plan = plan_of(column_map, path)
        return {str(channel.column) for channel in (*plan.channels, *plan.kept)} <= names
    if not column_map.signature or not set(column_map.signature) <= names:
        return False
    return any(_first_there(listed, names) is not None for *_, listed in _columns(column_map))


def _channel(
    key: str, quantity: str, field: str, index: int | None, column: Column, header: Said
) -> Channel:
    """A field's column in the unit that the file says, or else the map."""
    units, scale = column.units, column.scale
    said = header.unit_of(column.column)
    if said in UNITS[quantity]:
        units, scale = [said], 1.0
    elif (counts := header.numbers(column.per)[:1]) and counts[0] > 0.0:
        scale = 1.0 / counts[0]
    limits = header.numbers(column.told_by)
    if len(units) > 1 and limits:
        units = [min(units, key=lambda one: abs(ZERO.get(one, 0.0) - limits[0]))]
    zero = ZERO.get(units[0])
    factor = UNITS[quantity][units[0]] * scale * column.sign
    return Channel(key, column.column, field, index, factor, zero, tuple(units))


def _first_there(listed: Sequence[Column], names: Collection[str] | None) -> Column | None:
    """The first column that the file has."""
    for one in listed:
        if names is None or isinstance(one.column, int) or one.column in names:
            return one
    return None


def _columns(mapping: ColumnMap) -> Iterator[tuple[str, str, str, int | None, list[Column]]]:
    """Key, quantity, field of the samples and place in it of each mapped channel; its columns."""
    if mapping.battery is not None:
        yield "battery", "battery", "battery_v", None, _listed(mapping.battery)
    for quantity, name in _FIELDS.items():
        group = getattr(mapping, quantity)
        for index, part in enumerate(group.__struct_fields__):
            if (choice := getattr(group, part)) is not None:
                yield f"{quantity}.{part}", quantity, name, index, _listed(choice)


def _listed(choice: Choice) -> list[Column]:
    return choice if isinstance(choice, list) else [choice]


def _require_unit(key: str, quantity: str, unit: str, path: Path) -> None:
    if unit not in UNITS[quantity]:
        units = ", ".join(UNITS[quantity])
        raise BadInputError(f"{path}: {key}.unit is {unit!r}; choose one of {units}")


# Which map a table is read by: the one that is named, the one that ships and fits, or the one that
# knows most of its columns, with the table's own time.


KNOWN_FROM = 3
"""Columns that a map must know of a table: an axis of each kind, or all axes of one."""
ALL_COLUMNS = "columns"
"""Table that keeps every column of a file of which no channel is known."""


def map_of_table(
    table: TextTable | ColumnTable, source: str | Path | None, rows: Rows
) -> tuple[ColumnMap, Path]:
    """The map of a table, and where it is. source: a map that the user named.

    Raises BadInputError where the table has no time and nobody said how far apart its rows are, and
    as ``map_for``.
    """
    path, names = table.path, table.names
    step = Clock(step=1.0 / rows.rate_hz) if rows.rate_hz else None
    exact = source if source is not None else known_map("csv", names)
    if exact is not None:
        found, where = map_for(path, "csv", exact)
        return (msgspec.structs.replace(found, time=step) if step else found), where
    clock = step or _time_of(table)
    if clock is None:
        listed = ", ".join(names[:NAMED_MOST]) or "they have no names"
        raise BadInputError(
            f"{path}: no column is a time ({listed}); say how many rows a second there are (--rate"
            " HZ), or which column it is with 'groundstation convert FILE --map'"
        )
    nearest = nearest_map(names, clock)
    if nearest is not None:
        return nearest
    kept = [one for one in names if one and one != clock.column]
    kept = [one for one in kept if table.first_numbers(one) is not None]
    every = ColumnMap(
        time=clock, tables={ALL_COLUMNS: kept}, family="unknown", title="a table with a time column"
    )
    return every, path


def nearest_map(names: Sequence[str], clock: Clock) -> tuple[ColumnMap, Path] | None:
    """The named map that knows most of a table's columns, with this clock; whose craft it is, the
    map does not say of another's table."""
    given = called(names)
    best, found = KNOWN_FROM - 1, None
    for where in NAMED.values():
        column_map = load_column_map(where)
        if column_map.kind != "csv":
            continue
        mapped = msgspec.structs.replace(
            column_map, time=clock, partial=True, vehicle=None, family=None
        )
        try:
            plan = plan_of(mapped, where, given)
        except BadInputError:
            continue  # it knows none
        known = sum(one.key != "time" for one in plan.channels)
        if known > best:
            best, found = known, (mapped, where)
    return found


def _time_of(table: TextTable | ColumnTable) -> Clock | None:
    """The column that is named as times are and goes on, or else one that has a time's unit and
    does."""
    names, said = table.names, table.said_by(named=False)
    named = [one for one in groups_of(names) if one.quantity == "time"]
    measured = [one for one in names if said.unit_of(base_name(one)[0]) in UNITS["time"]]
    for name in (*(names[one.places[""]] for one in named), *measured):
        values = table.first_numbers(name) if said.unit_of(name) != FRACTION else None
        if values is not None and (len(values) < 2 or goes_on(values)):
            return Clock(column=base_name(name)[0], unit=unit_in_name(name, "time"))
    return None
