"""Who commands, and how a flight ends: stopped, landed, disarmed.

Who ends a flight:
- the operator's Stop, Land: ``Operator.stop``, ``Operator.land`` -> ``FlightEnd.stop``, ``land``;
- the client itself: ``Commander.stop_own``, ``land_own`` -> ``FlightEnd.stop``, ``land_or_stop``;
- the failsafe: ``Commander.look`` -> ``Leases.expire`` -> ``FlightEnd.end``: it lands or stops;
- a lease given back, the daemon's end: ``Leases.leave`` -> ``FlightEnd.end``;
- a person who disarms it: ``Operator.arm``; who stops a job: ``Jobs.end_flying``;
- the program that flies: ``programme.reason_to_abort``, ``FlightWatch.reason``, and it asks this
  daemon to land or to stop (``cli/flying.py``);
- the firmware, by limits of its own: no setpoint, tumbled, locked.
What is asked goes on in ``FlightEnd.look`` until the craft says that its motors stand."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import math
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass

from groundstation.errors import BadInputError, LinkError, NotAuthorisedError, TakenError
from groundstation.links.command import (
    CLIMBS_M_S,
    LONGEST_S,
    LOOK_S,
    TUMBLED,
    CommandLink,
    CommandState,
    Landing,
    Place,
)
from groundstation.service import requests
from groundstation.service.config import FailsafeConfig

# Stopping means stopped: zero thrust goes on, and more is tried, until the craft says that its
# motors stand; what is said of them is what its own log says.


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
    is_done: bool = False

    @property
    def told(self) -> str:
        """What the craft has said of its motors so far: ``STOPPED`` where they stand."""
        return STOPPED if self.stopped else STILL_TURN if self.stopped is False else NOT_TOLD


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


# Landing a craft whose client is gone, has asked for it, or is not wanted any more: level, slowly,
# and motors off at the ground. It depends on the failsafe's clock alone.


TILT_MOST_DEG = 50.0
"""A craft that leans further does not fly level any more: no setpoint lands it."""
SILENT_S = 1.0
"""Without word of where it is for so long, nobody knows what a craft does."""
GRACE_S, STALE_S = 0.3, 1.7
"""A process that stood still hears within this what its craft said meanwhile, where it did not
stand still for longer than that: then nobody knows whether the craft still flies."""
CLEAR_M = 0.3
"""One that is asked for as much has left the floor, and is not asked to rise."""
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
        return self.over and (self.stop is None or self.stop.is_done)

    @property
    def told(self) -> str:
        """``LANDED``, or what the craft has said of its motors so far."""
        if self.stop is None:
            return NOT_TOLD if self.over else LANDS
        return LANDED if self.landed and self.stop.told == STOPPED else self.stop.told


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


async def outcome(ended: Stop | Descent) -> str:
    """What became of motors that were asked to stop, or of a landing, in words, as soon as that is
    known and in bounded time: ``LANDED``, or what the craft says of its motors."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + SEEN_S + (LONGEST_S if isinstance(ended, Descent) else 0.0)
    while not ended.is_done and loop.time() < end_s:
        await asyncio.sleep(LOOK_S)
    return ended.told


# One client's right to command, and whose it is at the moment.


FAILSAFE = "dead man"
"""The author of the failsafe's setpoints and events, as recordings of every version call it."""


