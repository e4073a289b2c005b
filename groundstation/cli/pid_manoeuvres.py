"""A programme in the air: take-off, manoeuvres, landing, and motors that stop."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from groundstation import GroundStationError, Pilot
from groundstation.cli.sticks import (
    CLIMB_M_S,
    HOLD_M,
    CraftHeight,
    Hands,
    Source,
    StandInPilot,
    climb_thrust,
)
from groundstation.cli.terminal import say
from groundstation.service.motor_stop import STILL_TURN, STOPPED

if TYPE_CHECKING:
    from groundstation.control.firmwares import Firmware
    from groundstation.links.software_craft import SoftwareCraft

HOLD_HEIGHT = "flightmode.althold"
DESCENT = 0.97
"""Thrust of the landing, as a share of what hovered: about 0.5 m/s^2 downwards."""
DESCENT_S = 2.4
NOMINAL_V = 3.7
"""Of a cell that is not told."""
TOUCHED_DPS, TOUCHED, LEVEL_S = 150.0, 2.0, 1.0
"""A craft that turns so fast while it comes down, and so many times as fast as in so long before,
has met the ground: level flight never does, unless it shakes."""
TAKE_OFF_S = 3.0
NOT_TURNING = (
    "thrust is asked for and no motor turns: a craft that needs arming is armed by `groundstation"
    " motors arm` or on the page (Arm...); after an emergency stop it is switched off and on"
)
ON_GROUND_S = 0.7
"""How long no height is asked for at a landing, before the motors are stopped."""
STOPS, COAST_S = 5, 0.5
"""Zero thrust is sent so often at least, for a radio may lose some; and for so long before more is
done: armed brushless motors idle, and with an assist mode on others turn as well."""
MOTORS_OFF = "motors are off"


class Flyable(Protocol):
    """setpoints: of every 10 ms roll (deg), pitch (deg), yaw rate (deg/s) and, where there is a
    fourth column, metres above the height that is held, (k, 3) or (k, 4)."""

    def setpoints(self) -> Any: ...


class Clock(Protocol):
    """What time it is for the craft, s, and waiting for a setpoint's time."""

    def now_s(self) -> float: ...

    def wait(self) -> None: ...


def fly_programme(
    pilot: Pilot | SoftwareCraft,
    programme: Flyable,
    sticks: Source,
    *,
    tells_battery: bool,
    clock: Clock | None = None,
) -> str:
    """Take off, fly the programme, land; why it was aborted, or empty. tells_battery: whether the
    craft says how its battery is. clock: the craft's, None: real time."""
    from groundstation.control.programme import (
        BEGINS,
        BY_HAND,
        LANDS,
        LOW_BATTERY,
        RATE_HZ,
        LowBattery,
        reason_to_abort,
    )

    table = programme.setpoints()
    # before the flight, which nothing may hold up
    firmware = None
    if isinstance(sticks, StandInPilot) and isinstance(pilot, Pilot):
        firmware = _firmware(pilot)
    clock, low = clock or SetpointClock(), LowBattery() if tells_battery else None
    answer: dict[str, Any] = {}

    def send(hands: Hands, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> str:
        nonlocal answer
        answer = _sent(pilot, hands, roll, pitch, yaw)
        return reason_to_abort(answer, low)

    reason = _take_off(sticks, send, clock)
    if reason.startswith(LOW_BATTERY):
        table = table[:0]  # what is left of it is for the landing
    elif reason:
        return reason
    if all(motor == 0.0 for motor in answer["telemetry"]["motors"]):
        return NOT_TURNING
    pilot.mark(BEGINS)
    turned: deque[float] = deque(maxlen=round(LEVEL_S * RATE_HZ))
    for roll, pitch, yaw, *above in table.tolist():
        if isinstance(sticks, CraftHeight) and above:
            sticks.above_m = above[0]
        hands = sticks.read()
        if hands.stop or not hands.flies:
            return BY_HAND
        reason = send(hands, roll, pitch, yaw)
        if reason.startswith(LOW_BATTERY):
            break
        if reason:
            return reason
        turned.append(_fastest_dps(answer))
        clock.wait()
    pilot.mark(LANDS)
    met_dps = max(TOUCHED_DPS, TOUCHED * max(turned, default=0.0))
    come_down = partial(_come_down, pilot, clock, met_dps)
    return _land(pilot, sticks, clock, answer, firmware, come_down) or reason


def stop_motors(pilot: Pilot | SoftwareCraft) -> str:
    """Zero thrust until fresh telemetry says that the motors stand, and what else stops them where
    they go on turning; what is known of them."""
    from groundstation.control.programme import AbortLimits

    deadline = time.monotonic() + COAST_S
    try:
        for sent in range(1, 10**9):
            telemetry = pilot.setpoint(0.0, 0.0, 0.0, 0)["telemetry"]
            heard = telemetry is not None and telemetry["age_s"] <= AbortLimits().silent_s
            if sent >= STOPS and heard and not any(telemetry["motors"]):
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


def _take_off(sticks: Source, send: Callable[[Hands], str], clock: Clock) -> str:
    """Until the human says so, or the pilot has had his time; why it was aborted, or empty."""
    from groundstation.control.programme import BY_HAND, RATE_HZ

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
    pilot: Pilot | SoftwareCraft,
    sticks: Source,
    clock: Clock,
    last: dict[str, Any],
    firmware: Firmware | None,
    come_down: Callable[[Iterable[Hands]], str],
) -> str:
    """A craft that holds its height is asked for less and less of it or to sink, the stand-in of
    2014's sinks at a little less thrust than hovered, a human lands by hand. A battery that is low
    ends none of it."""
    from groundstation.control.programme import RATE_HZ, reason_to_abort

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
    if isinstance(sticks, CraftHeight):
        # to the floor even where it took off from a table: it may have drifted from there
        ticks = range(round((sticks.top_m / CLIMB_M_S + ON_GROUND_S) * RATE_HZ))
        heights = (max(sticks.top_m - CLIMB_M_S * tick / RATE_HZ, 0.0) for tick in ticks)
        return come_down(sticks.at(lower) for lower in heights)
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
    pilot: Pilot | SoftwareCraft,
    hands: Hands,
    roll: float = 0.0,
    pitch: float = 0.0,
    yaw: float = 0.0,
) -> dict[str, Any]:
    """The daemon's answer to a setpoint of the programme with a human's part in it."""
    return pilot.setpoint(
        roll + hands.roll_deg, pitch + hands.pitch_deg, yaw + hands.yaw_dps, hands.thrust,
        height_m=hands.height_m,
    )  # fmt: skip


def _come_down(
    pilot: Pilot | SoftwareCraft,
    clock: Clock,
    met_dps: float,
    steps: Iterable[Hands],
) -> str:
    """Send one after the other until the ground is met; why it was aborted, or empty."""
    from groundstation.control.programme import LANDING, reason_to_abort

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


class SetpointClock:
    """Setpoints every 10 ms; what was missed is not made up for."""

    def __init__(self) -> None:
        self._next = time.monotonic()

    def now_s(self) -> float:
        return time.monotonic()

    def wait(self) -> None:
        self._next = max(self._next + 0.01, time.monotonic() - 0.01)
        time.sleep(max(self._next - time.monotonic(), 0.0))
