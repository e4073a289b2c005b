"""Which channel a column is by its name, in the spellings that loggers use."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field

from groundstation.recording.map_document import UNITS
from groundstation.recording.table_header import base_name

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
