"""How a flight ends: motors that are asked to stop until the craft says that they stand."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundstation import GroundStationError, Pilot
from groundstation.cli.commanding import why_aborted
from groundstation.cli.interrupts import Interrupts
from groundstation.cli.terminal import say
from groundstation.service.lease import STILL_TURN, STOPPED

if TYPE_CHECKING:
    from groundstation.links.software_craft import SoftwareCraft

STOPS, COAST_S = 5, 0.5
"""Zero thrust is sent so often at least, for a radio may lose some; and for so long before more is
done: armed brushless motors idle, and with an assist mode on others turn as well."""
MOTORS_OFF = "motors are off"
NOT_TURNING = (
    "thrust is asked for and no motor turns: a craft that needs arming is armed by `groundstation"
    " motors arm` or on the page (Arm...); after an emergency stop it is switched off and on"
)


@dataclass(frozen=True, slots=True)
class Ended:
    """How a flight ended. why: it was cut short, or empty. motors: what is known of them.
    interrupted: by Ctrl-C or SIGTERM."""

    why: str
    motors: str
    interrupted: KeyboardInterrupt | None = None


def stopped_after(fly: Callable[[], str], pilot: Pilot, signals: Interrupts) -> Ended:
    """Fly what says why it was cut short, and stop the motors behind it, whatever ends it."""
    interrupted: KeyboardInterrupt | None = None
    try:
        with signals.heard():
            why = fly()
    except KeyboardInterrupt as stop:
        why, interrupted = str(stop), stop
        say("stopping the motors", error=True)
    except GroundStationError as error:
        why = why_aborted(error)
    return Ended(why, stop_now(pilot, signals), interrupted)


def stop_now(pilot: Pilot | SoftwareCraft, signals: Interrupts) -> str:
    """``stop_motors``; one interrupt does not keep it from that, a second one does: then the end of
    the lease stops them."""
    with signals.heard(1, "the motors are being stopped; Ctrl-C again leaves it to the daemon"):
        return stop_motors(pilot)


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
