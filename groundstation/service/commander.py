"""Who may command the craft: one authorised client at a time, and what happens when it vanishes.

A client acquires a lease and gets a token; nothing leaves for the craft without it. While the
motors run, a setpoint must come often: when none has come for ``level_s`` the daemon levels the
craft, after ``stop_s`` it stops the motors and the lease is over. Both come before the
firmware's own limits of 0.5 s and 2 s, which still hold when the daemon itself is gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator

from groundstation.errors import (
    BadInputError,
    GroundStationError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.links.base import LinkState
from groundstation.links.command import LIFE_S, CommandLink, CommandState
from groundstation.links.supervisor import Supervisor
from groundstation.service.arming import Asking, ask_to_arm, ask_to_recover
from groundstation.service.command_connection import CommandConnection
from groundstation.service.config import FailsafeConfig
from groundstation.service.failsafe import watch
from groundstation.service.freshness import Freshness
from groundstation.service.lease import FAILSAFE, Lease, Leases
from groundstation.service.limits import RateLimit
from groundstation.service.motor_stop import (
    BY_OPERATOR,
    SEEN_S,
    STOPPED,
    Motors,
    Note,
    Stop,
    Stopping,
    outcome,
    send_level,
)
from groundstation.service.requests import Lease as Granted

SETPOINTS_HZ, SETPOINTS_BURST = 110.0, 100.0
"""100 Hz; a client that was held up for a second may catch up, for the newest replaces the rest."""
WATCH_S, IDLE_S = 0.05, 0.25
"""How often the failsafe looks, and repeats what it sends; where there is no command link."""
OPERATOR = "operator"


class Commander:
    """The command link and the lease on it. What does not wait is safe to call from any thread:
    the failsafe looks from one of its own, whatever holds the event loop up.

    link: None where the daemon was given no command link.
    note: told (kind, text) of leases and of the failsafe, from any thread.
    telemetry: state of the telemetry link; why no craft can be commanded with it, or empty.
    motors: what the telemetry says of those of a link's craft, None where it does not.
    clock: monotonic, s.

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
        motors: Callable[[CommandLink], Motors | None] = lambda link: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limits = limits
        self.setpoints = self.refused = 0
        self.leases = Leases(note, self._stop_motors, self._turn)
        self._note, self._telemetry, self._motors = note, telemetry, motors
        self._clock = clock
        self._stopping = Stopping(motors, note, clock)
        self._lock = threading.RLock()
        self._asking = Asking(self._lock)  # to arm, disarm or recover
        self._freshness = Freshness()
        self._connection = CommandConnection(link, note)
        self._closing = False
        self._rate = RateLimit(SETPOINTS_HZ, SETPOINTS_BURST, clock=clock)

    # -- what a client can do --------------------------------------------------------------

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

    def acquire(self, client: str) -> Granted:
        """Begin a lease: its token, and the limits the client must keep."""
        with self._lock, self._counting():
            self._connection.require()
            self._require_craft("be commanded")
            now_s = self._clock()
            self.leases.expire(now_s, self.limits)
            link = self._connection.require_connected("try again")
            lease = self.leases.begin(client, now_s)
            self._rate = RateLimit(SETPOINTS_HZ, SETPOINTS_BURST, clock=self._clock)
        self._note("command", f"{client} commands now")
        link.record_parameters(client)
        return Granted(
            token=lease.token,
            lease_s=self.limits.lease_s,
            level_s=self.limits.level_s,
            stop_s=self.limits.stop_s,
            uri=link.uri,
            state=link.state.value,
            firmware=link.firmware,
            holds_height=link.holds_height,
        )

    def release(self, token: str) -> None:
        """End the lease; motors that still run are stopped."""
        with self._lock, self._counting():
            lease = self._require(token)
            self.leases.leave(f"{lease.client} has released the craft", lease.client)

    async def stop_own(self, token: str) -> str:
        """Stop the motors of the client that commands, as ``stop`` does, and keep its lease. One
        whose lease was ended is told what became of its motors."""
        with self._lock, self._counting():
            lease = self.leases.former(token)
            if lease is None:
                lease = self._require(token)
                lease.heard_s += SEEN_S  # until it has its answer
                lease.stop = self._stop_motors(lease.client)
        return STOPPED if lease.stop is None else await outcome(lease.stop)

    async def stop(self) -> str:
        """Stop the motors, whoever commands, and end that lease: the operator's way out. What the
        craft then says of them, in words: ``STOPPED`` where they stand.

        Motors that do not stop are asked again, disarmed and stopped by the firmware, as after any
        stop."""
        with self._lock:
            self._asking.end()  # whatever became of the connection
            self._connection.require_connected("the stop was not sent")
            stop = self._stop_motors(OPERATOR)
            holder = self.leases.present
            if holder is not None:
                holder.stop = stop
            who = "nobody commanded" if holder is None else f"{holder.client} commands no more"
            text = f"the operator stops the motors; {who}"
            self.leases.end(text, kind="stop", why=BY_OPERATOR)
        return STOPPED if stop is None else await outcome(stop)

    def level(self, on: bool) -> None:
        """Whether attitude and yaw rate of every setpoint are replaced by zero, the client's thrust
        or height kept; until it is switched off or the lease is over. Raises BadInputError where
        nobody commands."""
        lease = self.leases.present
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
            self._require_craft("be armed")
            self._require_calm("the motors were not armed")
        await ask_to_arm(self._connection.require_connected(), on, self._asking.begin())
        kind, does = ("armed", "arms") if on else ("disarmed", "disarms")
        self._note(kind, f"the operator {does} the motors")

    async def recover(self) -> None:
        """Let a craft that calls itself crashed be ready again, and wait until it says so.

        Raises BadInputError for one that has not crashed, TakenError while a client asks for
        thrust, LinkError where it does not recover."""
        lease = self.leases.present
        if lease is not None and lease.flies:
            raise TakenError(f"{lease.client} asks for thrust: motors might turn at once")
        self._require_craft("recover")
        self._require_calm("the craft was not asked to recover")
        await ask_to_recover(self._connection.require_connected(), self._asking.begin())
        self._note("recovered", "the operator has had the craft recover from its crash")

    async def leave(self) -> None:
        """Wait until nothing of the present craft is left to be done, before another is chosen.
        Raises TakenError while a client commands or motors are not known to have stopped."""
        end_s = self._clock() + SEEN_S
        while self.client is None and (now_s := self._clock()) < end_s:
            if not self._stopping.goes_on(now_s):
                break
            await asyncio.sleep(WATCH_S / 5)
        self.require_free()

    def require_free(self) -> None:
        """Raises TakenError while a client commands or motors are not known to have stopped."""
        if self.client is not None:
            raise TakenError(f"{self.client} is commanding; it must release first")
        if self._stopping.runs:
            raise TakenError("the motors are being stopped; another craft can be chosen after that")

    async def replace(self, link: CommandLink) -> None:
        """Command through another link from now on. Raises as ``require_free``."""
        with self._lock:
            self.require_free()
            self._asking.end()
            self._stopping.cancel()
            before, self._connection.link = self.link, link
        await self._connection.close(before)

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
    ) -> int:
        """Send one setpoint in the frame of the telemetry; when, Unix ns.

        Signs, and thrust or height, as in ``CommandLink.setpoint``. made_s: when, by this machine's
        monotonic clock; None: it is taken for new unless the daemon stood still just now. One that
        is ``LIFE_S`` old is refused, or dropped where the radio takes it late.
        """
        with self._lock, self._counting():
            now_s = self._clock()
            lease = self._require(token)
            link = self._connection.require()
            if not self._rate.allows():
                raise BadInputError(
                    "setpoints come faster than 100 a second; this one was not sent"
                )
            if made_s is not None and not made_s <= now_s:
                made_s = None  # of another clock
            if thrust or height_m is not None:
                self._require_calm("the setpoint was not sent", made_s)
            made_s = now_s if made_s is None else made_s
            if lease.held_level:
                roll_deg = pitch_deg = yaw_dps = 0.0
            sent_ns = link.setpoint(
                roll_deg, pitch_deg, yaw_dps, thrust, height_m=height_m, client=lease.client,
                until_s=made_s + LIFE_S,
            )  # fmt: skip
            flew = lease.flies
            lease.steer(made_s, thrust, height_m)
            if lease.flies:
                self._stopping.cancel()
            elif flew:
                self._stopping.settle(link, now_s, lease.client)
            self.setpoints += 1
            return sent_ns

    def parameters(self) -> dict[str, float]:
        """Every parameter of the craft, as last read; needs no lease."""
        return self._connection.require_connected().parameters()

    async def write_parameters(self, token: str, values: dict[str, float]) -> dict[str, float]:
        """Write parameters; what the craft says they are now. All are checked before any is
        written; what was written before the craft failed to confirm one, or the lease ended,
        stays."""
        with self._lock, self._counting():
            lease = self._require(token)
            link = self._connection.require_connected()
        for name, value in values.items():
            link.require_parameter(name, value)
        confirmed = {}
        for name, value in values.items():
            if lease is not self.leases.present:
                raise NotAuthorisedError(
                    f"the lease is over; {name} and what comes after it was not written"
                )
            confirmed[name] = await link.write_parameter(name, value, client=lease.client)
            lease.heard_s = self._clock()
        return confirmed

    # -- the daemon's part -----------------------------------------------------------------

    async def keep_connected(self) -> None:
        """Connect the command link whenever there is a craft behind the telemetry and it is not."""

        def wanted() -> bool:
            # a stand-in answers only once its link is open
            state, reason = self._telemetry()
            return state is LinkState.STREAMING and not reason and not self._closing

        await self._connection.keep(wanted)

    async def disconnect(self) -> None:
        """The craft has been taken away: ``keep_connected`` looks for the next one."""
        if self.link is not None and self.link.uri.startswith("udp://"):
            await self.link.close()

    async def watch(self) -> None:
        """The failsafe and the standing still of this loop, for as long as the daemon runs."""

        def every_s() -> float:
            return WATCH_S if self.link is not None else IDLE_S

        await watch(self.look, self.turn, self._clock, every_s)

    def turn(self, now_s: float) -> None:
        """The loop that hears the clients has turned."""
        self._freshness.turn(now_s)

    def look(self, now_s: float) -> None:
        """Do what the time since the client's last words demands."""
        with self._lock:
            self.leases.expire(now_s, self.limits)
            lease, link = self.leases.present, self.link
            repeat = lease is None or now_s > lease.setpoint_s + WATCH_S
            self._stopping.look(now_s, repeat=repeat)
            if lease is None or link is None or not lease.wants_level(now_s, self.limits):
                return
            if not lease.levelled:
                lease.levelled = True
                self._note("dead man", f"no setpoint from {lease.client}: level attitude")
            until_s = lease.setpoint_s + self.limits.stop_s
            send_level(link, lease.thrust, FAILSAFE, lease.height_m, until_s)

    async def close(self) -> None:
        """Stop motors that still run, and disconnect; nobody commands after this. Safe to call
        twice."""
        with self._lock:
            self._closing = True
            self._asking.end()
            text = f"the daemon ends: {self.client} commands no more"
            self.leases.leave(text, FAILSAFE, why="the daemon ends")
        link = self.link
        if link is not None:
            while link.state is CommandState.CONNECTED and self._stopping.goes_on(self._clock()):
                self.look(self._clock())
                await asyncio.sleep(WATCH_S / 5)
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

    def _require_craft(self, what: str) -> None:
        """That the craft that is heard is one that can be commanded, and will be."""
        reason = "the daemon ends" if self._closing else self._telemetry()[1]
        if reason:
            raise BadInputError(f"no craft can {what}: {reason}")

    def _require_calm(self, refused: str, made_s: float | None = None) -> None:
        """That nothing forbids motors to turn. made_s: when that was asked for, if told."""
        if self._stopping.runs:
            raise TakenError(f"the motors are being stopped: {refused}")
        self._freshness.require(refused, self._clock(), made_s)

    def _stop_motors(self, client: str) -> Stop | None:
        self._asking.end()
        if self.leases.present is not None:
            self.leases.present.set_down()
        return None if self.link is None else self._stopping.ask(self.link, client)

    def _turn(self) -> bool:
        """Whether the craft says that its motors do."""
        said = None if self.link is None else self._motors(self.link)
        return said is not None and said.duty > 0.0
