"""What ``pid fly`` commands: steps or doublets, one axis after the other, 100 times a second.

A craft that knows its place is stopped and brought back after each of them (``holding``).

Signs are those of the telemetry: roll left side up, pitch nose down, yaw rate counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.control.flight_watch import SPEED_M_S, largest
from groundstation.control.holding import AHEAD_S, NEAR_M
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array

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
            rests = [rest] * (len(self.axes) * self.repeats)
            return np.vstack([settle, *rests, settle])
        return np.vstack([settle, *(t for _, table in self.parts() for t in (table, rest)), settle])

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
    for name, value, low, high, unit in limits:
        if not low <= value <= high:
            raise BadInputError(f"{name} {value:g}: must be {low:g}..{high:g} {unit}")
    if programme.shape not in SHAPES:
        raise BadInputError(f"--programme {programme.shape}: there are {', '.join(SHAPES)}")
    for axis in programme.axes:
        if axis not in AXES:
            raise BadInputError(f"--axis {axis}: there are {', '.join(AXES)}")


@dataclass(frozen=True, slots=True)
class AbortLimits:
    """Beyond any of these the motors are stopped.

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