@dataclass(slots=True)
class Lease:
    """Times are monotonic. craft: which it is for. ended: why it is over, empty while it is in
    force. stop, descent: of its motors, and of its craft, the last ones. announced: what its client
    is about to do, and when."""

    client: str
    token: str
    craft: str
    heard_s: float
    """When the client last said anything."""
    setpoint_s: float = 0.0
    """When its last setpoint was made."""
    thrust: int = 0
    height_m: float | None = None
    hovers: bool = False
    """Whether it asked for a velocity over the ground."""
    levelled: bool = False
    """By the failsafe."""
    held_level: bool = False
    """By the operator."""
    flew: bool = False
    """Whether motors ever ran for it."""
    ended: str = ""
    stop: Stop | None = None
    descent: Descent | None = None
    announced: tuple[str, float] | None = None

    @property
    def flies(self) -> bool:
        """Whether motors run for it."""
        return bool(self.thrust) or self.height_m is not None

    def steer(self, made_s: float, thrust: int, height_m: float | None, hovers: bool) -> None:
        """Its client has sent a setpoint that was made at ``made_s``."""
        self.setpoint_s, self.levelled = made_s, False
        self.thrust, self.height_m, self.hovers = thrust, height_m, hovers
        self.flew |= self.flies
        if self.flies:
            self.announced = None

    def end_climb(self, place: Place | None) -> None:
        """One whose client fell silent as it took off is asked for the height that it has climbed
        to: asked for less, it would sink to the floor too fast."""
        if self.height_m is not None and place is not None and place.vz_m_s > CLIMBS_M_S:
            self.height_m = max(self.height_m, min(place.z_m, CLEAR_M))

    def set_down(self) -> None:
        self.thrust, self.height_m, self.hovers = 0, None, False

    def is_of(self, token: str) -> bool:
        return hmac.compare_digest(self.token.encode(), token.encode())

    def wants_level(self, now_s: float, limits: FailsafeConfig) -> bool:
        """Whether its client was silent in flight for too long to be leant on."""
        return self.flies and now_s - self.setpoint_s >= limits.level_s

    def has_vanished(self, now_s: float, limits: FailsafeConfig) -> bool:
        """Whether its client was silent in flight for so long that motors must stop."""
        return self.flies and now_s - self.setpoint_s >= limits.stop_s

    def has_lapsed(self, now_s: float, limits: FailsafeConfig) -> bool:
        """Whether its client was silent on the ground for too long to keep others out."""
        return not self.flies and now_s - self.heard_s >= limits.lease_s


class Leases:
    """The lease in force, one at a time, what ends it, and the one before it. Who uses it holds a
    lock.

    note: told (kind, text). end_flight: lands the craft of a lease in the name of a client, or
    stops its motors where that cannot be; whether it lands. turns: whether motors still do, as far
    as the craft says, and nobody lands it.
    """

    def __init__(
        self, note: Note, end_flight: Callable[[Lease, str], bool], turns: Callable[[], bool]
    ) -> None:
        self.present: Lease | None = None
        self.vanished = 0  # clients, in flight
        self._note, self._end_flight, self._turns = note, end_flight, turns
        self._former: Lease | None = None

    @property
    def client(self) -> str | None:
        """Who commands at the moment."""
        return None if self.present is None else self.present.client

    def begin(self, client: str, craft: str, now_s: float) -> Lease:
        """Raises TakenError where another client commands."""
        if self.present is not None:
            raise TakenError(f"{self.present.client} is commanding; one client at a time")
        self.present = Lease(client, secrets.token_urlsafe(24), craft, now_s)
        return self.present

    def of(self, token: str, now_s: float) -> Lease:
        """The lease in force, of the client that shows its token and is heard by that. Raises
        NotAuthorisedError, which says why the client's own is over."""
        lease, former = self.present, self._former
        if lease is not None and lease.is_of(token):
            lease.heard_s = now_s
            return lease
        if former is not None and former.is_of(token):
            raise NotAuthorisedError(f"{former.ended}; acquire a lease")
        raise NotAuthorisedError("this token is not (or no more) in force; acquire a lease")

    def former(self, token: str) -> Lease | None:
        """The lease that was the last one, of the client that shows its token."""
        former = self._former
        is_last = self.present is None and former is not None and former.is_of(token)
        return former if is_last else None

    def expire(self, now_s: float, limits: FailsafeConfig) -> None:
        """End the lease in force where its time is over, whoever notices first."""
        lease = self.present
        if lease is None:
            return
        if lease.has_vanished(now_s, limits):
            self.vanished += 1
            lands = self._end_flight(lease, FAILSAFE)
            what = LANDS if lands else "its motors are asked to stop"
            done = "the craft is landed" if lands else "the failsafe has asked the motors to stop"
            self.end(
                f"{lease.client} has vanished: {what}",
                kind="fault",
                why=f"no setpoint came in time: {done}",
            )
        elif lease.has_lapsed(now_s, limits):
            text = f"{lease.client} was silent for {limits.lease_s:g} s: its lease is over"
            self.leave(text, FAILSAFE, why=text)

    def leave(self, text: str, client: str, *, why: str = "the lease is over") -> None:
        """End the lease in force and, in the name of ``client``, land what flies for it, or stop
        what goes on turning at zero thrust, as assist modes and armed brushless motors do."""
        lease = self.present
        if lease is not None:
            if lease.flies or (lease.flew and self._turns()):
                self._end_flight(lease, client)
            self.end(text, why=why)

    def end(self, text: str, *, kind: str = "command", why: str) -> None:
        """The lease in force, if there is one, is over. why: what its client is told."""
        lease, self.present = self.present, None
        if lease is not None:
            lease.ended, self._former = why, lease
        self._note(kind, text)


