"""A programme flown by a craft that holds its height: up, each manoeuvre, back to its place, down.

A craft that knows its place as well is stopped and brought back by hover setpoints, and watched:
attitude setpoints alone carry any craft away.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from groundstation import GroundStationError, Pilot
from groundstation.cli.commanding import why_aborted
from groundstation.cli.interrupts import Interrupts
from groundstation.cli.motors_off import MOTORS_OFF, NOT_TURNING, Ended, stop_now
from groundstation.cli.setpoint_clock import Clock, SetpointClock
from groundstation.cli.terminal import say
from groundstation.control.programme import (
    AHEAD_S,
    AWAY,
    BEGINS,
    BLIND,
    FIRST_REST_S,
    HOLDS,
    LANDS,
    MANOEUVRE,
    RATE_HZ,
    TILTED,
    TURNED,
    FlightWatch,
    Holding,
    Hover,
    LowBattery,
    Seen,
    reason_to_abort,
    stands_again,
)
from groundstation.links.command import RESETS_ESTIMATOR

if TYPE_CHECKING:
    from groundstation.links.software_craft import SoftwareCraft

CLIMB_M_S = 0.4
LEVEL_TICKS = 50
"""Of level attitude before each manoeuvre: the firmware clears its loops when it is asked for an
attitude in the place of a velocity, and they sum up anew what trims the craft."""
RESET_S = 1.0
"""How long the estimator, begun anew, needs to know where it stands. On the ground a Flow deck sees
nothing, and the estimated speed of the real firmware runs away: by 3 m/s in half a minute."""
SETTLED_S = 2.0
"""Level flight of a craft that does not know its place, before the first manoeuvre."""
TURNS_S = 1.0
"""Motors that stand so long after a height was asked for do not turn at all."""
BROUGHT_BACK_MOST = 2
"""How often a manoeuvre may be interrupted because it carries the craft too far, on average over a
flight: a craft that is well is carried off by a few of them."""
LANDED = "landed"
"""What the daemon says of a landing that came to its end."""
TOO_OLD = "too old to be sent"
"""How the daemon ends what it says of a setpoint that reached it late."""
UNRECORDED = "recording"
"""How the reason begins for which a flight that is no more recorded lands."""


class Flyable(Protocol):
    """What is flown. parts: name and table of each manoeuvre, of every 10 ms roll (deg), pitch
    (deg), yaw rate (deg/s) and, where there is a fourth column, metres above the height that is
    held, (k, 3) or (k, 4). rest_s: between them. speed_most_m_s: that the craft may fly."""

    @property
    def rest_s(self) -> float: ...

    @property
    def speed_most_m_s(self) -> float: ...

    def parts(self) -> list[tuple[str, Any]]: ...


@dataclass(frozen=True, slots=True)
class Room:
    """height_m: to fly at, above floor_m, which is the craft's own where it stands. reach_m: how
    far it may go from where it takes off."""

    height_m: float
    floor_m: float
    reach_m: float

    @property
    def top_m(self) -> float:
        return self.floor_m + self.height_m


class _OverError(Exception):
    """The flight must end now. lands: the craft can still land."""

    def __init__(self, why: str, *, lands: bool) -> None:
        super().__init__(why)
        self.why, self.lands = why, lands


def fly_by_height(
    pilot: Pilot | SoftwareCraft,
    programme: Flyable,
    room: Room,
    signals: Interrupts,
    *,
    tells_battery: bool,
    clock: Clock | None = None,
) -> Ended:
    """Fly a programme and land, whatever ends it, as long as the craft can. tells_battery: whether
    the craft says how its battery is. clock: the craft's, None: real time."""
    why, lands = "", True
    interrupted: KeyboardInterrupt | None = None
    try:
        with signals.heard():
            _Flight(pilot, room, clock or SetpointClock(), tells_battery).fly(programme)
    except _OverError as over:
        why, lands = over.why, over.lands
        say(f"{why}: {'landing' if lands else 'stopping the motors'}", error=True)
        if lands:
            with contextlib.suppress(GroundStationError):
                pilot.mark(LANDS, why=why)
    except KeyboardInterrupt as stop:
        why, interrupted = str(stop), stop
        say(f"{why}: landing; Ctrl-C again stops the motors", error=True)
    except GroundStationError as error:  # the daemon has ended it: it says how
        why = why_aborted(error)
    motors = land(pilot, signals) if lands else stop_now(pilot, signals)
    return Ended(why, motors, interrupted)


