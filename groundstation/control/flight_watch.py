"""What a craft says of itself in flight, and when it must land.

Pure: the numbers of the daemon's answer to a setpoint, and the time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from groundstation.telemetry.packet import TICK_S

BEYOND_M = 0.5
"""Beyond its reach: a craft that brakes from 1.5 m/s needs so much."""
SPEED_M_S = 1.5
"""No manoeuvre of ``learn`` reaches 1.0 m/s."""
HEIGHT_OFF_M, HEIGHT_OFF_S = 0.3, 1.0
"""The largest step of height is 0.4 m, and a craft makes it within 0.6 s."""
THRUST_RATIO, THRUST_S = 1.5, 0.5
"""Of the thrust that hovers: a step of height asks for more for 0.2 s, a height that stands still
for ever."""
APART_M, APART_S, GAP_S = 0.15, 1.0, 0.2
"""A height that has changed in so long by so much more or less than the climb rate says is not that
of the craft: its sensor sticks. The two agree within 0.02 m in flight; not across a gap."""
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
    the motors of (duty x V)^2, which thrust grows with. age_s: of the place."""

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

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> Self:
        """From the answer to a setpoint."""
        place, said = answer.get("place") or {}, answer["telemetry"]
        duties = [_number(motor) for motor in said["motors"]]
        volts = said["battery_v"]
        volts = volts if volts is not None and math.isfinite(volts) else 1.0
        return cls(
            time_s=TICK_S * said["timestamp"],
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
        self._climbed_m, self._last_s = 0.0, begun_s
        self._aparts: deque[tuple[float, float]] = deque()

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
        ratio = seen.thrust / self.hover_thrust
        if self._thrust_high.lasts(now_s, ratio > THRUST_RATIO):
            return f"thrust: {ratio:.1f} times that of hover, the limit is {THRUST_RATIO:g} times"
        return ""

    def _apart_m(self, seen: Seen) -> float:
        """How much height and climb rate have disagreed about in the last ``APART_S``."""
        if math.isnan(seen.climb_m_s):
            return 0.0
        passed_s, self._last_s = seen.time_s - self._last_s, seen.time_s
        kept = self._aparts
        if not 0.0 <= passed_s <= GAP_S:
            kept.clear()
        self._climbed_m += passed_s * seen.climb_m_s
        kept.append((seen.time_s, seen.height_m - self._climbed_m))
        while seen.time_s - kept[0][0] > APART_S:
            kept.popleft()
        return max(apart for _, apart in kept) - min(apart for _, apart in kept)


class _Lasts:
    """Whether something has been so without a break for ``seconds``."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._since_s = seconds, math.inf

    def lasts(self, now_s: float, is_so: bool) -> bool:
        self._since_s = min(self._since_s, now_s) if is_so else math.inf
        return now_s - self._since_s >= self._seconds
