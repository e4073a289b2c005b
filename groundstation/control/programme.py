"""Programmes of manoeuvres, and what a flight must keep: its start, its room, its limits."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import FULL_16_BIT, TICK_S

# What a craft says of itself in flight, and when it must land.
#
# Pure: the numbers of the daemon's answer to a setpoint, and the time.


BEYOND_M = 0.5
"""Beyond its reach: a craft that brakes from 1.5 m/s needs so much."""
SPEED_M_S = 1.5
"""No manoeuvre of ``learn`` reaches 1.0 m/s."""
HEIGHT_OFF_M, HEIGHT_OFF_S = 0.3, 1.0
"""The largest step of height is 0.4 m, and a craft makes it within 0.6 s."""
THRUST_RATIO, THRUST_S = 1.5, 0.5
"""Of the thrust that hovers: a step of height asks for more for 0.2 s, a height that stands still
for ever."""
APART_M, APART_S, GAP_S = 0.15, 1.0, 0.4
"""A height that has changed in so long by so much more or less than the climb rate says is not that
of the craft: its sensor sticks. The two agree within 0.02 m in flight; across a longer gap nobody
knows, for a craft that begins to climb at 0.6 m/s in it is 0.12 m higher than both ends say."""
BLIND_S = 3.0
"""A craft of which no ``APART_S`` in one piece has come in so long is landed: its height may be
wrong, and nothing would tell."""
LIFT_S, LIFT_M = 2.0, 0.1
"""A craft that is not so high so long after it was asked to climb stays on the ground, or nothing
measures its height."""
SILENT_S = 1.0
"""Age of the newest place."""
AWAY, FAST, NO_LIFT = "position", "speed", "no take-off"
"""How some reasons begin."""
BLIND = "height sensor"
"""And that for which no landing is possible: its motors stop, for it climbs away meanwhile."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a craft says. time_s: by its own clock, which a host that is held up does not change.
    x_m, y_m, vx_m_s, vy_m_s, climb_m_s: in the world of its estimator; NaN where it does not know
    its place. height_m: NaN where it is not sure. heading_rad: counter-clockwise. thrust: mean over
    the motors of (duty x V)^2, which thrust grows with. age_s: of the place. place_s: when it said
    where it is, by its own clock: a host that is held up hears of it later than of the rest."""

    time_s: float
    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float
    climb_m_s: float
    height_m: float
    heading_rad: float
    roll_deg: float
    pitch_deg: float
    thrust: float
    age_s: float
    place_s: float

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> Self:
        """From the answer to a setpoint."""
        place, said = answer.get("place") or {}, answer["telemetry"]
        duties = [_number(motor) for motor in said["motors"]]
        volts = said["battery_v"]
        volts = volts if volts is not None and math.isfinite(volts) else 1.0
        time_s, place_s = TICK_S * said["timestamp"], place.get("at_s")
        return cls(
            time_s=time_s,
            x_m=_number(place.get("x_m")),
            y_m=_number(place.get("y_m")),
            vx_m_s=_number(place.get("vx_m_s")),
            vy_m_s=_number(place.get("vy_m_s")),
            climb_m_s=_number(place.get("vz_m_s")),
            height_m=_number(place.get("z_m", answer.get("height_m"))),
            heading_rad=math.radians(_number(said["yaw_deg"])),
            roll_deg=_number(said["roll_deg"]),
            pitch_deg=_number(said["pitch_deg"]),
            thrust=sum((duty * volts) ** 2 for duty in duties) / len(duties),
            age_s=_number(place.get("age_s", math.inf)),
            place_s=time_s if place_s is None else float(place_s),
        )

    @property
    def speed_m_s(self) -> float:
        return math.hypot(self.vx_m_s, self.vy_m_s)

    def away_m(self, home: tuple[float, float], ahead_s: float = 0.0) -> float:
        """How far it is from ``home``, or will be where nothing brakes it for ``ahead_s``."""
        return math.hypot(
            self.x_m + ahead_s * self.vx_m_s - home[0], self.y_m + ahead_s * self.vy_m_s - home[1]
        )


def largest(values: Iterable[float | None]) -> float:
    """The largest size; NaN where one is missing."""
    sizes = [abs(_number(value)) for value in values]
    return math.nan if any(map(math.isnan, sizes)) else max(sizes)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


class FlightWatch:
    """Watches one flight of a craft that holds its height.

    home: where it took off, in the estimator's world; None: it does not know its place. floor_m:
    its height there. reach_m: how far it may be asked to fly. begun_s: when it was first asked to
    climb, by its own clock. speed_m_s: the most that it may fly.
    """

    def __init__(
        self,
        home: tuple[float, float] | None,
        floor_m: float,
        reach_m: float,
        begun_s: float,
        speed_m_s: float = SPEED_M_S,
    ) -> None:
        self.hover_thrust = math.inf
        """As ``Seen.thrust``, once it is known."""
        self._home, self._floor_m = home, floor_m
        self._most_m, self._speed_m_s = reach_m + BEYOND_M, speed_m_s
        self._begun_s = begun_s
        self._height_off, self._thrust_high = _Lasts(HEIGHT_OFF_S), _Lasts(THRUST_S)
        self._lifted = False
        self._climbed_m, self._last_s = 0.0, math.nan
        self._climb_m_s = 0.0
        self._aparts: deque[tuple[float, float]] = deque()
        self._unwatched = _Lasts(BLIND_S)

    def reason(self, seen: Seen, asked_m: float) -> str:
        """Why it must land now, or empty. asked_m: the height that it is asked for."""
        now_s = seen.time_s
        if self._home is not None:
            if not seen.age_s <= SILENT_S:
                return f"no position from the craft for {SILENT_S:g} s"
            away_m = seen.away_m(self._home)
            if not away_m <= self._most_m:
                return f"{AWAY}: {away_m:.1f} m from take-off, the limit is {self._most_m:.1f} m"
            if not seen.speed_m_s <= self._speed_m_s:
                return f"{FAST}: {seen.speed_m_s:.1f} m/s, the limit is {self._speed_m_s:.1f} m/s"
        height = f"{seen.height_m:.2f} m high"
        self._lifted |= seen.height_m - self._floor_m >= LIFT_M
        if not self._lifted and now_s - self._begun_s >= LIFT_S:
            return f"{NO_LIFT}: {height} {LIFT_S:g} s after the start"
        is_off = self._lifted and not abs(seen.height_m - asked_m) <= HEIGHT_OFF_M
        if self._height_off.lasts(now_s, is_off):
            return f"height: {height} for {HEIGHT_OFF_S:g} s, {asked_m:.2f} m was requested"
        if self._apart_m(seen) > APART_M:
            return f"{BLIND}: it says {height}, which the climb rate contradicts"
        if self._unwatched.lasts(now_s, self._is_unwatched(seen)):
            return f"height: {height}, and for {BLIND_S:g} s its places came too seldom to check it"
        ratio = seen.thrust / self.hover_thrust
        if self._thrust_high.lasts(now_s, ratio > THRUST_RATIO):
            return f"thrust: {ratio:.1f} times that of hover, the limit is {THRUST_RATIO:g} times"
        return ""

    def _apart_m(self, seen: Seen) -> float:
        """How much height and climb rate have disagreed about in the last ``APART_S``."""
        if math.isnan(seen.climb_m_s):
            return 0.0
        passed_s, self._last_s = seen.place_s - self._last_s, seen.place_s
        kept = self._aparts
        if 0.0 <= passed_s <= GAP_S:
            self._climbed_m += passed_s * 0.5 * (self._climb_m_s + seen.climb_m_s)
        else:
            kept.clear()
        self._climb_m_s = seen.climb_m_s
        kept.append((seen.place_s, seen.height_m - self._climbed_m))
        while seen.place_s - kept[0][0] > APART_S:
            kept.popleft()
        return max(apart for _, apart in kept) - min(apart for _, apart in kept)

    def _is_unwatched(self, seen: Seen) -> bool:
        """Whether height and climb rate are known for less than ``APART_S`` in one piece."""
        if math.isnan(seen.climb_m_s):
            return False
        return self._aparts[-1][0] - self._aparts[0][0] < APART_S - GAP_S


class _Lasts:
    """Whether something has been so without a break for ``seconds``."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._since_s = seconds, math.inf

    def lasts(self, now_s: float, is_so: bool) -> bool:
        self._since_s = min(self._since_s, now_s) if is_so else math.inf
        return now_s - self._since_s >= self._seconds


