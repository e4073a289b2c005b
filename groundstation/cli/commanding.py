"""Around everything that turns motors: connection, telemetry, recording, an end that holds."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from groundstation import BadInputError, GroundStationError, Pilot
from groundstation.cli.terminal import require_yes, say
from groundstation.links.command import NOT_ARMED
from groundstation.service.client import ask
from groundstation.service.lease import BY_OPERATOR, LANDED_BY_OPERATOR

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
    """A daemon that has just started connects within seconds; a refusal is a refusal."""
    deadline = time.monotonic() + CONNECT_S
    while True:
        status = ask(path, "GET", "/status")
        command = status.get("command")
        if command is None or command["state"] not in ("connecting", "closed"):
            return
        if status["link"]["name"].startswith("replay:"):
            return  # it never will
        if time.monotonic() > deadline:
            return
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
    from groundstation.control.programme import AbortLimits

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


def require_ended(report: Mapping[str, Any], what: str) -> None:
    """Raises GroundStationError for a report of what was cut short: why, how the motors are, and
    where the recording is."""
    for words, by_operator in (("Stopped", BY_OPERATOR), ("Landed", LANDED_BY_OPERATOR)):
        if report["aborted"] == by_operator:
            raise GroundStationError(
                f"{words} by the operator, {report['motors'].replace('are off', 'off')};"
                f" the recording is {report['recording']}"
            )
    if report["aborted"]:
        raise GroundStationError(
            f"{what} aborted: {report['aborted']}; {report['motors']}, the recording is"
            f" {report['recording']}"
        )


def why_aborted(error: GroundStationError) -> str:
    """What a flight that ended so is told to have been cut short by."""
    return str(error).removesuffix(ACQUIRE)


def require_standing(pilot: Pilot) -> None:
    """Watch a craft for some seconds. Raises GroundStationError where it does not stand still,
    level and, where it knows its height, on the floor."""
    from groundstation.control.programme import STAND_S, Standing

    standing = Standing()
    deadline = time.monotonic() + STAND_S + STAND_MORE_S
    while not standing.look(time.monotonic(), pilot.setpoint(0.0, 0.0, 0.0, 0)):
        if time.monotonic() > deadline:
            why = standing.trouble or "it has moved"
            raise GroundStationError(f"the craft does not stand: {why}; nothing was flown")
        time.sleep(LOOK_S)


def begin_recording(path: Path) -> dict[str, Any]:
    """A recording of this flight alone."""
    running = ask(path, "GET", "/status")["recording"]
    was_on = running["file"] is not None and running.get("state") not in ("off", "finished")
    if was_on:
        ask(path, "POST", "/record/stop")
    return {"was_on": was_on, **ask(path, "POST", "/record/start")}


def end_recording(path: Path, recording: dict[str, Any], aborted: str) -> str:
    """The file of this flight; a recording that ran before it goes on in a new one."""
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