def identity_of(link: CommandLink) -> requests.CraftIdentity:
    """Which craft it is, as far as it says so."""
    return requests.CraftIdentity(
        uri=link.uri, vehicle=link.vehicle, firmware=link.firmware, id=link.craft_id
    )


# Asking a craft to arm its motors, to disarm them or to recover from a crash, until it has
# answered.


ANSWER_S = 2.0
"""A craft that has not answered a request to arm by then does not."""
STATE_S = 0.3
"""After so long the craft has said what state it is in, and has left one that passes."""
CHECKS_S = 3.0
"""A craft that was just switched on has passed its checks before flight by then: it measures its
gyro's bias first."""


Turn = Callable[[], AbstractContextManager[None]]


class Asking:
    """One request at a time: each ends the one before it, which then sends nothing more.

    lock: held while one is sent and while one is ended."""

    def __init__(self, lock: threading.RLock) -> None:
        self._lock = lock
        self._number = 0

    def begin(self) -> Turn:
        """What the new request sends under. It raises TakenError once that is over."""
        with self._lock:
            self._number += 1
            number = self._number

        @contextlib.contextmanager
        def turn() -> Iterator[None]:
            with self._lock:
                if number != self._number:
                    raise TakenError("a stop or another such request has ended this one")
                yield

        return turn

    def end(self) -> None:
        """Nothing is asked for any more."""
        with self._lock:
            self._number += 1


async def ask_to_arm(link: CommandLink, on: bool, turn: Turn = contextlib.nullcontext) -> None:
    """Arm the motors or disarm them, and wait for the craft's answer.

    Raises BadInputError for a firmware that knows no arming, LinkError where it refuses or does
    not answer, and what ``turn`` does."""
    word = "arm" if on else "disarm"
    if on and link.supervisor.trouble:
        raise LinkError(f"the craft refuses to arm its motors: {link.supervisor.trouble}")
    asked_s = _now_s()
    while not (await _armed(link, on, turn) and await _is_seen(link, on)):
        waited_s = _now_s() - asked_s
        await asyncio.sleep(STATE_S)  # its state may not be known yet, or be about to pass
        if link.supervisor.trouble or waited_s > CHECKS_S:
            why = link.supervisor.refusal
            raise LinkError(f"the craft refuses to {word} its motors{why and ': '}{why}")
    if not on and link.supervisor.arms_itself:
        raise LinkError(
            "the craft was disarmed and has armed itself again, as a brushed one does: its"
            " motors are stopped by `groundstation motors stop`"
        )


async def ask_to_recover(link: CommandLink, turn: Turn = contextlib.nullcontext) -> None:
    """Let a craft that calls itself crashed be ready again, and wait until it says so.

    Raises BadInputError for one that has not crashed, LinkError where it does not recover."""
    if not link.supervisor.crashed:
        raise BadInputError("the craft does not say that it has crashed: nothing to recover from")
    asked_s = _now_s()
    while (said := link.supervisor).crashed:
        if said.tumbled:
            raise LinkError(TUMBLED)
        if _now_s() - asked_s > ANSWER_S:
            raise LinkError("the craft still calls itself crashed: switch it off and on")
        with turn():
            link.recover()  # again, for a request may be lost
        await asyncio.sleep(STATE_S)
    if said.bits is None:
        raise LinkError(f"{link.uri} is not connected any more: look at the craft")


async def _armed(link: CommandLink, on: bool, turn: Turn) -> bool:
    """Whether the craft does as it is asked; raises as ``ask_to_arm``."""
    with turn():
        is_known = link.arm(on)
    if not is_known:
        raise BadInputError("this craft's firmware knows no arming: thrust starts its motors")
    asked_s = _now_s()
    while link.armed is None and _now_s() - asked_s < ANSWER_S:
        await asyncio.sleep(LOOK_S)
    if link.armed is None:
        word = "arm" if on else "disarm"
        raise LinkError(f"{link.uri} has not answered the request to {word} its motors")
    return link.armed is on


async def _is_seen(link: CommandLink, on: bool) -> bool:
    """Whether the craft's own log says so too, where it has one: a firmware that runs in software
    answers every request by repeating it."""
    if on and link.supervisor.bits is not None:
        await asyncio.sleep(2 * STATE_S)
    return link.armed is on


def _now_s() -> float:
    return asyncio.get_running_loop().time()


# How a flight ends, whoever ends it: the craft is landed, or its motors are stopped at once.