# A craft that knows its place, stopped and brought back between manoeuvres.
#
# Velocities are what hover setpoints take: ahead and to the left, in the heading's frame.


STANDS_M_S = 0.1
"""Slower than this a craft stands still in the air."""
BACK_M_S, BACK_PER_S, NEAR_M = 0.3, 1.0, 0.15
"""It goes back so fast at most, and slower the nearer it is; so near it is there."""
HOLD_MOST_S = 8.0
"""A craft that has not come back by then stays where it is."""
REST_S = 0.5
AHEAD_S = 0.5
"""A craft brakes from 1 m/s within so much of a second's way."""
TRIM_S, FIRST_REST_S = 1.0, 3.0
"""How long the lean of hover is averaged at most; how long it hovers after take-off, for its
estimator learns in flight how its sensors are turned."""


class Holding:
    """From a craft that moves to one that hovers at its place.

    home: where that is. rest_s: how long it hovers there in the end.
    """

    def __init__(self, home: tuple[float, float], now_s: float, rest_s: float = REST_S) -> None:
        self._home, self._rest_s = home, rest_s
        self._until_s = now_s + HOLD_MOST_S
        self._stopped = self._is_back = False
        self._rests_s = math.inf

    @property
    def rests(self) -> bool:
        """Whether it hovers at its place, as it was asked to last."""
        return math.isfinite(self._rests_s)

    def velocity(self, now_s: float, seen: Seen) -> tuple[float, float] | None:
        """What to ask for now, m/s; None: it hovers at its place."""
        slow, late = seen.speed_m_s < STANDS_M_S, now_s >= self._until_s
        away_m = seen.away_m(self._home)
        self._stopped |= slow
        self._is_back |= late or (self._stopped and away_m < NEAR_M)
        if self._is_back:
            self._rests_s = min(self._rests_s, now_s) if slow or late else math.inf
            return None if now_s - self._rests_s >= self._rest_s else (0.0, 0.0)
        if not self._stopped:
            return 0.0, 0.0
        speed = min(BACK_M_S, BACK_PER_S * away_m) / away_m
        ahead, aside = (self._home[0] - seen.x_m) * speed, (self._home[1] - seen.y_m) * speed
        cos, sin = math.cos(seen.heading_rad), math.sin(seen.heading_rad)
        return cos * ahead + sin * aside, cos * aside - sin * ahead


