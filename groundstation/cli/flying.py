"""A craft flown from the command line: from consent to motors that stand."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
import typer

from groundstation import BadInputError, GroundStationError, Pilot, socket_path
from groundstation.cli.terminal import require_yes, say
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
    STAND_S,
    TILTED,
    TURNED,
    AbortLimits,
    FlightWatch,
    Holding,
    Hover,
    LowBattery,
    Seen,
    Standing,
    reason_to_abort,
    stands_again,
    trouble_of,
)
from groundstation.links.command import NOT_ARMED, RESETS_ESTIMATOR
from groundstation.service.client import ask
from groundstation.service.lease import BY_OPERATOR, LANDED_BY_OPERATOR, STILL_TURN, STOPPED

if TYPE_CHECKING:
    from groundstation.learn.planning import Craft
    from groundstation.links.software_craft import SoftwareCraft

# Ctrl-C and SIGTERM of a program that has a craft in the air.


class Interrupts:
    """Raise KeyboardInterrupt inside ``heard`` alone: what comes between two of its blocks is
    raised at the beginning of the next one, so that nothing skips a landing. Whoever leaves asks
    ``last``, for nobody else tells of one that came behind the last block or was answered.

    raised: whether one of them was raised. last: the last that came."""

    def __init__(self) -> None:
        self.raised = False
        self.last: KeyboardInterrupt | None = None
        self._pending = ""
        self._listens = False
        self._spare, self._told = 0, ""
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextlib.contextmanager
    def heard(self, spare: int = 0, told: str = "") -> Iterator[None]:
        """Within this an interrupt raises KeyboardInterrupt, after ``spare`` of them that are only
        answered with ``told``."""
        self._spare, self._told, self._listens = spare, told, True
        try:
            if self._pending:
                self._meet(self._pending)
            yield
        finally:
            self._listens = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        self.last = KeyboardInterrupt(name)
        if self._listens:
            self._meet(name)
        else:
            self._pending = name

    def _meet(self, name: str) -> None:
        self._pending = ""
        if self._spare > 0:
            self._spare -= 1
            say(self._told, error=True)
            return
        self._listens, self.raised = False, True
        raise KeyboardInterrupt(name)


# Around everything that turns motors: connection, telemetry, recording, an end that holds.


LEAST_REST_V = 3.5
"""Battery at rest below which nothing begins."""
NO_BATTERY = "the craft does not tell its battery's voltage"
ACQUIRE = "; acquire a lease"
"""How the daemon ends what it says to a client whose lease is over."""
KEEP_S = 0.4
"""The least lease is 1 s."""
CONNECT_S, TELEMETRY_S = 20.0, 5.0
"""How long a daemon that has just started is waited for."""
LOOK_S, STAND_MORE_S = 0.05, 0.5
"""How often a craft on the ground is looked at, and how long a single jolt may delay it."""


def await_connection(path: Path) -> None:
    """A daemon that has just started connects within seconds, and what an interrupted flight left
    written is put back as soon; a refusal is a refusal."""
    deadline = time.monotonic() + CONNECT_S
    while time.monotonic() < deadline:
        status = ask(path, "GET", "/status")
        command = status.get("command")
        waits = command is not None and (
            command["state"] in ("connecting", "closed") or command["unproven"]
        )
        if not waits:
            return
        if status["link"]["name"].startswith("replay:"):
            return  # it never will
        time.sleep(0.2)


def require_ready(
    pilot: Pilot, *, needs_battery: bool, may_be_disarmed: bool = False
) -> dict[str, Any]:
    """The telemetry of a craft that may begin; nothing starts its motors. needs_battery: whether a
    craft that does not tell its voltage, as software builds of the firmware, may not.
    may_be_disarmed: arming is waited for later; a Brushless disarms itself after each flight.

    Raises GroundStationError where none comes in, the battery is low or the craft says that it
    cannot fly.
    """
    deadline = time.monotonic() + TELEMETRY_S
    while True:
        # zero thrust: looks at the telemetry without turning a motor
        answer = pilot.setpoint(0.0, 0.0, 0.0, 0)
        telemetry = answer["telemetry"]
        fresh = telemetry is not None and telemetry["age_s"] <= AbortLimits().silent_s
        if fresh and answer["link_state"] == "streaming":
            break
        if time.monotonic() < deadline:
            time.sleep(0.1)
            continue
        raise GroundStationError(
            f"no telemetry is coming in (link {answer['link_state']}); nothing was flown"
        )
    if answer["hindrance"] and not (may_be_disarmed and answer["hindrance"] == NOT_ARMED):
        raise GroundStationError(f"{answer['hindrance']}; nothing was flown")
    battery = telemetry["battery_v"]
    if battery is None:
        if needs_battery:
            raise GroundStationError(f"{NO_BATTERY}, and nothing is known of its motors without it")
        say(f"{NO_BATTERY}: nothing will end the flight when it is low", error=True)
    elif battery < LEAST_REST_V:
        raise GroundStationError(
            f"battery at {battery} V, {LEAST_REST_V} V at rest is the least; charge it"
        )
    return dict(telemetry)


def require_height(pilot: Pilot, what: str = "") -> None:
    """Raises BadInputError for a craft that does not hold a height that it is told. what: asks for
    that, as the sentence's beginning."""
    if not pilot.lease["holds_height"]:
        raise BadInputError(
            f"{what}{pilot.lease['uri']} holds no height by itself; it needs today's firmware and a"
            " Flow or Z-ranger deck, or a positioning system that has told it where it is"
        )