FRESH_S, RESTS_S = 0.5, 1.5
"""How old what a craft says of its motors may be, where they must stand, and how long ago they must
have been asked to turn: the radio may have taken that late."""
LATE_S = 1.7
"""So long after the last setpoint nothing is landed: the firmware stops the motors after 2 s, and
nobody knows where a craft is that fell. A daemon that stood still comes so late."""


class FlightEnd:
    """The stop, the landing and the zero thrust after a flight, each of one craft at a time: they
    stay with the craft that they began on. Who uses it holds a lock.

    motors: what the telemetry says of the motors of a craft, None where it does not. note: told
    (kind, text). asking: what is asked of the craft besides, which a stop ends. clock: monotonic,
    s. held: why no motor may begin, in words, or empty.
    """

    def __init__(
        self,
        motors: Callable[[CommandLink], Motors | None],
        note: Note,
        asking: Asking,
        clock: Callable[[], float],
    ) -> None:
        self._motors, self._note, self._asking, self._clock = motors, note, asking, clock
        self.held, self._begun_s = "", -math.inf
        self._stop: Stop | None = None  # of motors that are not known to have stopped
        self._descent: Descent | None = None  # that goes on
        self._settling: CommandLink | None = None  # gets zero thrust, in the name of ``_client``
        self._client, self._zero_until_s = "", 0.0

    # -- what goes on ----------------------------------------------------------------------

    @property
    def lands(self) -> bool:
        """Whether a craft is being landed."""
        return self._descent is not None

    @property
    def doing(self) -> str:
        """What is going on, in words, or empty."""
        if self.lands:
            return LANDS
        return self.held if self._stop is None else "the motors are being stopped"

    def begun(self) -> None:
        """Motors are asked to turn."""
        self._begun_s = self._clock()

    def drives(self, link: CommandLink | None) -> bool:
        """Whether the craft says that its motors turn, and nobody lands it."""
        return link is not None and self._duty(link) > 0.0 and not self.lands

    def turns(self, link: CommandLink) -> bool:
        """Whether motors turn, as far as the craft says."""
        return link.supervisor.flies or self._duty(link) > 0.0

    def _duty(self, link: CommandLink) -> float:
        said = self._motors(link)
        return 0.0 if said is None else said.duty

    def is_still(self, link: CommandLink) -> bool:
        """Whether the craft itself says just now that its motors stand and that it does not fly,
        and nothing is going on that may turn them."""
        said = self._motors(link)
        stands = said is not None and said.age_s <= FRESH_S and said.duty == 0.0
        late = self._clock() - self._begun_s < RESTS_S
        goes_on = link.supervisor.flies or self.lands or self._stop is not None
        return stands and not (late or goes_on)

    def require_none(self, refused: str) -> None:
        """Raises TakenError while one goes on. refused: what then was not done."""
        if self.doing:
            raise TakenError(f"{self.doing}: {refused}")

    def goes_on(self, now_s: float) -> bool:
        """Whether one is not known to be over, or zero thrust has to go on."""
        return self.lands or self._stop is not None or self._settles(now_s)

    def _settles(self, now_s: float) -> bool:
        """Whether zero thrust has to go on: a craft that takes itself for flying is locked by its
        firmware where setpoints cease."""
        late_s, link = now_s - self._zero_until_s, self._settling
        flies = link is not None and link.supervisor.flies
        return link is not None and (late_s < 0.0 or (flies and late_s < FLIES_ON_S))

    # -- what is asked for -----------------------------------------------------------------

    def settle(self, link: CommandLink, now_s: float, client: str) -> None:
        """A client that flew has asked for zero thrust: it goes on as long as the craft needs."""
        self._settling, self._client = link, client
        self._zero_until_s = now_s + link.settles_s

    def cancel_zero(self) -> None:
        """Zero thrust need not go on: motors are to run, or the craft is left."""
        self._settling, self._zero_until_s = None, 0.0

    def stop(self, link: CommandLink, lease: Lease | None, client: str) -> Stop:
        """Stop the motors at once, in the name of ``client``; lease: that in force."""
        self._asking.end()
        stop = self._ask_to_stop(link, client)
        self._end_descent(stop)
        if lease is not None:
            lease.set_down()
            lease.stop, lease.descent = stop, None
        return stop

    def _ask_to_stop(self, link: CommandLink, client: str) -> Stop:
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

    def land(self, link: CommandLink, lease: Lease | None, client: str) -> Descent | Stop:
        """Land the craft that flies for a lease, in the name of ``client``; a landing that runs
        goes on. Where none flies no motor is begun, for the craft may be in somebody's hand: they
        are stopped.

        Raises BadInputError where it cannot be landed, TakenError while its motors are being
        stopped."""
        descent = self._descent
        if descent is None:
            if self._stop is not None:
                raise TakenError("the motors are being stopped: there is nothing to land")
            if trouble := refusal(link, self._clock()):
                raise BadInputError(f"{trouble}: it cannot be landed, its motors can be stopped")
            if lease is None or not lease.flies:
                return self.stop(link, lease, client)
            self._asking.end()
            self.cancel_zero()
            now_s, place = self._clock(), link.supervisor.place
            landing = Landing(now_s, lease.height_m, None if place is None else place.z_m)
            descent = self._descent = Descent(link, client, now_s, landing)
            self._note("landing", f"{LANDS}: level, motors off at the ground")
            self._look_after(descent, now_s)
        if lease is not None:
            lease.set_down()
            lease.descent = descent
        return descent

    def land_or_stop(self, link: CommandLink, lease: Lease) -> None:
        """As its client wishes: land its craft, or stop its motors where that cannot be."""
        try:
            self.land(link, lease, lease.client)
        except BadInputError as error:
            self._note("fault", str(error))
            self.stop(link, lease, lease.client)
        except TakenError:  # they are being stopped
            lease.descent = None

    def end(self, link: CommandLink | None, lease: Lease, client: str) -> bool:
        """End what runs for a lease that is over; whether the craft is landed."""
        if link is None:
            return False
        if lease.descent is not None and not lease.descent.over:
            return True
        now_s = self._clock()
        lands = lease.flies and now_s - lease.setpoint_s <= LATE_S and self._stop is None
        if lands and not refusal(link, now_s, waits=True):
            self.land(link, lease, client)
            return True
        self.stop(link, lease, client)
        return False

    def give_up(self) -> None:
        """The craft is left: who waits for what becomes of it is told that nobody knows."""
        self._end_descent(None)
        self.cancel_zero()
        if self._stop is not None:
            self._end_stop(self._stop, stopped=None)

    # -- what the time demands -------------------------------------------------------------

    def look(self, now_s: float, *, repeat: bool) -> None:
        """Do what the time demands. repeat: whether nobody else sends setpoints."""
        if self._descent is not None:
            self._look_after(self._descent, now_s)
        if self._settling is not None and repeat and not self.lands and self._settles(now_s):
            send_level(self._settling, 0, self._client)
        if self._stop is not None:
            self._watch(self._stop, now_s)

    def _look_after(self, descent: Descent, now_s: float) -> None:
        """Send the next height of a landing, or end it."""
        link = descent.link
        place = link.supervisor.place
        if trouble := refusal(link, now_s, waits=now_s - descent.begun_s < GRACE_S):
            self._note("fault", f"{trouble}: it cannot be landed, its motors are asked to stop")
        else:
            said = {} if place is None else {"measured_m": place.z_m, "climb_m_s": place.vz_m_s}
            height_m = descent.landing.tick(now_s, **said)
            if height_m is not None:
                send_level(link, 0, descent.client, height_m, hovers=link.holds_place)
                return
            descent.landed = True
            self._note("landing", f"the craft has landed: {descent.landing.over}")
        self._descent = None
        descent.stop, descent.over = self._ask_to_stop(link, descent.client), True

    def _end_descent(self, stop: Stop | None) -> None:
        """A landing ends here; stop: of the motors, which are being stopped."""
        descent, self._descent = self._descent, None
        if descent is not None:
            descent.stop, descent.over = stop, True

    def _watch(self, stop: Stop, now_s: float) -> None:
        """Say that motors have stopped when the craft says so, and not before."""
        waited_s, said = now_s - stop.asked_s, self._motors(stop.link)
        # when the craft said so, behind the request; what it said before tells nothing
        said_s = -1.0 if said is None else waited_s - said.age_s
        if said is not None and said_s > 0.0 and said.duty <= 0.0 and _is_disarmed(stop, waited_s):
            self._note("command", f"motors stopped, {waited_s:.2f} s after they were asked to")
            self._end_stop(stop, stopped=True)
        elif waited_s > max(said_s, 0.0) + UNSEEN_S:
            self._note("fault", NOT_TOLD)
            self._end_stop(stop, stopped=None)
        elif said_s > STILL_S * (stop.forced + 1):
            stop.forced += 1
            self._settling = stop.link
            self._zero_until_s = max(self._zero_until_s, now_s + ENDS_S)
            self._note("fault", f"{STILL_TURN}: {_forced(stop)}")

    def _end_stop(self, stop: Stop, *, stopped: bool | None) -> None:
        self._stop, stop.stopped, stop.is_done = None, stopped, True
