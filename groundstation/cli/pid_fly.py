"""``pid fly``: gains and a programme on a craft, held by itself or by a human's thrust."""

from __future__ import annotations

import math
import os
import select
import struct
import sys
import termios
import time
import tty
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
import typer

from groundstation import BadInputError, GroundStationError, Pilot, socket_path
from groundstation.cli.flying import (
    NOT_TURNING,
    STORE,
    UNRECORDED,
    Clock,
    Ended,
    Flight,
    Interrupts,
    Room,
    SetpointClock,
    await_connection,
    clear_gains,
    commanded,
    fly_by_height,
    lets_sink,
    require_consent,
    require_height,
    require_ready,
    require_standing,
    require_storing,
    stopped_after,
    stops_begun,
    store_gains,
    write_parameters,
)
from groundstation.cli.model_files import AS_JSON, answer, fitted_model, require_new
from groundstation.cli.terminal import say, show
from groundstation.control.programme import (
    BEGINS,
    BEYOND_M,
    BY_HAND,
    LANDING,
    LANDS,
    LOW_BATTERY,
    RATE_HZ,
    LowBattery,
    Programme,
    reason_to_abort,
    require_flyable,
)
from groundstation.service.client import ask
from groundstation.telemetry.arrays import AXES

if TYPE_CHECKING:
    from groundstation.control.firmwares import Firmware, Release

# A human's thrust: keyboard, or a gamepad that Linux shows as /dev/input/js*.
#
# Read once per setpoint, never blocking. What is lost (an unplugged gamepad, a closed terminal)
# reads as stop.


THRUST_MOST = 55000
KEY_STEP = 500
FULL_LEAN_DEG, FULL_YAW_DPS = 15.0, 90.0
DEAD_ZONE = 0.08
HEIGHTS_M, DEFAULT_HEIGHT_M, CLIMB_M_S = (0.2, 2.0), 0.5, 0.4
HOLD_M = 0.8
"""How high a craft climbs that holds its height by ``flightmode.althold``."""
HOLD_HEIGHT = "flightmode.althold"
HOLDS_THRUST = 32767.0
"""With that mode: what neither climbs nor sinks; 0 is 1 m/s downwards."""
NOMINAL_V = 3.7
"""Of a cell that is not told."""
MOTORS_ON = 10000
"""The firmware takes less thrust for none."""
_EVENT = struct.Struct("<IhBB")
_BUTTON, _AXIS, _INITIAL = 1, 2, 0x80
KEYS = "w/s more/less thrust, W/S five times as much, g begins the programme, space stops"
STICKS = "left stick thrust and yaw, right stick attitude, first button begins, second stops"


@dataclass(frozen=True, slots=True)
class Hands:
    """What a human wants: thrust 0..55000, angles in deg and yaw rate in deg/s to be added in the
    signs of the telemetry, whether the programme may begin, whether to stop at once."""

    thrust: int = 0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_dps: float = 0.0
    begin: bool = False
    stop: bool = False

    @property
    def flies(self) -> bool:
        return self.thrust > MOTORS_ON


def climb_thrust(climb_m_s: float) -> int:
    """Thrust that asks for a rate of climb with ``flightmode.althold``."""
    return round(HOLDS_THRUST * (1.0 + climb_m_s))


