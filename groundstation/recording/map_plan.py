"""From a column map to channels: names, units and places in a file."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.recording.delimited import FRACTION, base_name, called
from groundstation.recording.map_document import (
    MOST,
    NAMED,
    UNITS,
    ZERO,
    Choice,
    Clock,
    Column,
    ColumnMap,
    Kind,
    load_column_map,
    map_for,
)
from groundstation.recording.motor_columns import siblings
from groundstation.recording.session import EVERY_ROW, Rows
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY, TICK_S

# In which unit a column is, and which way its axis points, by its numbers.


RATES_HZ, USUAL_HZ = (1.0, 10_000.0), 100.0
"""Rows a second of any log, and of most."""
GYRO_RAD_S = 35.0
"""2000 deg/s: no gyro of a quadrotor measures more."""
SPAN_S = 0.05
"""Over which an angle's change is compared with the gyro: longer than any of them is renewed."""
ALIKE = 0.4
"""Correlation from which two series turn together."""
_TIMES = {"ms": 1e-3, "s": 1.0, "us": 1e-6, "ns": 1e-9}
_DUTY = (
    (1.05, "fraction", "within 0 to 1"),
    (101.0, "%", "within 0 to 100"),
    (255.5, "8-bit", "within 0 to 255"),
)


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
    if quantity == "duty":
        return _duty(values, most)
    if quantity == "battery":
        return ("mV", f"about {np.median(values):.0f}") if most > 200 else ("V", f"to {most:.3g}")
    if quantity == "attitude":
        if most > 400:
            return "counts", f"to {most:.0f}: more than a turn in deg"
        if most > 6.3:
            return "deg", f"to {most:.3g}: more than a turn in rad"
        return "rad", f"none beyond {most:.3g}"
    if quantity == "rotor":
        if most > 3000:
            return "rpm", f"to {most:.0f}"
        return ("rad/s" if most > 500 else "rev/s"), f"to {most:.0f}"
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
    if most > GYRO_RAD_S:
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


def _duty(values: Array, most: float) -> tuple[str, str]:
    least = float(values.min())
    for limit, unit, why in _DUTY:
        if most <= limit:
            return unit, why
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
    places: dict[str, int] = dataclass_field(default_factory=dict)
    many: dict[int, int] = dataclass_field(default_factory=dict)


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


# Which map a table is read by: the one that is named, the one that ships and fits, or the one that
# knows most of its columns, with the table's own time.


KNOWN_FROM = 3
"""Columns that a map must know of a table: an axis of each kind, or all axes of one."""
ALL_COLUMNS = "columns"
"""Table that keeps every column of a file of which no channel is known."""
SHOWN = 12
"""Columns that an error names."""

NumbersOf = Callable[[str], NDArray[np.float64] | None]
"""The first numbers of a column, None where it holds none."""


def map_of_table(
    path: Path,
    names: Sequence[str],
    numbers: NumbersOf,
    source: str | Path | None,
    rows: Rows = EVERY_ROW,
    said: Said = SILENT,
) -> tuple[ColumnMap, Path]:
    """The map of a table, and where it is.

    names: of its columns, as it spells them. source: a map that the user named. said: the units
    that the table says.

    Raises BadInputError where the table has no time and nobody said how far apart its rows are, and
    as ``map_for``.
    """
    step = Clock(step=1.0 / rows.rate_hz) if rows.rate_hz else None
    exact = source if source is not None else map_of_header(names)
    if exact is not None:
        found, where = map_for(path, "csv", exact)
        return (msgspec.structs.replace(found, time=step) if step else found), where
    clock = step or _time_of(names, numbers, said)
    if clock is None:
        listed = ", ".join(names[:SHOWN]) or "they have no names"
        raise BadInputError(
            f"{path}: no column is a time ({listed}); say how many rows a second there are (--rate"
            " HZ), or which column it is with 'groundstation convert FILE --map'"
        )
    return nearest_map(names, clock) or (_all_columns(names, numbers, clock), path)


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


def _time_of(names: Sequence[str], numbers: NumbersOf, said: Said) -> Clock | None:
    """The column that is named as times are and goes on, or else one that has a time's unit and
    does."""
    named = [one for one in groups_of(names) if one.quantity == "time"]
    measured = [one for one in names if said.unit_of(base_name(one)[0]) in UNITS["time"]]
    for name in (*(names[one.places[""]] for one in named), *measured):
        values = numbers(name) if said.unit_of(name) != FRACTION else None
        if values is not None and (len(values) < 2 or goes_on(values)):
            return Clock(column=base_name(name)[0], unit=unit_in_name(name, "time"))
    return None


def _all_columns(names: Sequence[str], numbers: NumbersOf, clock: Clock) -> ColumnMap:
    kept = [name for name in names if name and name != clock.column and numbers(name) is not None]
    return ColumnMap(
        time=clock, tables={ALL_COLUMNS: kept}, family="unknown", title="a table with a time column"
    )