class Hover:
    """What a craft that hovers shows, over the last ``TRIM_S``: lean and thrust."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, Seen]] = deque()

    def add(self, now_s: float, seen: Seen) -> None:
        self._seen.append((now_s, seen))
        while now_s - self._seen[0][0] > TRIM_S:
            self._seen.popleft()

    @property
    def trim_deg(self) -> tuple[float, float]:
        """Mean roll and pitch: what the craft calls the attitude in which it stays."""
        return self._mean("roll_deg"), self._mean("pitch_deg")

    @property
    def thrust(self) -> float:
        """Mean of ``Seen.thrust``."""
        return self._mean("thrust")

    def _mean(self, name: str) -> float:
        return sum(getattr(seen, name) for _, seen in self._seen) / len(self._seen)


# Whether a craft stands on the floor, before its motors turn.


STAND_S = 3.0
STILL_DPS, LEVEL_DEG = 5.0, 10.0
"""A hand never holds a craft so still; nobody puts one on a steeper floor."""
FLOOR_M = 0.1
"""A craft's own height on the floor is known to some cm."""


class Standing:
    """Watches a craft whose motors stand still; ``trouble``: why it may not take off, or empty."""

    def __init__(self) -> None:
        self.trouble = ""
        self._since_s = math.inf

    def look(self, now_s: float, answer: Mapping[str, Any]) -> bool:
        """Whether it has stood for ``STAND_S``, by this answer and those before it."""
        self.trouble = trouble_of(answer)
        self._since_s = math.inf if self.trouble else min(self._since_s, now_s)
        return now_s - self._since_s >= STAND_S


