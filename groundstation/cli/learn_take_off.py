"""Before each take-off of ``learn``: a craft that stands, a full battery, a countdown."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

from groundstation import GroundStationError, Pilot
from groundstation.cli.commanding import LOOK_S, require_ready
from groundstation.control.programme import Standing, trouble_of
from groundstation.links.command import NOT_ARMED

WAIT_S = 600.0
"""How long a craft that stands, or a full battery, is waited for."""
COUNTDOWN_S = 10
"""From the announcement to the take-off: enough to step back, or to press Stop."""
FULL_V, CLEAR_S = 4.0, 15.0
"""A full cell at rest, and how long the craft must stand still: whoever changed it needs time to
step back."""


def await_take_off(pilot: Pilot, flight: str, told: Callable[[str], None]) -> float:
    """Wait for a craft that stands still, level and on the floor, count down, and give its own
    height there, m. Raises GroundStationError where none stands within ``WAIT_S``.

    told: given each reason to wait once, and the countdown.
    """
    deadline, said = time.monotonic() + WAIT_S, set[str]()
    while True:
        _await_standing(pilot, deadline, said, told)
        told(f"{flight}: take-off in {COUNTDOWN_S} s. Ctrl-C cancels.")
        pilot.announce(f"learn: take-off for {flight}", COUNTDOWN_S)
        until = time.monotonic() + COUNTDOWN_S
        while time.monotonic() < until:
            answer = pilot.setpoint(0.0, 0.0, 0.0, 0)
            if trouble_of(answer):
                pilot.announce("take-off cancelled", 0.0)
                told("take-off cancelled: the craft does not stand still any more")
                break
            time.sleep(LOOK_S)
        else:
            return float(answer["height_m"] or 0.0)


def _await_standing(
    pilot: Pilot, deadline: float, said: set[str], told: Callable[[str], None]
) -> None:
    standing = Standing()
    while not standing.look(time.monotonic(), pilot.setpoint(0.0, 0.0, 0.0, 0)):
        why = standing.trouble
        kind = why.partition("(")[0].partition(" by ")[0]
        if why and kind not in said:
            said.add(kind)
            told(f"waiting for the craft: {why}")
        if time.monotonic() > deadline:
            raise GroundStationError(
                f"the craft did not stand ready within {WAIT_S / 60:.0f} min"
                f"{': ' + why if why else ''}; the same command goes on"
            )
        time.sleep(LOOK_S)


def await_battery(
    commanded: Callable[[], AbstractContextManager[Pilot]], require_calm: Callable[[], None]
) -> None:
    """Wait for a craft with a full battery that stands still. Raises GroundStationError where none
    comes within ``WAIT_S``, or as ``require_calm`` does.

    commanded: the lease on the craft, anew each time, for it is switched off meanwhile.
    """
    still = time.monotonic()
    deadline = still + WAIT_S
    while time.monotonic() - still < CLEAR_S:
        require_calm()
        full = False
        with contextlib.suppress(GroundStationError), commanded() as pilot:
            telemetry = require_ready(pilot, needs_battery=True, may_be_disarmed=True)
            stands = trouble_of(pilot.setpoint(0.0, 0.0, 0.0, 0)) in ("", NOT_ARMED)
            full = telemetry["battery_v"] >= FULL_V and stands
        if not full:
            still = time.monotonic()
        if time.monotonic() > deadline:
            raise GroundStationError(
                f"no craft with a battery of {FULL_V:g} V and more that stood still for"
                f" {CLEAR_S:g} s came within {WAIT_S / 60:.0f} min; put a full one in, and"
                " the same command goes on"
            )
        time.sleep(1.0)