def require_place(pilot: Pilot) -> None:
    """Raises BadInputError for a craft that does not know its velocity over ground."""
    if not pilot.lease["holds_place"]:
        raise BadInputError(
            f"{pilot.lease['uri']} does not know its velocity over ground, so nothing would keep it"
            " in its place; it needs a Flow deck, or a positioning system that has told it where"
            " it is"
        )


@contextlib.contextmanager
def kept(pilot: Pilot) -> Iterator[None]:
    """The lease lasts while a human thinks. Nothing else may use the pilot meanwhile."""
    answered = threading.Event()

    def keep() -> None:
        # a lease that is lost shows at the next command
        with contextlib.suppress(GroundStationError):
            while not answered.wait(KEEP_S):
                pilot.keep()

    keeper = threading.Thread(target=keep, daemon=True)
    keeper.start()
    try:
        yield
    finally:
        answered.set()
        keeper.join()


def require_consent(pilot: Pilot, question: str, otherwise: str) -> None:
    """Ask the human. Raises BadInputError, saying ``otherwise``, for a no."""
    with kept(pilot):
        require_yes(question, otherwise)


def why_aborted(error: GroundStationError) -> str:
    """What a flight that ended so is told to have been cut short by."""
    return str(error).removesuffix(ACQUIRE)


def require_standing(pilot: Pilot) -> None:
    """Watch a craft for some seconds. Raises GroundStationError where it does not stand still,
    level and, where it knows its height, on the floor."""
    standing = Standing()
    deadline = time.monotonic() + STAND_S + STAND_MORE_S
    while not standing.look(time.monotonic(), pilot.setpoint(0.0, 0.0, 0.0, 0)):
        if time.monotonic() > deadline:
            why = standing.trouble or "it has moved"
            raise GroundStationError(f"the craft does not stand: {why}; nothing was flown")
        time.sleep(LOOK_S)


def begin_recording() -> dict[str, Any]:
    """A recording of this flight alone."""
    path = socket_path()
    running = ask(path, "GET", "/status")["recording"]
    was_on = running["file"] is not None and running.get("state") not in ("off", "finished")
    if was_on:
        ask(path, "POST", "/record/stop")
    return {"was_on": was_on, **ask(path, "POST", "/record/start")}


def end_recording(recording: dict[str, Any], aborted: str) -> str:
    """The file of this flight; a recording that ran before it goes on in a new one."""
    path = socket_path()
    try:
        status = ask(path, "POST", "/record/stop")
        if recording["was_on"]:
            ask(path, "POST", "/record/start")
    except GroundStationError as error:
        if not aborted:
            raise
        say(f"the recording could not be ended: {error}", error=True)
        status = recording
    return str(status.get("path") or status["file"])


