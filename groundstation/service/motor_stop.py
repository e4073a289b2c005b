"""Stopping means stopped: zero thrust goes on, and more is tried, until the craft says that its
motors stand; what is said of them is what its own log says."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.errors import BadInputError, LinkError
from groundstation.links.command import LOOK_S, CommandLink

ENDS_S, FLIES_ON_S = 0.25, 5.0
"""How long zero thrust is sent at an end, for a radio may lose some; how much longer to a craft
that still takes itself for flying."""
STILL_S = 0.5
"""Motors that turn so long after they were asked to stop are disarmed, then stopped by the
firmware's emergency stop, again and again."""
UNSEEN_S, SEEN_S = 2.0, 2.5
"""Without telemetry for so long nobody knows whether they have stopped; how long an operator is
kept waiting for what becomes of them."""
STOPPED = "stopped"
STILL_TURN = "asked to stop, motors still turn"
NOT_TOLD = "asked to stop; no telemetry says whether the motors still turn"

Note = Callable[[str, str], None]


@dataclass(frozen=True, slots=True)
class Motors:
    """What the craft last said of its motors: how long ago, s, and the largest duty."""

    age_s: float
    duty: float


@dataclass(slots=True)
class _Stop:
    """Motors that were asked to stop. forced: how often more than zero thrust was tried. stopped:
    whether they were seen to; None: there is no telemetry that says so."""

    asked_s: float
    forced: int = 0
    stopped: bool | None = False


class Stopping:
    """The stop of one craft's motors, where one was asked for, and the zero thrust after a flight.

    link: the command link of the moment. motors: what the telemetry says of them, None where it
    does not. note: told (kind, text). client: who sends zero thrust until somebody asked.
    """

    def __init__(
        self,
        link: Callable[[], CommandLink | None],
        motors: Callable[[], Motors | None],
        note: Note,
        client: str,
    ) -> None:
        self._link, self._motors, self._note = link, motors, note
        self._client = client
        self._stop: _Stop | None = None
        self._zero_until_s = 0.0  # zero thrust is repeated until then

    def ask(self, client: str) -> None:
        """Stop the motors, in the name of ``client``."""
        now_s, link = time.monotonic(), self._link()
        self.settle(now_s, client)
        self._zero_until_s = max(self._zero_until_s, now_s + ENDS_S)
        self._stop = _Stop(now_s)
        cleared = [] if link is None else link.clear_assists()
        if cleared:
            self._note(
                "command", f"{', '.join(cleared)} set to 0: it would keep the motors running"
            )
        send_level(link, 0, client)
        if link is not None and link.disarms_in_flight:
            # where motors have to be armed, they idle until they are disarmed
            link.arm(False)

    def settle(self, now_s: float, client: str) -> None:
        """A client that flew has asked for zero thrust: it goes on as long as the craft needs."""
        link = self._link()
        settles_s = 0.0 if link is None else link.settles_s
        self._zero_until_s, self._client = now_s + settles_s, client

    def cancel(self) -> None:
        """The motors are to run again."""
        self._stop, self._zero_until_s = None, 0.0

    def goes_on(self, now_s: float) -> bool:
        """Whether a stop is not known to be over, or zero thrust has to go on."""
        return self._stop is not None or self._settles(now_s)

    async def outcome(self) -> str:
        """What the craft says of the motors that were just asked to stop, in words: ``STOPPED``
        where they stand."""
        stop = self._stop
        assert stop is not None
        while stop.stopped is False and time.monotonic() < stop.asked_s + SEEN_S:
            await asyncio.sleep(LOOK_S)
        return STOPPED if stop.stopped else STILL_TURN if stop.stopped is False else NOT_TOLD

    def look(self, now_s: float, *, repeat: bool) -> None:
        """Do what the time demands. repeat: whether nobody else sends setpoints."""
        if repeat and self._settles(now_s):
            send_level(self._link(), 0, self._client)
        self._watch(now_s)

    def _settles(self, now_s: float) -> bool:
        """Whether zero thrust has to go on: a craft that takes itself for flying is locked by its
        firmware where setpoints cease."""
        late_s, link = now_s - self._zero_until_s, self._link()
        flies = link is not None and link.supervisor.flies
        return late_s < 0.0 or (flies and late_s < FLIES_ON_S)

    def _watch(self, now_s: float) -> None:
        """Say that motors have stopped when the craft says so, and not before."""
        stop = self._stop
        if stop is None:
            return
        waited_s, said = now_s - stop.asked_s, self._motors()
        # when the craft said so, behind the request; what it said before tells nothing
        said_s = -1.0 if said is None else waited_s - said.age_s
        if said is not None and said_s > 0.0 and said.duty <= 0.0:
            self._note("command", f"motors stopped, {waited_s:.2f} s after they were asked to")
            self._stop, stop.stopped = None, True
        elif waited_s > max(said_s, 0.0) + UNSEEN_S:
            self._note("fault", NOT_TOLD)
            self._stop, stop.stopped = None, None
        elif said_s > STILL_S * (stop.forced + 1):
            stop.forced += 1
            self._zero_until_s = max(self._zero_until_s, now_s + ENDS_S)
            self._note("fault", f"{STILL_TURN}: {self._forced(stop)}")

    def _forced(self, stop: _Stop) -> str:
        """More than zero thrust; what."""
        link = self._link()
        if link is not None:
            # disarmed first, for an emergency stop ends the flying
            if stop.forced == 1 and link.arm(False):
                return "disarmed"
            if stop.forced > 1 and link.emergency_stop():
                return "emergency stop"
        return "asked again"


def send_level(
    link: CommandLink | None, thrust: int, client: str, height_m: float | None = None
) -> None:
    """A setpoint of level attitude, where there is a craft."""
    if link is not None:
        # without the craft, or a height that it knows, there is nothing to be done: its own limits
        # stop it, or the stop that follows
        with contextlib.suppress(LinkError, BadInputError):
            link.setpoint(0.0, 0.0, 0.0, thrust, height_m=height_m, client=client)