class StandInPilot:
    """With ``flightmode.althold`` a craft in software holds its height: the stand-in's pilot
    whatever the thrust is that turns the motors, today's firmware where it is the middle one: more
    or less is a rate of climb."""

    help = "altitude hold keeps the height"

    def __init__(self) -> None:
        self._begun_s: float | None = None

    def read(self) -> Hands:
        now_s = time.monotonic()
        if self._begun_s is None:
            self._begun_s = now_s
        climbs = now_s < self._begun_s + HOLD_M / CLIMB_M_S
        return Hands(thrust=climb_thrust(CLIMB_M_S if climbs else 0.0), begin=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass


class Keyboard:
    """Keys of the terminal, without Enter."""

    help = KEYS

    def __init__(self) -> None:
        if not sys.stdin.isatty():
            raise BadInputError("--thrust keyboard: standard input is no terminal")
        self._hands = Hands()
        self._before: list[Any] = []

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *error: object) -> None:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def read(self) -> Hands:
        while select.select([sys.stdin], [], [], 0)[0]:
            key = os.read(sys.stdin.fileno(), 1)
            if key in (b"", b" "):
                self._hands = replace(self._hands, thrust=0, stop=True)
                break
            if key == b"g":
                self._hands = replace(self._hands, begin=True)
            step = {b"w": 1, b"s": -1, b"W": 5, b"S": -5}.get(key, 0) * KEY_STEP
            thrust = min(max(self._hands.thrust + step, 0), THRUST_MOST)
            self._hands = replace(self._hands, thrust=thrust)
        return self._hands


class Gamepad:
    """A gamepad or joystick: the kernel's joystick interface, no library needed."""

    help = STICKS

    def __init__(self, path: Path) -> None:
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise BadInputError(f"--thrust gamepad:{path}: {error.strerror}") from error
        self._axes = [0.0] * 256
        self._hands = Hands()
        self._rest = b""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._file)

    def read(self) -> Hands:
        try:
            while data := os.read(self._file, 64 * _EVENT.size):
                self._rest += data
        except BlockingIOError:
            pass
        except OSError:  # unplugged
            self._hands = replace(self._hands, thrust=0, stop=True)
        whole = len(self._rest) // _EVENT.size * _EVENT.size
        for _, value, kind, number in _EVENT.iter_unpack(self._rest[:whole]):
            if kind & ~_INITIAL == _AXIS:
                self._axes[number] = _beyond_dead_zone(value / 32767.0)
            elif kind == _BUTTON and value:
                begin = self._hands.begin or number == 0
                self._hands = replace(
                    self._hands, begin=begin, stop=self._hands.stop or number == 1
                )
        self._rest = self._rest[whole:]
        return self._steered()

    def _steered(self) -> Hands:
        yaw, up, aside, ahead = (self._axes[i] for i in (0, 1, 3, 4))
        return replace(
            self._hands,
            # sticks read negative when pushed away; half way up from the middle is hover
            thrust=0 if self._hands.stop else round(THRUST_MOST * max(0.0, -up)),
            roll_deg=FULL_LEAN_DEG * aside,
            pitch_deg=FULL_LEAN_DEG * -ahead,
            yaw_dps=FULL_YAW_DPS * -yaw,
        )


Source = StandInPilot | Keyboard | Gamepad


def open_sticks(name: str) -> Source:
    """``stand-in``, ``keyboard`` or ``gamepad:/dev/input/js0``. Raises BadInputError."""
    kind, _, rest = name.partition(":")
    if name == "stand-in":
        return StandInPilot()
    if name == "keyboard":
        return Keyboard()
    if kind == "gamepad":
        return Gamepad(Path(rest or "/dev/input/js0"))
    raise BadInputError(
        f"--thrust {name}: there are stand-in, height:0.5, keyboard, gamepad:/dev/input/js0"
    )


def height_of(name: str) -> float | None:
    """Of ``height:0.5``, m: what the craft holds by itself; None for another source of thrust.
    Raises BadInputError."""
    kind, _, text = name.partition(":")
    if kind != "height":
        return None
    low, high = HEIGHTS_M
    try:
        height_m = float(text or DEFAULT_HEIGHT_M)
    except ValueError:
        height_m = math.nan
    if not low <= height_m <= high:
        raise BadInputError(f"--thrust {name}: give metres, {low:g}..{high:g}")
    return height_m


def _beyond_dead_zone(value: float) -> float:
    size = max(abs(value) - DEAD_ZONE, 0.0) / (1.0 - DEAD_ZONE)
    return size if value >= 0 else -size