def trouble_of(answer: Mapping[str, Any]) -> str:
    """Why a craft does not stand still, level, on the floor and ready to fly, or empty. answer: the
    daemon's to a setpoint; a height of None is not known, and any angle that is missing is a
    reason, as telemetry is that may be of another moment."""
    said, height_m = answer["telemetry"], answer.get("height_m")
    if answer.get("hindrance"):
        return str(answer["hindrance"])
    if said is None or not said["age_s"] <= AbortLimits().silent_s:
        return "it says nothing: no telemetry is coming in"
    turns = largest(said["gyro_dps"])
    if not turns <= STILL_DPS:
        return f"it moves ({turns:.0f} deg/s, {STILL_DPS:g} is the most): put it on the floor"
    tilt = largest((said["roll_deg"], said["pitch_deg"]))
    if not tilt <= LEVEL_DEG:
        return f"it is tilted by {tilt:.0f} deg, {LEVEL_DEG:g} is the most: put it on level floor"
    if height_m is not None and not abs(height_m) <= FLOOR_M:
        return (
            f"it is {height_m:.2f} m above the floor: put it down; where a positioning system tells"
            " its height, set the origin on the floor"
        )
    return ""


# What ``pid fly`` commands: steps or doublets, one axis after the other, 100 times a second.
#
# A craft that knows its place is stopped and brought back after each of them (``holding``).
#
# Signs are those of the telemetry: roll left side up, pitch nose down, yaw rate counter-clockwise.


Shape = Literal["doublet", "step", "level"]
SHAPES: tuple[Shape, ...] = ("doublet", "step", "level")

RATE_HZ = 100
BEGINS, LANDS = "pid fly programme", "pid fly landing"
"""Marks in a recording: between them the programme was flown."""
MANOEUVRE, HOLDS = "pid fly manoeuvre", "pid fly holds"
"""Marks before and after each manoeuvre of a craft that holds its height. ``trim_deg`` of the
first: roll and pitch that are added to each of its setpoints, the lean of hover."""
SETTLE_S = 2.0
"""Level flight before the first manoeuvre and after the last: the hover settles, the pilot too."""
ANGLE_MOST_DEG, YAW_MOST_DPS = 25.0, 200.0
GRAVITY = 9.81
HELD_S = 3.0
"""To stop and come back after a manoeuvre, on average of the software craft's flights."""
SPARE_M, SPARE = 0.1, 1.25
"""What a craft is late by and trimmed wrongly: in its way, and as a share of its speed."""


