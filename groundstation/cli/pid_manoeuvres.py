"""A programme in the air by somebody's thrust: take-off, manoeuvres, landing, motors that stop."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from groundstation import GroundStationError, Pilot
from groundstation.cli.height_flight import UNRECORDED
from groundstation.cli.interrupts import Interrupts
from groundstation.cli.motors_off import NOT_TURNING, Ended, stopped_after
from groundstation.cli.setpoint_clock import Clock, SetpointClock
from groundstation.cli.sticks import (
    CLIMB_M_S,
    HOLD_HEIGHT,
    HOLD_M,
    NOMINAL_V,
    Hands,
    Source,
    StandInPilot,
    climb_thrust,
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
