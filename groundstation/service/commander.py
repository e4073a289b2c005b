"""Who may command the craft: one authorised client at a time, and what happens when it vanishes.

A client acquires a lease and gets a token; nothing leaves for the craft without it. While the
motors run, a setpoint must come often: when none has come for ``level_s`` the daemon levels the
craft, after ``stop_s`` it lands a craft that holds its height, stops the motors of another, and
the lease is over. Both come before the firmware's own limits of 0.5 s and 2 s, which still hold
when the daemon itself is gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator

from groundstation.background import in_background
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    LinkError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.links.base import LinkState
from groundstation.links.command import (
    LIFE_S,
    LONGEST_S,
    CommandLink,
    CommandState,
    Supervisor,
    is_software,
)
from groundstation.service.config import FailsafeConfig, RateLimit
from groundstation.service.lease import (
    BY_OPERATOR,
    FAILSAFE,
    LANDED_BY_OPERATOR,
    SEEN_S,
    STOPPED,
    Asking,
    FlightEnd,
    Lease,
    Leases,
    Motors,
    Note,
    ask_to_arm,
    ask_to_recover,
    identity_of,
    outcome,
    send_level,
)
from groundstation.service.parameters import (
    AGAIN_MOST_S,
    AGAIN_S,
    LOOKS_S,
    Changes,
    CommandConnection,
    Parameters,
    StoredParameters,
    craft_of,
)
from groundstation.service.requests import Lease as Granted

STOOD_S = 0.3
"""A loop that did not turn for so long stood still."""
WAKES_S = 0.5
"""So long after that requests come in that were made before."""
TURN_S = STOOD_S / 3
"""Between two turns that are counted."""


class Readiness:
    """Whether there is a craft that can be commanded, and whether its motors may be asked to turn:
    what waited in sockets while this process stood still has no age but the one it brings along.

    telemetry: state of the telemetry link; why no craft can be commanded with it, or empty.
    contradiction: why what a craft says it is contradicts the configuration, or empty. clock:
    monotonic, s. closing: the daemon ends."""

    def __init__(
        self,
        telemetry: Callable[[], tuple[LinkState, str]],
        contradiction: Callable[[str], str],
        end: FlightEnd,
        clock: Callable[[], float],
    ) -> None:
        self._telemetry, self._contradiction = telemetry, contradiction
        self._end, self._clock = end, clock
        self._turned_s: float | None = None
        self._wakes_until_s = 0.0
        self.closing = False

    @property
    def wanted(self) -> bool:
        """Whether there is a craft behind the telemetry that should be connected."""
        # a stand-in answers only once its link is open
        state, reason = self._telemetry()
        return state is LinkState.STREAMING and not reason and not self.closing

    def turn(self, now_s: float) -> None:
        """The loop that hears requests has turned."""
        if self._stands_still(now_s):
            self._wakes_until_s = now_s + WAKES_S
        self._turned_s = now_s

    def _stands_still(self, now_s: float) -> bool:
        return self._turned_s is not None and now_s - self._turned_s > STOOD_S

    def require_craft(self, what: str) -> None:
        """Raises BadInputError where the craft that is heard is none that can be commanded, or
        will not be for long."""
        reason = "the daemon ends" if self.closing else self._telemetry()[1]
        if reason:
            raise BadInputError(f"no craft can {what}: {reason}")

    def require_vehicle(self, link: CommandLink) -> None:
        """Raises BadInputError where the craft says that it is another than is configured."""
        if reason := self._contradiction(link.vehicle):
            raise BadInputError(reason)

    def require_calm(self, refused: str, made_s: float | None = None) -> None:
        """Raises TakenError while a flight is being ended, LinkError for what is, or may be, too
        old. refused: what then was not done. made_s: when it was asked for, if that was told."""
        self._end.require_none(refused)
        now_s = self._clock()
        if made_s is None:
            if self._stands_still(now_s) or now_s < self._wakes_until_s:
                raise LinkError(f"the daemon stood still, and nobody knows since when: {refused}")
        elif now_s > made_s + LIFE_S:
            raise LinkError(f"the setpoint was made {now_s - made_s:.1f} s ago: too old to be sent")


# What an operator may do to the craft, whoever commands it.


OPERATOR = "operator"


class Operator:
    """stops: counts every Stop and every Land, and is no number of an earlier daemon: a program
    that began before the last of them does not command again. What does not wait is safe to call
    from any thread."""

    def __init__(
        self,
        lock: threading.RLock,
        connection: CommandConnection,
        leases: Leases,
        end: FlightEnd,
        asking: Asking,
        ready: Readiness,
        note: Note,
    ) -> None:
        self.stops = time.time_ns() // 1_000_000
        self._lock, self._connection, self._leases = lock, connection, leases
        self._end, self._asking, self._ready, self._note = end, asking, ready, note

    async def stop(self) -> str:
        """Stop the motors, whoever commands, and end that lease: the operator's way out. What the
        craft then says of them, in words: ``STOPPED`` where they stand. It ends a landing, too.

        Motors that do not stop are asked again, disarmed and stopped by the firmware, as after any
        stop."""
        with self._lock:
            self.stops += 1
            self._asking.end()  # whatever became of the connection
            # a craft that is out of reach is stopped once it is back, if that is soon
            stop = self._end.stop(self._connection.require(), self._leases.present, OPERATOR)
            text = f"the operator stops the motors; {self._former_client()}"
            self._leases.end(text, kind="stop", why=BY_OPERATOR)
            self._connection.require_connected("the stop was not sent")
        return await outcome(stop)

    async def land(self) -> str:
        """Land the craft, whoever commands, and end that lease. ``LANDED``, or what the craft then
        says of its motors, also where nobody flew it: they are stopped then.

        Raises BadInputError for a craft that holds no height, or leans too far, or does not say
        where it is; TakenError while its motors are being stopped."""
        with self._lock:
            link = self._connection.require_connected("the craft was not landed")
            ended = self._end.land(link, self._leases.present, OPERATOR)
            self.stops += 1
            text = f"the operator lands the craft; {self._former_client()}"
            self._leases.end(text, kind="stop", why=LANDED_BY_OPERATOR)
        return await outcome(ended)

    def level(self, on: bool) -> None:
        """Whether attitude and yaw rate of every setpoint are replaced by zero, the client's thrust
        or height kept; until it is switched off or the lease is over. Raises BadInputError where
        nobody commands."""
        lease = self._leases.present
        if lease is None:
            raise BadInputError("nobody commands: there is nothing to hold level")
        if on is not lease.held_level:
            lease.held_level = on
            what = "holds the craft level" if on else "gives the attitude back"
            self._note("level", f"the operator {what}; {lease.client} commands")

    async def arm(self, on: bool) -> None:
        """Arm the motors or disarm them, whoever commands, and wait for the craft's answer.

        Raises BadInputError for a firmware that knows no arming, LinkError where it refuses or
        does not answer, TakenError where a stop or another such request came in between."""
        self._connection.require()
        if on:
            self._ready.require_craft("be armed")
            self._ready.require_calm("the motors were not armed")
            self._end.begun()
        await ask_to_arm(self._connection.require_connected(), on, self._asking.begin())
        kind, does = ("armed", "arms") if on else ("disarmed", "disarms")
        self._note(kind, f"the operator {does} the motors")

    async def recover(self) -> None:
        """Let a craft that calls itself crashed be ready again, and wait until it says so.

        Raises BadInputError for one that has not crashed, TakenError while a client asks for
        thrust, LinkError where it does not recover."""
        lease = self._leases.present
        if lease is not None and lease.flies:
            raise TakenError(f"{lease.client} asks for thrust: motors might turn at once")
        self._ready.require_craft("recover")
        self._ready.require_calm("the craft was not asked to recover")
        await ask_to_recover(self._connection.require_connected(), self._asking.begin())
        self._note("recovered", "the operator has had the craft recover from its crash")

    def _former_client(self) -> str:
        client = self._leases.client
        return "nobody commanded" if client is None else f"{client} commands no more"


SETPOINTS_HZ, SETPOINTS_BURST = 110.0, 100.0
"""100 Hz; a client that was held up for a second may catch up, for the newest replaces the rest."""
WATCH_S, IDLE_S = 0.05, 0.25
"""How often the failsafe looks, and repeats what it sends; where there is no command link."""
LANDING_S = LONGEST_S + SEEN_S
"""How long a client that has its craft landed is waited for."""
STOPPED_SINCE = "Motors were stopped since this program began. Begin it again."


class Commander:
    """The command link and the lease on it. What does not wait is safe to call from any thread:
    the failsafe looks from one of its own, whatever holds the event loop up.

    link: None where the daemon was given no command link.
    note: told (kind, text) of leases and of the failsafe, from any thread.
    telemetry: state of the telemetry link; why no craft can be commanded with it, or empty.
    changes: what was written to crafts, on disk.
    motors: what the telemetry says of those of a link's craft, None where it does not.
    contradiction: why what a craft says it is contradicts the configuration, or empty.
    clock: monotonic, s.

    operator: what is done whoever commands. stored: what crafts keep while they are switched off.

    What refuses raises BadInputError for a value, NotAuthorisedError for a token that is not in
    force, TakenError where another client commands or a stop runs, LinkError where the craft is
    not connected.
    """

    def __init__(
        self,
        link: CommandLink | None,
        limits: FailsafeConfig,
        *,
        note: Note,
        telemetry: Callable[[], tuple[LinkState, str]],
        changes: Changes,
        motors: Callable[[CommandLink], Motors | None] = lambda link: None,
        contradiction: Callable[[str], str] = lambda said: "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limits = limits
        self.setpoints = self.refused = 0
        self.written = Parameters(changes, note)
        self._note, self._clock = note, clock
        self._lock = threading.RLock()
        self._asking = Asking(self._lock)  # to arm, disarm or recover
        self._end = FlightEnd(motors, note, self._asking, clock)
        self._ready = Readiness(telemetry, contradiction, self._end, clock)
        connection = self._connection = CommandConnection(link, note)
        self.leases = Leases(
            note,
            lambda lease, client: self._end.end(self.link, lease, client),
            lambda: self._end.drives(self.link),
        )
        self.operator = Operator(
            self._lock, self._connection, self.leases, self._end, self._asking, self._ready, note
        )
        self.stored = StoredParameters(self.written, self._end, connection, self._leased, note)
        self._rate = RateLimit(SETPOINTS_HZ, SETPOINTS_BURST, clock=clock)

    @property
    def link(self) -> CommandLink | None:
        """The one to the craft that is commanded."""
        return self._connection.link

    @property
    def client(self) -> str | None:
        """Who commands at the moment."""
        return self.leases.client

    @property
    def supervisor(self) -> Supervisor:
        """What the craft says of itself."""
        return Supervisor() if self.link is None else self.link.supervisor

    @property
    def lands(self) -> bool:
        """Whether the craft is being landed."""
        return self._end.lands

    # -- what a client can do --------------------------------------------------------------

    def acquire(self, client: str, stops: int | None = None) -> Granted:
        """Begin a lease: its token, and the limits the client must keep.

        stops: ``operator.stops`` when the client's program began; None: it does not say. Raises
        NotAuthorisedError where the operator has stopped or landed the craft since."""
        with self._lock, self._counting():
            self._connection.require()
            self._ready.require_craft("be commanded")
            if stops is not None and stops != self.operator.stops:
                raise NotAuthorisedError(STOPPED_SINCE)
            now_s = self._clock()
            self.leases.expire(now_s, self.limits)
            link = self._connection.require_connected("try again")
            self._end.require_none("try again")
            self._ready.require_vehicle(link)
            if self.leases.present is None:
                self.written.require_restored(link)
            lease = self.leases.begin(client, craft_of(link), now_s)
            self._rate = RateLimit(SETPOINTS_HZ, SETPOINTS_BURST, clock=self._clock)
        self._note("command", f"{client} commands now")
        link.record_parameters(client)
        return Granted(
            token=lease.token,
            stops=self.operator.stops,
            lease_s=self.limits.lease_s,
            level_s=self.limits.level_s,
            stop_s=self.limits.stop_s,
            uri=link.uri,
            state=link.state.value,
            firmware=link.firmware,
            holds_height=link.holds_height,
            holds_place=link.holds_place,
            software=is_software(link.uri),
            craft=identity_of(link),
        )

    def release(self, token: str, *, content: bool = True) -> None:
        """End the lease: a craft that flies is landed, or its motors are stopped. What the client
        wrote to it stays where it is content, nothing is being written, and the craft is still in
        reach: to one that is not, nothing was put back."""
        with self._lock, self._counting():
            lease, link = self._require(token), self.link
            self.leases.leave(f"{lease.client} has released the craft", lease.client)
        stays = content and not self.written.turn.locked()
        in_reach = link is not None and link.state is CommandState.CONNECTED
        if stays and link is not None and in_reach and craft_of(link) == lease.craft:
            self.written.settle(lease.craft)

    async def stop_own(self, token: str) -> str:
        """Stop the motors of the client that commands, as an operator's stop does, and keep its
        lease. One whose lease was ended is told what became of its motors, or of its landing."""
        with self._lock, self._counting():
            lease = self.leases.former(token)
            if lease is None:
                lease = self._require(token)
                lease.heard_s += SEEN_S  # until it has its answer
                self._end.stop(self._connection.require(), lease, lease.client)
        return await self._outcome_of(lease)

    async def land_own(self, token: str) -> str:
        """Land the craft of the client that commands, and keep its lease; its motors are stopped
        where that cannot be. ``LANDED``, or what is known of the motors."""
        with self._lock, self._counting():
            lease = self.leases.former(token)
            if lease is None:
                lease = self._require(token)
                lease.heard_s += LANDING_S
                self._end.land_or_stop(self._connection.require(), lease)
        return await self._outcome_of(lease)

    def announce(self, token: str, text: str, in_s: float) -> None:
        """Say what is about to happen to the craft, for everybody near it to see; in_s: when."""
        with self._lock, self._counting():
            lease = self._require(token)
            lease.announced = text, self._clock() + in_s
        self._note("announced", f"{lease.client}: {text} in {in_s:g} s")

    def keep(self, token: str) -> None:
        """Say that the client is alive. It does not keep motors running: setpoints do."""
        with self._lock, self._counting():
            self._require(token)

    def setpoint(
        self,
        token: str,
        roll_deg: float,
        pitch_deg: float,
        yaw_dps: float,
        thrust: int,
        height_m: float | None = None,
        made_s: float | None = None,
        vx_m_s: float | None = None,
        vy_m_s: float | None = None,
    ) -> int:
        """Send one setpoint in the frame of the telemetry; when, Unix ns.

        Signs, and thrust, height or velocity, as in ``CommandLink.setpoint``. made_s: when, by this
        machine's monotonic clock; None: it is taken for new unless the daemon stood still just now.
        One that is ``LIFE_S`` old is refused, or dropped where the radio takes it late.
        """
        with self._lock, self._counting():
            now_s = self._clock()
            lease = self._require(token)
            link = self._connection.require()
            self._require_same(lease, link)
            if not self._rate.allows():
                raise BadInputError(
                    "setpoints come faster than 100 a second; this one was not sent"
                )
            if made_s is not None and not made_s <= now_s:
                made_s = None  # of another clock
            if thrust or height_m is not None:
                self._ready.require_calm("the setpoint was not sent", made_s)
            elif self.lands:
                self._end.require_none("the setpoint was not sent")
            made_s = now_s if made_s is None else made_s
            hovers = vx_m_s is not None
            if lease.held_level:
                roll_deg = pitch_deg = yaw_dps = 0.0
                vx_m_s = vy_m_s = 0.0 if hovers else None
            sent_ns = link.setpoint(
                roll_deg,
                pitch_deg,
                yaw_dps,
                thrust,
                height_m=height_m,
                vx_m_s=vx_m_s,
                vy_m_s=vy_m_s,
                client=lease.client,
                until_s=made_s + LIFE_S,
            )
            flew = lease.flies
            lease.steer(made_s, thrust, height_m, hovers)
            if lease.flies:
                self._end.begun()
                self._end.cancel_zero()
            elif flew:
                self._end.settle(link, now_s, lease.client)
            self.setpoints += 1
            return sent_ns

    def parameters(self) -> dict[str, float]:
        """Every parameter of the craft, as last read; needs no lease."""
        return self._connection.require_connected().parameters()

    async def write_parameters(self, token: str, values: dict[str, float]) -> dict[str, float]:
        """Write parameters; what the craft says they are now. All are checked before any is
        written, and noted on disk; what was written before the craft failed to confirm one, or
        the lease ended, stays until the daemon writes the former values back."""
        lease, link = self._leased(token)

        def heard() -> None:
            lease.heard_s = self._clock()

        return await self.written.write(
            link, lease, values, lambda: lease is self.leases.present, heard
        )

    # -- the daemon's part -----------------------------------------------------------------

    async def restore(self) -> dict[str, float]:
        """Write the former values of interrupted leases back now, not soon; all that were written
        back since the daemon began and that nobody has changed since. Raises TakenError while the
        craft flies, or somebody has written to it and commands."""
        link = self._connection.require_connected()
        if self.written.left(link):
            if self.client is not None:
                raise TakenError(f"{self.client} commands: nothing is written back meanwhile")
            if not self._stands(link):
                raise TakenError("the craft does not stand: nothing is written to it")
            await self.written.restore(link)
        return self.written.restored(link)

    async def keep_restored(self) -> None:
        """Write them back as soon as there is a craft that stands and that nobody commands, and
        then read what it has stored; for as long as the daemon runs."""
        wait_s, told = AGAIN_S, False
        while True:
            await asyncio.sleep(LOOKS_S)
            link = self.link
            if link is None or link.state is not CommandState.CONNECTED:
                self.written.unsure.clear()  # they are read anew
                wait_s, told = AGAIN_S, False
            elif self._stands(link):
                try:
                    await self.written.restore(link)
                    await self.stored.look(link, self._stands)
                    wait_s, told = AGAIN_S, False
                except GroundStationError as error:
                    if not told:
                        text = f"former parameters could not be written back: {error}"
                        self._note("fault", text)
                    told = True
                    await asyncio.sleep(wait_s)
                    wait_s = min(2.0 * wait_s, AGAIN_MOST_S)

    def _stands(self, link: CommandLink) -> bool:
        """Whether nothing flies, lands or is being stopped, as far as anybody knows."""
        quiet = not (self.client or self._end.doing or self._ready.closing)
        return quiet and not self._end.turns(link)

    async def leave(self) -> None:
        """Wait until nothing of the present craft is left to be done, before another is chosen.
        Raises TakenError while a client commands or motors are not known to have stopped."""
        end_s = self._clock() + (LANDING_S if self.lands else SEEN_S)
        while self.client is None and (now_s := self._clock()) < end_s:
            if not self._end.goes_on(now_s):
                break
            await asyncio.sleep(WATCH_S / 5)
        self.require_free()

    def require_free(self) -> None:
        """Raises TakenError while a client commands or motors are not known to have stopped."""
        if self.client is not None:
            raise TakenError(f"{self.client} is commanding; it must release first")
        self._end.require_none("another craft can be chosen after that")

    async def replace(self, link: CommandLink) -> None:
        """Command through another link from now on. Raises as ``require_free``."""
        with self._lock:
            self.require_free()
            self._asking.end()
            self._end.cancel_zero()
            before, self._connection.link = self.link, link
        await self._connection.close(before)

    async def keep_connected(self) -> None:
        """Connect the command link whenever there is a craft behind the telemetry and it is not."""
        await self._connection.keep(lambda: self._ready.wanted)

    async def disconnect(self) -> None:
        """The craft has been taken away: ``keep_connected`` looks for the next one."""
        if self.link is not None and self.link.uri.startswith("udp://"):
            await self.link.close()

    async def watch(self) -> None:
        """The failsafe and the standing still of this loop, for as long as the daemon runs."""
        ended = threading.Event()

        def keep_looking() -> None:  # in a thread: it does not depend on the load of this loop
            while not ended.wait(WATCH_S if self.link else IDLE_S):
                self.look(self._clock())

        looking = asyncio.ensure_future(in_background(keep_looking))
        try:
            while not looking.done():
                self.turn(self._clock())
                await asyncio.sleep(TURN_S)
            await looking
        finally:
            ended.set()
            looking.cancel()

    def turn(self, now_s: float) -> None:
        """The loop that hears the clients has turned."""
        self._ready.turn(now_s)

    def look(self, now_s: float) -> None:
        """Do what the time since the client's last words demands."""
        with self._lock:
            self.leases.expire(now_s, self.limits)
            lease, link = self.leases.present, self.link
            self._end.look(now_s, repeat=lease is None or now_s > lease.setpoint_s + WATCH_S)
            if lease is None or link is None or not lease.wants_level(now_s, self.limits):
                return
            if not lease.levelled:
                lease.levelled = True
                self._note("dead man", f"no setpoint from {lease.client}: level attitude")
            lease.end_climb(link.supervisor.place)
            until_s = lease.setpoint_s + self.limits.stop_s
            send_level(link, lease.thrust, FAILSAFE, lease.height_m, until_s, lease.hovers)

    async def close(self) -> None:
        """Land a craft that flies, or stop its motors, and disconnect; nobody commands after this.
        Safe to call twice."""
        with self._lock:
            self._ready.closing = True
            self._asking.end()
            text = f"the daemon ends: {self.client} commands no more"
            self.leases.leave(text, FAILSAFE, why="the daemon ends")
        link, end_s = self.link, self._clock() + LANDING_S + SEEN_S
        if link is not None:
            # one that flies on, whatever is asked of it, is left to its own limits
            while link.state is CommandState.CONNECTED and (now_s := self._clock()) < end_s:
                if not self._end.goes_on(now_s):
                    break
                self.look(now_s)
                await asyncio.sleep(WATCH_S / 5)
            with self._lock:
                self._end.give_up()
            await link.close()

    # -- helpers ---------------------------------------------------------------------------

    @contextlib.contextmanager
    def _counting(self) -> Iterator[None]:
        """Count what is refused."""
        try:
            yield
        except GroundStationError:
            self.refused += 1
            raise

    def _require(self, token: str) -> Lease:
        now_s = self._clock()
        self.leases.expire(now_s, self.limits)
        return self.leases.of(token, now_s)

    def _leased(self, token: str) -> tuple[Lease, CommandLink]:
        """The lease in force, and the connected craft that it is for."""
        with self._lock, self._counting():
            lease, link = self._require(token), self._connection.require_connected()
            self._require_same(lease, link)
        return lease, link

    def _require_same(self, lease: Lease, link: CommandLink) -> None:
        """Raises NotAuthorisedError where another craft answers than the lease is for."""
        if link.state is CommandState.CONNECTED and craft_of(link) != lease.craft:
            raise NotAuthorisedError(
                f"another craft answers at {link.uri} than the one that {lease.client} acquired;"
                " release it and begin again"
            )

    async def _outcome_of(self, lease: Lease) -> str:
        """What became of its craft, or of its motors."""
        ended = lease.descent or lease.stop
        return STOPPED if ended is None else await outcome(ended)