def land(pilot: Pilot | SoftwareCraft, signals: Interrupts) -> str:
    """Let the craft be landed; what is known of its motors then. The second Ctrl-C stops them."""
    try:
        spare = 0 if signals.came else 1
        with signals.heard(spare, "landing; Ctrl-C again stops the motors"):
            if pilot.land() == LANDED:
                return f"{LANDED}, {MOTORS_OFF}"
    except KeyboardInterrupt:
        say("stopping the motors", error=True)
    except GroundStationError:
        pass  # the lease may be over: what became of its motors is told all the same
    return stop_now(pilot, signals)


class _Flight:
    """One flight, from the ground to where it may land. Raises _OverError."""

    def __init__(
        self, pilot: Pilot | SoftwareCraft, room: Room, clock: Clock, tells_battery: bool
    ) -> None:
        self._pilot, self._room, self._clock = pilot, room, clock
        self._low = LowBattery() if tells_battery else None
        self._places = bool(pilot.lease["holds_place"])
        self._home = (0.0, 0.0)
        self._trim = (0.0, 0.0)
        self._brought_back, self._brought_back_most = 0, BROUGHT_BACK_MOST

    def fly(self, programme: Flyable) -> None:
        self._rest_s = programme.rest_s
        self._begin(programme.speed_most_m_s)
        self._take_off()
        self._mark(BEGINS)
        parts = programme.parts()
        self._brought_back_most = BROUGHT_BACK_MOST * len(parts)
        for name, table in parts:
            self._begin_manoeuvre(name)
            self._manoeuvre(name, [[0.0] * 3] * LEVEL_TICKS + table.tolist())
            self._mark(HOLDS, name=name)
            self._hold()
        if not parts:
            self._hold()
        self._mark(LANDS)

    def _begin_manoeuvre(self, name: str) -> None:
        self._mark(MANOEUVRE, name=name, trim_deg=list(self._trim))

    def _manoeuvre(self, name: str, rows: list[list[float]]) -> None:
        """Fly a table by the clock. A program that is held up leaves rows out: a lean that lasts
        longer carries the craft further."""
        row, begun_s = 0, self._clock.now_s()
        while row < len(rows):
            if self._goes_too_far():
                self._brought_back += 1
                if self._brought_back > self._brought_back_most:
                    count = f"{self._brought_back} times in this flight"
                    raise _OverError(f"{AWAY}: manoeuvres carried it off {count}", lands=True)
                row = stands_again(np.array([one[:3] for one in rows]), row)
                if row == len(rows):
                    break
                self._bring_back(name)
                begun_s = self._clock.now_s() - row / RATE_HZ
            roll, pitch, yaw, *above = rows[row]
            self._tick(
                self._room.top_m + sum(above),
                (roll + self._trim[0], pitch + self._trim[1], yaw),
            )
            row = max(row, round((self._clock.now_s() - begun_s) * RATE_HZ))

    def _begin(self, speed_most_m_s: float) -> None:
        """On the ground: where it is, by an estimator that begins anew."""
        if self._places and RESETS_ESTIMATOR in self._pilot.parameters():
            self._pilot.write({RESETS_ESTIMATOR: 1.0})
            end_s = self._clock.now_s() + RESET_S
            while self._clock.now_s() < end_s:
                self._look()
                self._clock.wait()
        self._look()
        self._begun_s = self._clock.now_s()
        if self._places:
            self._home = self._seen.x_m, self._seen.y_m
        self._watch = FlightWatch(
            self._home if self._places else None,
            self._room.floor_m,
            self._room.reach_m,
            self._seen.time_s,
            speed_most_m_s,
        )

    def _look(self) -> None:
        """See how the craft stands, its motors off."""
        answer = self._pilot.setpoint(0.0, 0.0, 0.0, 0)
        reason = reason_to_abort(answer, self._low)
        if reason:
            raise _OverError(reason, lands=False)
        self._seen = Seen.of(answer)

    def _take_off(self) -> None:
        """Climb, then hover until it is known what its hover is."""
        room, hover = self._room, Hover()
        climbs_s = room.height_m / CLIMB_M_S
        while (time_s := self._clock.now_s() - self._begun_s) < climbs_s:
            self._tick(room.floor_m + CLIMB_M_S * time_s)
            if time_s > TURNS_S and not self._turns:
                raise _OverError(NOT_TURNING, lands=False)
        hover = self._hold(FIRST_REST_S if self._places else SETTLED_S)
        self._watch.hover_thrust = hover.thrust
        if self._places:
            self._trim = hover.trim_deg

    def _hold(self, rest_s: float | None = None) -> Hover:
        """Stop, go back to the place of take-off and rest there; without a place rest alone. How it
        hovered while it rested."""
        rest_s = self._rest_s if rest_s is None else rest_s
        begun_s, hover = self._clock.now_s(), Hover()
        holding = Holding(self._home, begun_s, rest_s)
        while True:
            now_s = self._clock.now_s()
            velocity: tuple[float, float] | None = (0.0, 0.0)
            if self._places:
                velocity = holding.velocity(now_s, self._seen)
            if holding.rests or not self._places:
                hover.add(now_s, self._seen)
            if velocity is None or (not self._places and now_s - begun_s >= rest_s):
                break
            self._tick(self._room.top_m, velocity=velocity)
        return hover

    def _goes_too_far(self) -> bool:
        ahead_m = self._seen.away_m(self._home, AHEAD_S)
        return self._places and not ahead_m <= self._room.reach_m

    def _bring_back(self, name: str) -> None:
        """A manoeuvre that was interrupted goes on, where it begins anew from rest."""
        self._mark(HOLDS, name=name)
        self._hold()
        self._begin_manoeuvre(name)

    def _tick(
        self,
        height_m: float,
        attitude: tuple[float, float, float] | None = None,
        velocity: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """One setpoint: roll, pitch (deg) and yaw rate (deg/s), or a velocity (m/s) of a craft that
        takes one, which is level otherwise."""
        roll, pitch, yaw = attitude or (0.0, 0.0, 0.0)
        moves = attitude is None and self._places
        try:
            answer = self._pilot.setpoint(
                roll,
                pitch,
                yaw,
                0,
                height_m=max(height_m, 0.0),
                vx_m_s=velocity[0] if moves else None,
                vy_m_s=velocity[1] if moves else None,
            )
        except GroundStationError as error:
            if not str(error).endswith(TOO_OLD):
                raise
            return  # this computer was held up: the next one is new
        reason = reason_to_abort(answer, self._low)
        if reason:
            # the daemon lands it, or stops its motors where it does not hear it either
            flies = not (reason.startswith((TILTED, TURNED)) or answer.get("hindrance"))
            raise _OverError(reason, lands=flies)
        self._turns = any(answer["telemetry"]["motors"])
        self._seen = Seen.of(answer)
        reason = self._watch.reason(self._seen, height_m)
        if reason:
            raise _OverError(reason, lands=not reason.startswith(BLIND))
        self._clock.wait()

    def _mark(self, text: str, **details: Any) -> None:
        """A flight that is no more recorded lands."""
        try:
            self._pilot.mark(text, **details)
        except GroundStationError as error:
            raise _OverError(f"{UNRECORDED}: {error}", lands=True) from error
