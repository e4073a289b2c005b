"""A programme in the air by a human's thrust, from keyboard or gamepad."""

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
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from groundstation import BadInputError, GroundStationError, Pilot
from groundstation.cli.flying import (
    NOT_TURNING,
    UNRECORDED,
    Clock,
    Ended,
    Interrupts,
    SetpointClock,
    stopped_after,
)
from groundstation.cli.terminal import say
from groundstation.control.programme import (
    BEGINS,
    BY_HAND,
    LANDING,
    LANDS,
    LOW_BATTERY,
    RATE_HZ,
    LowBattery,
    reason_to_abort,
)

if TYPE_CHECKING:
    from groundstation.control.firmwares import Firmware

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