# How a flight ends: motors that are asked to stop until the craft says that they stand.


STOPS_SENT, COAST_S = 5, 0.5
"""Zero thrust is sent so often at least, for a radio may lose some; and for so long before more is
done: armed brushless motors idle, and with an assist mode on others turn as well."""
MOTORS_OFF = "motors are off"
NOT_TURNING = (
    "thrust is asked for and no motor turns: a craft that needs arming is armed by `groundstation"
    " motors arm` or on the page (Arm...); after an emergency stop it is switched off and on"
)


@dataclass(frozen=True, slots=True)
class Ended:
    """How a flight ended. why: it was cut short, or did not end as it should, or empty. motors:
    what is known of them. interrupted: by Ctrl-C or SIGTERM, in the flight or behind it. seconds:
    it took. recording: the daemon's file. restored: parameters that were put back."""

    why: str
    motors: str
    interrupted: KeyboardInterrupt | None = None
    seconds: float = 0.0
    recording: str = ""
    restored: Sequence[str] = ()

    def require(self, what: str) -> None:
        """Raises GroundStationError where it was cut short: why, how the motors are, and where the
        recording is; KeyboardInterrupt where one came behind a flight that was not."""
        for words, by_operator in (("Stopped", BY_OPERATOR), ("Landed", LANDED_BY_OPERATOR)):
            if self.why == by_operator:
                raise GroundStationError(
                    f"{words} by the operator, {self.motors.replace('are off', 'off')};"
                    f" the recording is {self.recording}"
                )
        if self.why:
            raise GroundStationError(
                f"{what} aborted: {self.why}; {self.motors}, the recording is {self.recording}"
            )
        if self.interrupted is not None:
            say(f"{what} ended; {self.motors}, the recording is {self.recording}", error=True)
            raise self.interrupted


def stopped_after(fly: Callable[[], str], pilot: Pilot, signals: Interrupts) -> Ended:
    """Fly what says why it was cut short, and stop the motors behind it, whatever ends it."""
    try:
        with signals.heard():
            why = fly()
    except KeyboardInterrupt as stop:
        why = str(stop)
        say("stopping the motors", error=True)
    except GroundStationError as error:
        why = why_aborted(error)
    motors = stop_now(pilot, signals)
    return Ended(why or ("" if motors == MOTORS_OFF else motors), motors)


def stop_now(pilot: Pilot | SoftwareCraft, signals: Interrupts) -> str:
    """``stop_motors``; one interrupt does not keep it from that, a second one does: then the end of
    the lease stops them."""
    with signals.heard(1, "the motors are being stopped; Ctrl-C again leaves it to the daemon"):
        return stop_motors(pilot)


def stop_motors(pilot: Pilot | SoftwareCraft) -> str:
    """Zero thrust until fresh telemetry says that the motors stand, and what else stops them where
    they go on turning; what is known of them."""
    deadline = time.monotonic() + COAST_S
    try:
        for sent in range(1, 10**9):
            telemetry = pilot.setpoint(0.0, 0.0, 0.0, 0)["telemetry"]
            heard = telemetry is not None and telemetry["age_s"] <= AbortLimits().silent_s
            if sent >= STOPS_SENT and heard and not any(telemetry["motors"]):
                return MOTORS_OFF
            if time.monotonic() > deadline:
                break
            time.sleep(0.05)
    except GroundStationError:
        pass  # the lease may be over: what became of its motors is told all the same
    try:
        why = pilot.stop()
    except GroundStationError as error:
        why = str(error)
    if why in (STOPPED, STILL_TURN):
        return MOTORS_OFF if why == STOPPED else f"motors were {STILL_TURN}"
    return (
        f"nothing says that the motors stopped ({why}): the daemon's failsafe asks for it where it"
        " still reaches the craft, whose own firmware stops them 2 s after the last setpoint"
    )


# When the next setpoint is due.


class Clock(Protocol):
    """What time it is for the craft, s, and waiting for a setpoint's time."""

    def now_s(self) -> float: ...

    def wait(self) -> None: ...