@dataclass(frozen=True, slots=True)
class Programme:
    """shape: ``doublet`` (there, across, back), ``step`` (there and back) or ``level`` (hover,
    or manual flight). hold_s, rest_s: of each level, and between manoeuvres. repeats: an axis;
    the sign alternates, so that the craft comes back."""

    shape: Shape = "doublet"
    axes: tuple[str, ...] = AXES
    angle_deg: float = 10.0
    yaw_dps: float = 60.0
    hold_s: float = 0.7
    rest_s: float = 1.0
    repeats: int = 4

    def parts(self) -> list[tuple[str, Array]]:
        """Each manoeuvre: its name, and roll (deg), pitch (deg), yaw rate (deg/s) of every 10 ms,
        (k, 3)."""
        levels = {"doublet": (1.0, -1.0), "step": (1.0,), "level": ()}[self.shape]
        found = []
        for axis in self.axes if levels else ():
            index = AXES.index(axis)
            size = self.yaw_dps if axis == "yaw" else self.angle_deg
            for repeat in range(self.repeats):
                sign = 1.0 if repeat % 2 == 0 else -1.0
                table = np.zeros((round(self.hold_s * RATE_HZ) * len(levels), 3))
                table[:, index] = sign * size * np.repeat(levels, len(table) // len(levels))
                found.append((f"{axis} {self.shape}", table))
        return found

    def setpoints(self) -> Array:
        """The whole programme of a craft whose place nothing holds, every 10 ms, (k, 3)."""
        settle, rest = (np.zeros((round(s * RATE_HZ), 3)) for s in (SETTLE_S, self.rest_s))
        if self.shape == "level":
            flown = [rest] * (len(self.axes) * self.repeats)
        else:
            flown = [t for _, table in self.parts() for t in (table, rest)]
        return np.vstack([settle, *flown, settle])

    @property
    def seconds(self) -> float:
        """Of a craft whose place nothing holds."""
        return len(self.setpoints()) / RATE_HZ

    @property
    def held_seconds(self) -> float:
        """Of a craft that holds its place, about."""
        return len(self.setpoints()) / RATE_HZ + HELD_S * len(self.parts())

    @property
    def reach_m(self) -> float:
        """How far a manoeuvre carries the craft, if nothing slows it down."""
        return max((carried_m(table) for _, table in self.parts()), default=0.0)

    @property
    def held_reach_m(self) -> float:
        """How far a craft goes that holds its place: a manoeuvre that would carry it further than
        it can brake is interrupted there."""
        brakes = (carried_m(table, AHEAD_S) for _, table in self.parts())
        return max(brakes, default=0.0) + NEAR_M + SPARE_M

    @property
    def speed_most_m_s(self) -> float:
        """Above this the craft does not fly its programme any more."""
        speeds = (carried_speed_m_s(table) for _, table in self.parts())
        return max(SPEED_M_S, SPARE * max(speeds, default=0.0))

    def as_dict(self) -> dict[str, Any]:
        """For the mark in the recording."""
        return {name: getattr(self, name) for name in self.__slots__}


STILL_SHARE = 0.1
"""Of its fastest, what counts as standing still in a manoeuvre."""


def carried_m(table: Array, ahead_s: float = 0.0) -> float:
    """How far leans carry a craft that nothing slows down from where it was, at most, until the end
    of a second of level flight that follows; with the way of ``ahead_s`` more at its speed.

    table: roll, pitch (deg), yaw rate (deg/s) of every 10 ms, (k, 3) or more columns.
    """
    moved, velocity = _carried(np.vstack([table[:, :3], np.zeros((RATE_HZ, 3))]))
    return float(np.abs(moved + ahead_s * velocity).max())


def carried_speed_m_s(table: Array) -> float:
    """How fast it is then, at most."""
    return float(np.abs(_carried(table)[1]).max())


def stands_again(table: Array, row: int) -> int:
    """The first row from ``row`` on in which a craft that flies a table stands still, or nearly so:
    where one that rests can begin without being carried off by the rest of it; k where none is."""
    speed = np.abs(_carried(table)[1])
    still = np.flatnonzero(speed[row:] <= STILL_SHARE * max(speed.max(), 1e-9))
    return row + int(still[0]) if len(still) else len(table)


def heading_rad(yaw_dps: Array) -> Array:
    """Of every row of a table, from its begin."""
    return np.radians(np.cumsum(yaw_dps)) / RATE_HZ


def _carried(table: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Way (m) and velocity (m/s) ahead + 1j left, of every row."""
    roll, pitch, yaw = table[:, :3].T
    pushed = np.tan(np.radians(pitch)) - 1j * np.tan(np.radians(roll))
    pushed = GRAVITY * pushed * np.exp(1j * heading_rad(yaw))
    velocity = np.cumsum(pushed, dtype=np.complex128) / RATE_HZ
    return np.cumsum(velocity, dtype=np.complex128) / RATE_HZ, velocity


def require_flyable(programme: Programme) -> None:
    """Raises BadInputError for what should not be flown, saying what may be."""
    limits = (
        ("--amplitude", programme.angle_deg, 1.0, ANGLE_MOST_DEG, "deg"),
        ("--yaw-rate", programme.yaw_dps, 5.0, YAW_MOST_DPS, "deg/s"),
        ("--hold", programme.hold_s, 0.2, 3.0, "s"),
        ("--rest", programme.rest_s, 0.2, 10.0, "s"),
        ("--repeat", programme.repeats, 1, 50, "times"),
    )
    _require_within(limits)
    if programme.shape not in SHAPES:
        raise BadInputError(f"--programme {programme.shape}: there are {', '.join(SHAPES)}")
    for axis in programme.axes:
        if axis not in AXES:
            raise BadInputError(f"--axis {axis}: there are {', '.join(AXES)}")


def _require_within(limits: Iterable[tuple[str, float, float, float, str]]) -> None:
    """limits: option, its value, the least, the most, unit."""
    for name, value, low, high, unit in limits:
        if not low <= value <= high:
            raise BadInputError(f"{name} {value:g}: must be {low:g}..{high:g} {unit}")


@dataclass(frozen=True, slots=True)
class AbortLimits:
    """Beyond any of these a flight ends: in a landing where the craft can still land
    (``flying.fly_by_height``), or its motors are stopped.

    tilt_deg, rate_dps: of the telemetry. battery_v, battery_s: under load, and how long it must
    stay below without a break. silent_s: age of the newest telemetry.
    """

    tilt_deg: float = 50.0
    rate_dps: float = 800.0
    battery_v: float = 3.0
    battery_s: float = 2.0
    silent_s: float = 1.0


LOW_BATTERY = "battery below"
"""How the reason begins for which a flight ends in a landing."""
TILTED, TURNED, BY_HAND = "tilt of", "rate of", "stopped by hand"
"""How other reasons begin: those of a craft that its gains do not hold, or that somebody saw."""
LANDING = AbortLimits(tilt_deg=180.0, rate_dps=2100.0)
"""Meeting the ground turns a craft faster than any flight; only what blinds is a reason then."""


class LowBattery:
    """How long the battery has been low, of one flight.

    Starting rotors draw their stall current for milliseconds, and a cell sags under it: one low
    reading says nothing of the charge. The firmware waits for 5 s below 3.0 V before it shuts
    down (pm.c); ``AbortLimits.battery_s`` ends before that.
    """

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._least_v = math.inf

    def reason(self, read_ns: int, battery_v: float, limits: AbortLimits) -> str:
        """Why the flight must end, or empty. read_ns: when battery_v was received: an old reading
        that is seen again makes no time pass."""
        if battery_v >= limits.battery_v:
            self._since_ns = None
            return ""
        if self._since_ns is None:
            self._since_ns, self._least_v = read_ns, battery_v
        self._least_v = min(self._least_v, battery_v)
        low_s = (read_ns - self._since_ns) * 1e-9
        if low_s < limits.battery_s:
            return ""
        return (
            f"{LOW_BATTERY} {limits.battery_v:g} V for {low_s:.1f} s, now {battery_v:.2f} V,"
            f" {self._least_v:.2f} V at the least: charge it, or fly with a newer one"
        )


def reason_to_abort(
    answer: Mapping[str, Any], low: LowBattery | None, limits: AbortLimits = AbortLimits()
) -> str:
    """Why a flight must end now, from the daemon's answer to a setpoint; empty while all is well.

    low: of this flight; None: of a craft that never tells its battery. Any other value that is
    missing or no number is a reason: nothing is known then.
    """
    telemetry = answer.get("telemetry")
    if answer.get("link_state") not in ("streaming", "silent") or telemetry is None:
        return f"telemetry lost (link {answer.get('link_state')})"
    age = telemetry["age_s"]
    if not age <= limits.silent_s:
        return f"no telemetry for {age:.2f} s"
    if answer.get("hindrance"):
        return str(answer["hindrance"])
    tilt = largest((telemetry["roll_deg"], telemetry["pitch_deg"]))
    if not tilt <= limits.tilt_deg:
        return f"{TILTED} {tilt:.0f} deg, {limits.tilt_deg:g} is the most"
    rate = largest(telemetry["gyro_dps"])
    if not rate <= limits.rate_dps:
        return f"{TURNED} {rate:.0f} deg/s, {limits.rate_dps:g} is the most"
    if low is None:
        return ""
    battery = telemetry["battery_v"]
    if battery is None or math.isnan(battery):
        return "the battery's voltage is not known"
    return low.reason(answer["time_ns"] - round(1e9 * age), battery, limits)


# What ``bench motor`` commands: thrust up and down, 100 times a second (thesis 7.2.1).
#
# The craft is fixed to the bench, so roll, pitch and yaw rate stay zero.


ThrustShape = Literal["steps", "staircase", "chirp"]
THRUST_SHAPES: tuple[ThrustShape, ...] = ("steps", "staircase", "chirp")
LEAST, MOST = 0.16, 0.9
"""Share of full thrust: below, the firmware of 2014 takes it for none; above, it clips at 0.915."""
RAMP_S = 1.0
STAIRS = 8
CHIRP_HZ = (0.1, 5.0)

FIXED = AbortLimits(tilt_deg=180.0, rate_dps=300.0)
"""A fixed craft hardly turns, whatever its angle; its sensor feels the motors shake."""
TILT_CHANGE_DEG = 20.0
"""The reported angles of a fixed craft wander by less."""


@dataclass(frozen=True, slots=True)
class ThrustProfile:
    """shape: ``steps`` (a new level between low and high every hold_s, at random), ``staircase``
    (eight levels up and down again, hold_s each) or ``chirp`` (a sine of 0.1 to 5 Hz). low, high:
    shares of full thrust. seconds: between the ramps up and down of 1 s each."""

    shape: ThrustShape = "steps"
    low: float = 0.3
    high: float = 0.8
    hold_s: float = 0.4
    seconds: float = 40.0
    seed: int = 0

    def thrusts(self) -> NDArray[np.int64]:
        """16-bit thrust of every 10 ms, (k,); begins and ends with motors off."""
        time = np.arange(round(self.seconds * RATE_HZ)) / RATE_HZ
        if self.shape == "chirp":
            slow, fast = CHIRP_HZ
            turns = slow * time + (fast - slow) * time**2 / (2.0 * self.seconds)
            share = -np.cos(2.0 * math.pi * turns)
        else:
            number = (time / self.hold_s + 1e-9).astype(int)
            share = self._levels(int(number[-1]) + 1)[number]
        levels = self.low + (self.high - self.low) * (share + 1.0) / 2.0
        rise = np.linspace(0.0, 1.0, round(RAMP_S * RATE_HZ), endpoint=False)
        whole = np.concatenate([levels[0] * rise, levels, levels[-1] * rise[::-1], [0.0]])
        return np.rint(FULL_16_BIT * whole).astype(np.int64)

    def _levels(self, count: int) -> NDArray[np.float64]:
        """Levels in turn, -1 to 1."""
        if self.shape == "steps":
            return np.random.default_rng(self.seed).uniform(-1.0, 1.0, count)
        up = np.linspace(-1.0, 1.0, STAIRS)
        return np.resize(np.concatenate([up, up[-2:0:-1]]), count)

    def as_dict(self) -> dict[str, Any]:
        """For the mark in the recording."""
        return {name: getattr(self, name) for name in self.__slots__}


def require_drivable(profile: ThrustProfile) -> None:
    """Raises BadInputError for what no motor should be driven with, saying what may be."""
    if profile.shape not in THRUST_SHAPES:
        raise BadInputError(f"--profile {profile.shape}: there are {', '.join(THRUST_SHAPES)}")
    limits = (
        ("--low", profile.low, LEAST, MOST, "of full thrust"),
        ("--high", profile.high, LEAST, MOST, "of full thrust"),
        ("--hold", profile.hold_s, 0.1, 10.0, "s"),
        ("--seconds", profile.seconds, 4.0, 180.0, "s"),
    )
    _require_within(limits)
    if not profile.high - profile.low >= 0.1:
        raise BadInputError(
            f"--low {profile.low:g}, --high {profile.high:g}: 0.1 apart at least, or the motor"
            " shows nothing"
        )


def reason_to_stop(answer: Mapping[str, Any], at_rest: Mapping[str, Any], low: LowBattery) -> str:
    """Why the motors must stop now, from the daemon's answer to a setpoint; empty while all is
    well. at_rest: the telemetry before the motors turned. low: of this run."""
    reason = reason_to_abort(answer, low, FIXED)
    if reason:
        return f"{reason}: is the craft loose?" if reason.startswith("rate") else reason
    now = answer["telemetry"]
    tilted = max(abs(now[name] - at_rest[name]) for name in ("roll_deg", "pitch_deg"))
    if not tilted <= TILT_CHANGE_DEG:
        return f"tilted by {tilted:.0f} deg since the start: is the craft loose?"
    return ""
