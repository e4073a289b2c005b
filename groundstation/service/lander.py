"""Landing a craft whose client is gone, has asked for it, or is not wanted any more: level, slowly,
and motors off at the ground. It depends on the failsafe's clock alone."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.links.command import LONGEST_S, LOOK_S, CommandLink, CommandState, Landing
from groundstation.service.motor_stop import NOT_TOLD, SEEN_S, STOPPED, Note, Stop, send_level

TILT_MOST_DEG = 50.0
"""A craft that leans further does not fly level any more: no setpoint lands it."""
SILENT_S = 1.0
"""Without word of where it is for so long, nobody knows what a craft does."""
GRACE_S, STALE_S = 0.3, 1.7
"""A process that stood still hears within this what its craft said meanwhile, where it did not
stand still for longer than that: then nobody knows whether the craft still flies."""
LANDED = "landed"
LANDS = "the craft is being landed"


@dataclass(slots=True)
class Descent:
    """The landing of one craft, in the name of ``client``. stop: of its motors, once they were
    asked to. landed: whether it came to its end; False where motors were stopped before."""

    link: CommandLink
    client: str
    begun_s: float
    landing: Landing
    stop: Stop | None = None
    landed: bool = False
    over: bool = False

    @property
    def is_done(self) -> bool:
        return self.over and (self.stop is None or self.stop.over)

    @property
    def told(self) -> str:
        """``LANDED``, or what the craft has said of its motors so far."""
        if self.stop is None:
            return NOT_TOLD if self.over else LANDS
        return LANDED if self.landed and self.stop.told == STOPPED else self.stop.told


class Lander:
    """The landing of one craft at a time. Who uses it holds a lock.

    note: told (kind, text). stop: stops the motors of a craft in the name of a client. clock:
    monotonic, s.
    """

    def __init__(
        self,
        note: Note,
        stop: Callable[[CommandLink, str], Stop],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._note, self._stop, self._clock = note, stop, clock
        self._present: Descent | None = None

    @property
    def runs(self) -> bool:
        return self._present is not None

    @property
    def present(self) -> Descent | None:
        """The landing that goes on."""
        return self._present

    def begin(self, link: CommandLink, client: str, height_m: float | None) -> Descent:
        """Land a craft that flies, of which ``refusal`` says nothing. height_m: that it was asked
        for last."""
        now_s, place = self._clock(), link.supervisor.place
        measured_m = None if place is None else place.z_m
        descent = Descent(link, client, now_s, Landing(now_s, height_m, measured_m))
        self._present = descent
        self._note("landing", f"{LANDS}: level, motors off at the ground")
        self.look(now_s)
        return descent

    def cancel(self, stop: Stop | None = None) -> None:
        """It ends here: motors are being stopped instead."""
        descent, self._present = self._present, None
        if descent is not None:
            descent.stop, descent.over = stop, True

    def look(self, now_s: float) -> None:
        """Send what the time demands, or end it."""
        descent = self._present
        if descent is None:
            return
        link = descent.link
        place = link.supervisor.place
        begun_s = now_s - descent.begun_s
        if trouble := refusal(link, now_s, waits=begun_s < GRACE_S):
            self._note("fault", f"{trouble}: it cannot be landed, its motors are asked to stop")
        else:
            said = {} if place is None else {"measured_m": place.z_m, "climb_m_s": place.vz_m_s}
            height_m = descent.landing.tick(now_s, **said)
            if height_m is not None:
                send_level(link, 0, descent.client, height_m, hovers=link.holds_place)
                return
            descent.landed = True
            self._note("landing", f"the craft has landed: {descent.landing.over}")
        self._present = None
        descent.stop, descent.over = self._stop(link, descent.client), True


def refusal(link: CommandLink, now_s: float, *, waits: bool = False) -> str:
    """Why a craft cannot be landed, or empty. waits: whether it may be silent for the moment."""
    place = link.supervisor.place
    if link.state is not CommandState.CONNECTED:
        return f"{link.uri} is not connected ({link.state.value})"
    if not link.holds_height:
        return "the craft holds no height"
    if place is None or now_s - place.heard_s > (STALE_S if waits else SILENT_S):
        return "the craft does not say where it is"
    if not place.tilt_deg < TILT_MOST_DEG:
        return f"the craft leans by {place.tilt_deg:.0f} degrees"
    return ""


async def outcome_of(descent: Descent) -> str:
    """What became of a landing, in words, as soon as that is known: ``LANDED``, or what the craft
    says of its motors."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + LONGEST_S + SEEN_S
    while not descent.is_done and loop.time() < end_s:
        await asyncio.sleep(LOOK_S)
    return descent.told