class SetpointClock:
    """Setpoints every 10 ms; what was missed is not made up for."""

    def __init__(self) -> None:
        self._next = time.monotonic()

    def now_s(self) -> float:
        return time.monotonic()

    def wait(self) -> None:
        self._next = max(self._next + 0.01, time.monotonic() - 0.01)
        time.sleep(max(self._next - time.monotonic(), 0.0))


# A flight of the daemon's craft: begun once per person's command, recorded, and its parameters put
# back.


OPERATOR_DID = "the operator "
"""How the daemon's note of a Stop or a Land begins."""
STOPPED_SINCE = "motors were stopped since this program began; begin it again"
STOPS_SEEN = "GROUNDSTATION_STOPS"
"""The daemon's count of Stops when it began this program as a job."""


def stops_begun(path: Path) -> int:
    """How often somebody had stopped the motors when this program began, as the daemon counts; a
    daemon that has just started is waited for.

    Raises GroundStationError where that was done while the program was still being loaded.
    """
    from groundstation.cli import main

    await_connection(path)
    given = os.environ.get(STOPS_SEEN, "")
    if given.isdigit():
        return int(given)
    command = ask(path, "GET", "/status")["command"]
    for event in ask(path, "GET", "/events"):
        is_stop = event["kind"] == "stop" and event["text"].startswith(OPERATOR_DID)
        if is_stop and main.begun_ns < event["time_ns"] < time.time_ns():
            raise GroundStationError(STOPPED_SINCE)
    return 0 if command is None else int(command["stops"])


@contextmanager
def commanded(client: str, stops: int | None = None, craft: Craft | None = None) -> Iterator[Pilot]:
    """The lease on the daemon's craft. stops: as ``stops_begun`` said at the program's begin.

    Raises GroundStationError where the motors were stopped since, BadInputError where it is another
    craft than ``craft``.
    """
    from groundstation.learn import planning as journal

    with Pilot(socket_path(), client, stops) as pilot:
        now = journal.Craft(**pilot.lease["craft"])
        if craft is not None and not craft.is_same(now):
            raise BadInputError(
                f"this is another craft: {now}; it was {craft}. Nothing was written or flown; learn"
                " this one in another folder with -o"
            )
        yield pilot


def require_calm(stops: int) -> None:
    """Raises GroundStationError where somebody has stopped the motors since this program began."""
    command = ask(socket_path(), "GET", "/status")["command"]
    if command is not None and command["stops"] != stops:
        raise GroundStationError(STOPPED_SINCE)


class Flight:
    """One flight of the daemon's craft: parameters that are written for it, what is flown, its
    recording, and the former parameters put back.

    pilot: the lease on the craft. changed: what is written, by full name.
    """

    def __init__(self, pilot: Pilot) -> None:
        self.pilot = pilot
        self.changed: dict[str, float] = {}
        self._stays = set[str]()

    @cached_property
    def before(self) -> dict[str, float]:
        """Every parameter of the craft, as it was."""
        return self.pilot.parameters()

    @property
    def former(self) -> dict[str, float]:
        """What the craft had of those that are changed."""
        return {name: self.before[name] for name in self.changed}

    @property
    def gains(self) -> dict[str, float]:
        """Every gain that flies."""
        return gains_of(self.before | self.changed)

    def change(self, values: Mapping[str, float], *, stays: bool = False) -> None:
        """Fly with these parameters. stays: they are not put back after a good flight. Raises
        BadInputError for one that the craft has not."""
        unknown = [name for name in values if name not in self.before]
        if unknown:
            raise BadInputError(
                f"the craft has no parameter {', '.join(unknown)}; nothing was written"
            )
        self.changed |= values
        self._stays |= set(values) if stays else set()

    def fly(self, fly: Callable[[Interrupts], Ended], mark: str, **details: Any) -> Ended:
        """Record one flight with the changed parameters, and put them back behind it.

        fly: what is flown; it leaves a craft whose motors stand. mark, details: the recording's
        first. An interrupt, whenever it comes, is told in what is returned, and nothing after it
        is skipped. One that comes before the former parameters are put back cuts the flight short.
        """
        pilot, begun_s = self.pilot, time.monotonic()
        with Interrupts() as signals:
            recording = begin_recording()
            try:
                with signals.heard():
                    write_parameters(pilot, self.changed)
                    pilot.mark(mark, **details)
                ended = fly(signals)
            except KeyboardInterrupt as stop:
                ended = Ended(str(stop), stop_motors(pilot))
            except GroundStationError as error:
                ended = Ended(why_aborted(error), stop_motors(pilot))
            seconds = time.monotonic() - begun_s
            why = ended.why or str(signals.last or "")
            restored, lost = self._put_back(why)
            file = end_recording(recording, why)
        return replace(
            ended,
            why=why or lost,
            interrupted=signals.last,
            seconds=seconds,
            recording=file,
            restored=restored,
        )

    def _put_back(self, why: str) -> tuple[list[str], str]:
        """The names of what is put back: all of it after a flight that was cut short; and why what
        should stay does not. A lease that is over leaves it to the daemon, which writes every
        former value back."""
        back = {k: v for k, v in self.former.items() if why or k not in self._stays}
        try:
            write_parameters(self.pilot, back)
        except GroundStationError as error:  # the lease is over, or the craft is out of reach
            self.pilot.content = False
            say("the daemon puts the former parameters back, once the craft stands", error=True)
            return [], f"what was written does not stay: {error}" if self._stays else ""
        self.pilot.wrote = len(back) < len(self.former)
        if back and why:
            say("the former parameters are back", error=True)
        return sorted(back), ""