# A programme in the air by somebody's thrust: take-off, manoeuvres, landing, motors that stop.


DESCENT = 0.97
"""Thrust of the landing, as a share of what hovered: about 0.5 m/s^2 downwards."""
DESCENT_S = 2.4
TOUCHED_DPS, TOUCHED, LEVEL_S = 150.0, 2.0, 1.0
"""A craft that turns so fast while it comes down, and so many times as fast as in so long before,
has met the ground: level flight never does, unless it shakes."""
TAKE_OFF_S = 3.0
ON_GROUND_S = 0.7
"""How long it is asked to sink on the ground, before the motors are stopped."""


class Setpoints(Protocol):
    """setpoints: of every 10 ms roll (deg), pitch (deg), yaw rate (deg/s), (k, 3)."""

    def setpoints(self) -> Any: ...


def fly_by_hand(
    pilot: Pilot,
    programme: Setpoints,
    sticks: Source,
    signals: Interrupts,
    *,
    tells_battery: bool,
) -> Ended:
    """Take off, fly the programme, land; its motors stand then. The daemon cannot land such a
    craft: Ctrl-C stops its motors."""
    return stopped_after(lambda: _fly(pilot, programme, sticks, tells_battery), pilot, signals)


def _fly(pilot: Pilot, programme: Setpoints, sticks: Source, tells_battery: bool) -> str:
    """Why it was aborted, or empty."""
    table = programme.setpoints()
    # before the flight, which nothing may hold up
    firmware = _firmware(pilot) if isinstance(sticks, StandInPilot) else None
    clock, low = SetpointClock(), LowBattery() if tells_battery else None
    answer: dict[str, Any] = {}

    def send(hands: Hands, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> str:
        nonlocal answer
        answer = _sent(pilot, hands, roll, pitch, yaw)
        return reason_to_abort(answer, low)

    reason = _take_off(sticks, send, clock)
    if reason and not reason.startswith(LOW_BATTERY):
        return reason
    if all(motor == 0.0 for motor in answer["telemetry"]["motors"]):
        return NOT_TURNING
    reason = reason or _marked(pilot, BEGINS)
    turned: deque[float] = deque(maxlen=round(LEVEL_S * RATE_HZ))
    for roll, pitch, yaw in [] if reason else table.tolist():
        hands = sticks.read()
        if hands.stop or not hands.flies:
            return BY_HAND
        reason = send(hands, roll, pitch, yaw)
        if reason.startswith(LOW_BATTERY):
            break  # what is left of it is for the landing
        if reason:
            return reason
        turned.append(_fastest_dps(answer))
        clock.wait()
    reason = reason or _marked(pilot, LANDS)
    met_dps = max(TOUCHED_DPS, TOUCHED * max(turned, default=0.0))
    come_down = partial(_come_down, pilot, clock, met_dps)
    return _land(pilot, sticks, clock, answer, firmware, come_down) or reason


def _marked(pilot: Pilot, text: str) -> str:
    """Why a flight can no more be recorded, or empty: it lands then."""
    try:
        pilot.mark(text)
    except GroundStationError as error:
        return f"{UNRECORDED}: {error}"
    return ""


def _take_off(sticks: Source, send: Callable[[Hands], str], clock: Clock) -> str:
    """Until the human says so, or the pilot has had his time; why it was aborted, or empty."""
    for tick in range(10**9):
        hands = sticks.read()
        if hands.stop:
            return BY_HAND
        reason = send(hands)
        if reason and hands.flies:
            return reason
        if hands.begin and hands.flies and tick >= TAKE_OFF_S * RATE_HZ:
            break
        clock.wait()
    return ""


def _land(
    pilot: Pilot,
    sticks: Source,
    clock: Clock,
    last: dict[str, Any],
    firmware: Firmware | None,
    come_down: Callable[[Iterable[Hands]], str],
) -> str:
    """Software with ``flightmode.althold`` is asked to sink, the stand-in of 2014's sinks at a
    little less thrust than hovered, a human lands by hand. A battery that is low ends none of
    it."""
    if firmware is not None and firmware.is_today and HOLD_HEIGHT in pilot.parameters():
        sinks = [Hands(thrust=climb_thrust(-CLIMB_M_S))]
        reason = come_down(sinks * round((HOLD_M / CLIMB_M_S + ON_GROUND_S) * RATE_HZ))
        pilot.write({HOLD_HEIGHT: 0.0})  # with it zero thrust turns the motors
        return reason
    if firmware is not None:
        if HOLD_HEIGHT in pilot.parameters():
            pilot.write({HOLD_HEIGHT: 0.0})
        said = last["telemetry"]
        battery_v = said["battery_v"] or NOMINAL_V
        hover = float(firmware.thrust(said["motors"], 1000.0 * battery_v).mean())
        sinking = Hands(thrust=round(DESCENT * hover))
        return come_down([sinking] * round(DESCENT_S * RATE_HZ))
    say("the programme is flown: land", error=True)
    while True:
        hands = sticks.read()
        if hands.stop or not hands.flies:
            return ""
        reason = reason_to_abort(_sent(pilot, hands), None)
        if reason:
            return reason
        clock.wait()


def _sent(
    pilot: Pilot,
    hands: Hands,
    roll: float = 0.0,
    pitch: float = 0.0,
    yaw: float = 0.0,
) -> dict[str, Any]:
    """The daemon's answer to a setpoint of the programme with a human's part in it."""
    return pilot.setpoint(
        roll + hands.roll_deg, pitch + hands.pitch_deg, yaw + hands.yaw_dps, hands.thrust
    )


def _come_down(
    pilot: Pilot,
    clock: Clock,
    met_dps: float,
    steps: Iterable[Hands],
) -> str:
    """Send one after the other until the ground is met; why it was aborted, or empty."""
    for hands in steps:
        answer = _sent(pilot, hands)
        reason = reason_to_abort(answer, None, LANDING)
        if reason:
            return reason
        if _fastest_dps(answer) > met_dps:
            break
        clock.wait()
    return ""


def _fastest_dps(answer: dict[str, Any]) -> float:
    """How fast the craft turns about any axis."""
    return max(abs(rate) for rate in answer["telemetry"]["gyro_dps"])


def _firmware(pilot: Pilot) -> Firmware:
    """That of the craft, which knows what thrust is behind what its motors get."""
    from groundstation import load_vehicle
    from groundstation.control.firmwares import firmware_of_vehicle

    vehicle = load_vehicle(pilot.ask("GET", "/status")["vehicle"])
    return firmware_of_vehicle(vehicle, pilot.lease["firmware"] or None)


# What ``pid fly`` is given: gains, a model, and the firmware that they are for.


@dataclass(frozen=True, slots=True)
class Whose:
    """The files of gains and of the model, and the firmware that the user says they are for."""

    gains: Path | None
    model: str | None
    said: str | None

    def wanted(self) -> dict[str, float]:
        """The gains. Raises BadInputError for what is wrong with any: better known before a
        flight."""
        from groundstation import PidGains, load_gains
        from groundstation.control.firmware_loop import plant_of_model, require_gains
        from groundstation.control.firmwares import require_release

        wanted: dict[str, float] = {}
        for name, value in {} if self.gains is None else load_gains(self.gains).items():
            if isinstance(value, PidGains):
                raise BadInputError(
                    f"gains {self.gains}: the thesis's form cannot be flown, only the firmware's"
                )
            wanted[name] = value
        if self.gains is not None:
            require_gains(wanted, f"gains {self.gains}")
        if self.said is not None:
            require_release(self.said)
        if self.model is not None:
            plant_of_model(fitted_model(self.model), release=self.said)
        return wanted

    def require(self, craft: str, uri: str) -> Release | None:
        """The firmware of the craft that calls its own ``craft`` (empty: it does not say).

        Raises BadInputError where gains or model are another's: the same parameters mean other
        numbers there.
        """
        from groundstation import load_model
        from groundstation.control.firmware_loop import require_gains_of
        from groundstation.control.firmwares import firmware_of_vehicle, require_release
        from groundstation.dynamics.model import model_vehicle

        if not (craft or self.said):
            if self.gains is None and self.model is None:
                return None
            raise BadInputError(
                f"{uri} does not say whose loops it flies; say --firmware 2014 or --firmware 2.x"
            )
        if craft and self.said and craft != self.said:
            raise BadInputError(f"--firmware {self.said}: {uri} flies {craft}; nothing was written")
        release = require_release(craft or str(self.said))
        if self.gains is not None:
            require_gains_of(self.gains, release, uri, said=self.said)
        if self.model is not None and self.said is None:
            vehicle = model_vehicle(load_model(self.model))
            if firmware_of_vehicle(vehicle).name != release:
                raise BadInputError(
                    f"model {self.model}: a {vehicle.name} flies {vehicle.firmware}, {uri} flies"
                    f" {release}: not of this craft, or say --firmware {release}"
                )
        return release


# The command.


CLIENT = "pid fly"
THRUST = typer.Option(
    "",
    help="stand-in, height:0.5 (m, held by a craft that knows its height), keyboard or"
    " gamepad:/dev/input/js0 (default: by what the craft can).",
)


def fly(
    gains: Path | None = typer.Option(
        None, "--gains", help="TOML file of firmware gains; none: measure what is there."
    ),
    model: str | None = typer.Option(None, "--model", help="Model file, for the prediction."),
    programme: str = typer.Option(
        "doublet", "--programme", help="doublet, step, or level (hover, manual flight)."
    ),
    axis: list[str] | None = typer.Option(
        None, "--axis", help="roll, pitch or yaw; repeatable (default: all)."
    ),
    amplitude: float = typer.Option(10.0, help="Roll and pitch, deg."),
    yaw_rate: float = typer.Option(60.0, help="Yaw, deg/s."),
    hold: float = typer.Option(0.7, help="How long each level is held, s."),
    rest: float = typer.Option(1.0, help="Rest between manoeuvres, s."),
    repeat: int = typer.Option(8, help="Manoeuvres an axis; more of them, less noise."),
    firmware: str | None = typer.Option(
        None,
        "--firmware",
        help="2014 or 2.x, where neither file nor craft say whose the gains are.",
    ),
    thrust: str = THRUST,
    restore: bool = typer.Option(False, "--restore", help="Put the former gains back after it."),
    store: bool = STORE,
    undo: bool = typer.Option(False, "--undo", help="Put former gains back, clear stored ones."),
    rehearse: bool = typer.Option(
        False, "--rehearse", help="Fly it in software with --model; no craft is touched."
    ),
    dry_run: bool = typer.Option(False, "--dry-run", help="Show what would be flown."),
    yes: bool = typer.Option(False, "--yes", help="Do not ask before a real craft flies."),
    html: Path | None = typer.Option(None, "--html", help="Write a report to this new file."),
    as_json: bool = AS_JSON,
) -> None:
    """Fly gains through steps or doublets, and compare with the prediction.

    A client of a running daemon with a command link ('groundstation run --command ...'). Ctrl-C
    lands a craft that holds its height, a second one stops its motors.

    Example: [bold]groundstation pid fly --gains gains.toml --model body.json --restore[/bold]
    """
    require_new(html)
    axes = tuple(axis or AXES)
    shape: Any = programme  # require_flyable judges it
    planned = Programme(shape, axes, amplitude, yaw_rate, hold, rest, repeat)
    require_flyable(planned)
    whose = Whose(gains, model, firmware)
    wanted = whose.wanted()
    if dry_run:
        _show(planned, wanted, as_json)
        return
    if rehearse:
        _rehearse(planned, wanted, model, height_of(thrust or "height"), as_json)
        return
    if undo:
        _undo()
        return
    report = _flight(planned, wanted, whose, restore, store, thrust, yes)
    _judge(report, planned, model, html, as_json)


def _show(programme: Programme, wanted: dict[str, float], as_json: bool) -> None:
    plan = {
        **programme.as_dict(),
        **{
            name: getattr(programme, name)
            for name in ("seconds", "reach_m", "held_seconds", "held_reach_m")
        },
    }
    lines = [
        f"{programme.repeats} {programme.shape}s an axis ({', '.join(programme.axes)}):"
        f" {programme.angle_deg:g} deg, yaw {programme.yaw_dps:g} deg/s,"
        f" held {programme.hold_s:g} s",
        f"with a Flow deck: about {programme.held_seconds:.0f} s; it returns after each"
        f" manoeuvre, stays within {programme.held_reach_m:.1f} m of its take-off, and lands"
        f" {BEYOND_M:g} m beyond that",
        f"without: {programme.seconds:.0f} s; one manoeuvre carries it {programme.reach_m:.1f} m,"
        " nothing brings it back: a human must",
        *(f"  {name} = {value:g}" for name, value in wanted.items()),
    ]
    answer(as_json, {"programme": plan, "gains": wanted}, lines)


def _rehearse(
    programme: Programme,
    wanted: dict[str, float],
    model: str | None,
    height_m: float | None,
    as_json: bool,
) -> None:
    from groundstation.cli.learn import rehearse
    from groundstation.control.report import flight_lines

    if model is None or height_m is None:
        raise BadInputError("--rehearse: give the identified craft, --model, and --thrust height")
    reach_m, measures = programme.held_reach_m, programme.shape != "level"
    told, steps = rehearse(programme, wanted, model, height_m, reach_m, measures)
    axes = {} if steps is None else {one.axis: one.as_dict() for one in steps.axes}
    line = (
        f"rehearsed in software, {told['seconds']:.0f} s: it stayed within"
        f" {told['farthest_m']:.1f} m of its take-off, flew {told['top_m_s']:.1f} m/s at most,"
        f" leaned {told['lean_deg']:.0f} deg at most, and landed"
    )
    lines = [line, *([] if steps is None else flight_lines(steps))]
    answer(as_json, {"rehearsal": told, "gains": wanted, "axes": axes}, lines)


def _flight(
    programme: Programme,
    wanted: dict[str, float],
    whose: Whose,
    restore: bool,
    store: bool,
    thrust: str,
    yes: bool,
) -> dict[str, Any]:
    """Everything that touches the craft; what happened. Raises GroundStationError for a flight that
    was cut short."""
    stops = stops_begun(socket_path())
    with commanded(CLIENT, stops) as pilot:
        lease, flight = pilot.lease, Flight(pilot)
        uri, software = lease["uri"], lease["software"]
        release = whose.require(lease["firmware"], uri)
        if thrust == "stand-in" and not software:
            raise BadInputError(f"--thrust stand-in: {uri} is a real craft; a human gives thrust")
        flight.change(wanted, stays=not restore)
        tells_battery = require_ready(pilot, needs_battery=False)["battery_v"] is not None
        require_storing(pilot, store, restore=restore)
        if thrust.startswith("height"):
            require_height(pilot, f"--thrust {thrust}: ")
        usual = "height" if lease["holds_height"] else "stand-in" if software else "keyboard"
        height_m = height_of(thrust or usual)
        with nullcontext() if height_m else open_sticks(thrust or usual) as sticks:
            if not software and not yes:
                require_consent(pilot, f"{uri}: clear of people, ready to fly?", "not flown")
            require_standing(pilot)
            if height_m:
                flight.change(lets_sink(flight.before))
            if HOLD_HEIGHT in flight.before and isinstance(sticks, StandInPilot):
                flight.change({HOLD_HEIGHT: 1.0})
            ended = flight.fly(
                _way_to_fly(pilot, programme, height_m, sticks, tells_battery),
                f"{CLIENT} begins",
                programme=programme.as_dict(),
                gains=wanted,
                saved=flight.former,
                firmware=release,
                flown=flight.gains,
            )
    ended.require("flight")
    stored = []
    if store:
        with commanded(CLIENT, stops) as pilot:
            stored = store_gains(pilot, f"flown and recorded to {ended.recording}")
    return {
        "aborted": ended.why,
        "motors": ended.motors,
        "restored": ended.restored,
        "stored": stored,
        "recording": ended.recording,
        "gains": flight.gains,
        "firmware": release,
    }


def _way_to_fly(
    pilot: Pilot,
    programme: Programme,
    height_m: float | None,
    sticks: Source | None,
    tells_battery: bool,
) -> Callable[[Interrupts], Ended]:
    """By the height that the craft holds, or by somebody's thrust."""
    uri = pilot.lease["uri"]
    if sticks is not None:
        say(f"{uri}: {sticks.help}; Ctrl-C stops the motors", error=True)
        return lambda signals: fly_by_hand(
            pilot, programme, sticks, signals, tells_battery=tells_battery
        )
    assert height_m is not None
    floor_m = pilot.setpoint(0.0, 0.0, 0.0, 0)["height_m"] or 0.0
    room = Room(height_m, floor_m, programme.held_reach_m)
    say(f"{uri}: the craft holds {height_m:g} m by itself; Ctrl-C lands it", error=True)
    return lambda signals: fly_by_height(
        pilot, programme, room, signals, tells_battery=tells_battery
    )


def _undo() -> None:
    path = socket_path()
    await_connection(path)
    restored = ask(path, "POST", "/command/restore")["values"]
    if restored:
        show("the former values are back: " + ", ".join(restored))
    cleared: dict[str, float] = {}
    command = ask(path, "GET", "/status")["command"]
    if command is not None and command["stores"]:
        with Pilot(path, CLIENT) as pilot:
            cleared = clear_gains(pilot)
            write_parameters(pilot, cleared)
    if cleared:
        show("stored gains cleared, the stock ones are back: " + ", ".join(cleared))
    if not (restored or cleared):
        show("nothing was left changed")


def _judge(
    report: dict[str, Any],
    programme: Programme,
    model: str | None,
    html: Path | None,
    as_json: bool,
) -> None:
    """Metrics of the recording, beside the model's."""
    measured: list[str] = []
    if programme.shape != "level":
        from groundstation import load_model
        from groundstation.control.report import flight_lines, flight_page
        from groundstation.control.step_analysis import analyse_recording
        from groundstation.recording.formats import open_for_analysis

        if not Path(report["recording"]).exists():
            raise BadInputError(
                f"the flight was recorded to {report['recording']}, which is not there: start"
                " pid fly where it can read the daemon's recordings"
            )
        loaded = None if model is None else load_model(model)
        recording = open_for_analysis(Path(report["recording"]))
        voltage = recording.samples.battery_v
        if loaded is not None and not np.isfinite(voltage).any():
            voltage[:] = NOMINAL_V  # a prediction needs one
            say(f"no battery was told: the prediction is for {NOMINAL_V:g} V", error=True)
        try:
            flown = analyse_recording(
                recording, loaded, report["gains"], CLIENT, report["firmware"]
            )
        except BadInputError as error:
            raise BadInputError(
                f"flown and recorded to {report['recording']}, but not measured: {error}"
            ) from error
        report["delay_s"], report["delay_spread_s"] = flown.delay_s, flown.spread_s
        report["axes"] = {one.axis: one.as_dict() for one in flown.axes}
        measured = flight_lines(flown)
        if html is not None:
            flight_page(flown, Path(report["recording"]).name, model).write(html)
    stored = ", ".join(report["stored"])
    lines = [
        f"recording: {report['recording']}",
        *[f"stored on the craft: {stored}"] * bool(stored),
    ]
    answer(as_json, report, [*lines, *measured], None if programme.shape == "level" else html)
