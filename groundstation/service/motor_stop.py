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
BY_OPERATOR = "the operator has stopped the motors"
LANDED_BY_OPERATOR = "the operator has landed the craft"
"""Why a lease ended, as its client is told."""
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
class Stop:
    """Motors of one craft that were asked to stop, at ``asked_s``. forced: how often more than zero
    thrust was tried. disarms: whether it was asked to disarm, too. stopped: whether they were seen
    to; None: there is no telemetry that says so."""

    link: CommandLink
    asked_s: float
    disarms: bool = False
    forced: int = 0
    stopped: bool | None = False
    over: bool = False

    @property
    def told(self) -> str:
        """What the craft has said of its motors so far: ``STOPPED`` where they stand."""
        return STOPPED if self.stopped else STILL_TURN if self.stopped is False else NOT_TOLD


class Stopping:
    """The stop of one craft's motors, where one was asked for, and the zero thrust after a flight.
    Both stay with the craft that they began on.

    motors: what the telemetry says of the motors of a craft, None where it does not. note: told
    (kind, text). clock: monotonic, s.
    """

    def __init__(
        self,
        motors: Callable[[CommandLink], Motors | None],
        note: Note,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._motors, self._note, self._clock = motors, note, clock
        self._client = ""
        self._stop: Stop | None = None
        self._settling: CommandLink | None = None
        self._zero_until_s = 0.0  # zero thrust is repeated until then

    @property
    def runs(self) -> bool:
        """Whether motors were asked to stop and are not known to have done so."""
        return self._stop is not None

    def ask(self, link: CommandLink, client: str) -> Stop:
        """Stop the motors of a craft, in the name of ``client``."""
        now_s = self._clock()
        self.settle(link, now_s, client)
        self._zero_until_s = max(self._zero_until_s, now_s + ENDS_S)
        stop = self._stop
        if stop is None or stop.link is not link:
            # one that runs goes on: asked again and again it must not begin anew
            stop = self._stop = Stop(link, now_s)
        link.withdraw_arming()
        send_level(link, 0, client)
        with contextlib.suppress(LinkError):  # gone: its own limits stop it
            # where motors have to be armed, they idle until they are disarmed
            stop.disarms |= link.disarms_in_flight and link.arm(False)
            cleared = link.clear_assists()
            if cleared:
                text = f"{', '.join(cleared)} set to 0: it would keep the motors running"
                self._note("command", text)
        return stop

    def settle(self, link: CommandLink, now_s: float, client: str) -> None:
        """A client that flew has asked for zero thrust: it goes on as long as the craft needs."""
        self._settling, self._client = link, client
        self._zero_until_s = now_s + link.settles_s

    def cancel(self) -> None:
        """Zero thrust need not go on: motors are to run, or the craft is left."""
        self._settling, self._zero_until_s = None, 0.0

    def goes_on(self, now_s: float) -> bool:
        """Whether a stop is not known to be over, or zero thrust has to go on."""
        return self.runs or self._settles(now_s)

    def look(self, now_s: float, *, repeat: bool) -> None:
        """Do what the time demands. repeat: whether nobody else sends setpoints."""
        if self._settling is not None and repeat and self._settles(now_s):
            send_level(self._settling, 0, self._client)
        if self._stop is not None:
            self._watch(self._stop, now_s)

    def _settles(self, now_s: float) -> bool:
        """Whether zero thrust has to go on: a craft that takes itself for flying is locked by its
        firmware where setpoints cease."""
        late_s, link = now_s - self._zero_until_s, self._settling
        flies = link is not None and link.supervisor.flies
        return link is not None and (late_s < 0.0 or (flies and late_s < FLIES_ON_S))

    def _watch(self, stop: Stop, now_s: float) -> None:
        """Say that motors have stopped when the craft says so, and not before."""
        waited_s, said = now_s - stop.asked_s, self._motors(stop.link)
        # when the craft said so, behind the request; what it said before tells nothing
        said_s = -1.0 if said is None else waited_s - said.age_s
        if said is not None and said_s > 0.0 and said.duty <= 0.0 and _is_disarmed(stop, waited_s):
            self._note("command", f"motors stopped, {waited_s:.2f} s after they were asked to")
            self._end(stop, stopped=True)
        elif waited_s > max(said_s, 0.0) + UNSEEN_S:
            self._note("fault", NOT_TOLD)
            self._end(stop, stopped=None)
        elif said_s > STILL_S * (stop.forced + 1):
            stop.forced += 1
            self._settling = stop.link
            self._zero_until_s = max(self._zero_until_s, now_s + ENDS_S)
            self._note("fault", f"{STILL_TURN}: {_forced(stop)}")

    def give_up(self) -> None:
        """The craft is left: nobody hears any more what becomes of its motors."""
        self.cancel()
        if self._stop is not None:
            self._end(self._stop, stopped=None)

    def _end(self, stop: Stop, *, stopped: bool | None) -> None:
        self._stop, stop.stopped, stop.over = None, stopped, True


async def outcome(stop: Stop) -> str:
    """What the craft says of motors that were asked to stop, in words, as soon as it does and after
    ``SEEN_S`` at the latest: ``STOPPED`` where they stand."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + SEEN_S
    while not stop.over and loop.time() < end_s:
        await asyncio.sleep(LOOK_S)
    return stop.told


def _is_disarmed(stop: Stop, waited_s: float) -> bool:
    """Whether motors that stand will not idle again: one that was asked to disarm has said that it
    did, or says nothing of it. One that arms itself stands without thrust all the same."""
    armed = stop.link.armed
    is_asked = stop.disarms and not stop.link.supervisor.arms_itself
    return not is_asked or armed is False or (armed is None and waited_s > STILL_S)


def _forced(stop: Stop) -> str:
    """More than zero thrust; what."""
    with contextlib.suppress(LinkError):
        # disarmed first, for an emergency stop ends the flying; one that arms itself would only
        # stand for a moment
        arms_itself = stop.link.supervisor.arms_itself
        if stop.forced == 1 and not arms_itself and stop.link.arm(False):
            stop.disarms = True
            return "disarmed"
        if stop.forced > 1 and stop.link.emergency_stop():
            return "emergency stop"
    return "asked again"


def send_level(
    link: CommandLink,
    thrust: int,
    client: str,
    height_m: float | None = None,
    until_s: float | None = None,
    hovers: bool = False,
) -> None:
    """A setpoint of level attitude, or of no velocity where the craft ``hovers``, worth sending
    until ``until_s``."""
    still = 0.0 if hovers and height_m is not None else None
    # without the craft, or a height that it knows, there is nothing to be done: its own limits
    # stop it, or the stop that follows
    with contextlib.suppress(LinkError, BadInputError):
        link.setpoint(
            0.0,
            0.0,
            0.0,
            thrust,
            height_m=height_m,
            vx_m_s=still,
            vy_m_s=still,
            client=client,
            until_s=until_s,
        )