def gains_of(parameters: Mapping[str, float]) -> dict[str, float]:
    """Those of the craft's parameters that are gains of its loops."""
    return {name: value for name, value in parameters.items() if name.startswith("pid_")}


LEAST_THRUST, BASE_THRUST = "posCtlPid.thrustMin", "posCtlPid.thrustBase"
"""Of the firmware's height loop: it asks for no less than the first; the second is about what the
craft hovers with."""
SINKS = 0.5
"""Of the latter, a least thrust with which a craft of four fifths of its mass still sinks. A
Brushless has 0.67: a light one flew on upwards, and was dropped."""


def lets_sink(parameters: Mapping[str, float]) -> dict[str, float]:
    """What a flight by height changes of the craft's parameters, so that it can come down."""
    least = round(SINKS * parameters.get(BASE_THRUST, 0.0))
    return {LEAST_THRUST: least} if parameters.get(LEAST_THRUST, 0.0) > least else {}


def write_parameters(pilot: Pilot, values: Mapping[str, float]) -> None:
    """Write parameters and require that the craft read back the same numbers."""
    if not values:
        return
    back = pilot.write(dict(values))
    for name, value in values.items():
        if np.float32(back[name]) != np.float32(value):
            raise GroundStationError(
                f"{name}: wrote {value:g}, the craft says {back[name]:g}; nothing was flown"
            )


# A programme flown by a craft that holds its height: up, each manoeuvre, back to its place, down.
#
# A craft that knows its place as well is stopped and brought back by hover setpoints, and watched:
# attitude setpoints alone carry any craft away.


CLIMB_M_S, STEP_MOST_M = 0.4, 0.04
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
NOT_LANDED = "it could not be landed"
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
    try:
        with signals.heard():
            _ByHeight(pilot, room, clock or SetpointClock(), tells_battery).fly(programme)
    except _OverError as over:
        why, lands = over.why, over.lands
        say(f"{why}: {'landing' if lands else 'stopping the motors'}", error=True)
        if lands:
            with contextlib.suppress(GroundStationError):
                pilot.mark(LANDS, why=why)
    except KeyboardInterrupt as stop:
        why = str(stop)
        say(f"{why}: landing; Ctrl-C again stops the motors", error=True)
    except GroundStationError as error:  # the daemon has ended it: it says how
        why = why_aborted(error)
    motors, not_landed = land(pilot, signals) if lands else (stop_now(pilot, signals), "")
    return Ended(why or not_landed, motors)


def land(pilot: Pilot | SoftwareCraft, signals: Interrupts) -> tuple[str, str]:
    """Let the craft be landed; what is known of its motors then, and why it was not landed, or
    empty. The Ctrl-C after the one that began a landing stops them."""
    why = NOT_LANDED
    try:
        spare = 0 if signals.raised else 1
        with signals.heard(spare, "landing; Ctrl-C again stops the motors"):
            if pilot.land() == LANDED:
                return f"{LANDED}, {MOTORS_OFF}", ""
            pilot.setpoint(0.0, 0.0, 0.0, 0)  # a lease that is over says why
    except KeyboardInterrupt as stop:
        why = str(stop)
        say("stopping the motors", error=True)
    except GroundStationError as error:
        # the lease may be over: what became of its motors is told all the same
        why = why_aborted(error)
    return stop_now(pilot, signals), why


class _ByHeight:
    """One flight, from the ground to where it may land. Raises _OverError."""

    def __init__(
        self, pilot: Pilot | SoftwareCraft, room: Room, clock: Clock, tells_battery: bool
    ) -> None:
        self._pilot, self._room, self._clock = pilot, room, clock
        self._low = LowBattery() if tells_battery else None
        self._places = bool(pilot.lease["holds_place"])
        self._home = (0.0, 0.0)
        self._trim = (0.0, 0.0)
        self._turns, self._asked_m = False, room.floor_m
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
            ahead_m = self._seen.away_m(self._home, AHEAD_S)
            if self._places and not ahead_m <= self._room.reach_m:
                self._brought_back += 1
                if self._brought_back > self._brought_back_most:
                    count = f"{self._brought_back} times in this flight"
                    raise _OverError(f"{AWAY}: manoeuvres carried it off {count}", lands=True)
                row = stands_again(np.array([one[:3] for one in rows]), row)
                if row == len(rows):
                    break
                self._mark(HOLDS, name=name)
                self._hold()
                self._begin_manoeuvre(name)  # it goes on, where it begins anew from rest
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
        """See how the craft stands, its motors off: it may have been taken up since somebody last
        looked."""
        answer = self._pilot.setpoint(0.0, 0.0, 0.0, 0)
        reason = reason_to_abort(answer, self._low) or trouble_of(answer)
        if reason:
            raise _OverError(reason, lands=False)
        self._seen = Seen.of(answer)

    def _take_off(self) -> None:
        """Climb, then hover until it is known what its hover is."""
        room, hover = self._room, Hover()
        while self._asked_m < room.top_m:
            time_s = self._clock.now_s() - self._begun_s
            # by the clock, and no step where it was held up
            climbed_m = min(room.floor_m + CLIMB_M_S * time_s, room.top_m)
            self._tick(min(climbed_m, self._asked_m + STEP_MOST_M))
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
        self._asked_m = height_m
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


# Gains that a craft keeps while it is switched off: ``--store`` and ``--undo`` of its flights.


STORE = typer.Option(
    False, "--store", help="Have the craft keep the gains when it is switched off."
)


def require_storing(pilot: Pilot, store: bool = True, *, restore: bool = False) -> None:
    """Before anything flies: raises BadInputError where gains are to be stored (store) by a craft
    that keeps none, or to be put back as well (restore)."""
    if not store:
        return
    if restore:
        raise BadInputError("--store keeps the gains, --restore puts the former back: give one")
    try:
        pilot.stored()
    except GroundStationError as error:
        raise BadInputError(f"--store: {error}; nothing was flown") from error


def store_gains(pilot: Pilot, flown: str) -> list[str]:
    """Have a craft that has landed keep its gains; the names of those that it has stored
    then. flown: what was done, said where it does not."""
    try:
        found = pilot.store()
    except GroundStationError as error:
        raise GroundStationError(f"{flown}, but its gains are not all stored: {error}") from error
    return stored_in(found)


def clear_gains(pilot: Pilot) -> dict[str, float]:
    """Have a craft forget the gains that it has stored: their values in its firmware. None where it
    stores none."""
    if not pilot.ask("GET", "/status")["command"]["stores"]:
        return {}
    found = pilot.stored()
    gains = {name: found[name]["default"] for name in stored_in(found)}
    if gains:
        pilot.clear_stored(*gains)
    return gains


def stored_in(found: Mapping[str, Any]) -> list[str]:
    """The names of the gains that are stored."""
    return sorted(
        name for name, one in found.items() if one["stored"] is not None and name.startswith("pid_")
    )
