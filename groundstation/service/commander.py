"""Who may command the craft: one authorised client at a time, and what happens when it vanishes.

A client acquires a lease and gets a token; nothing leaves for the craft without it. While the
motors run, a setpoint must come often: when none has come for ``level_s`` the daemon levels the
craft, after ``stop_s`` it stops the motors and the lease is over. Both come before the
firmware's own limits of 0.5 s and 2 s, which still hold when the daemon itself is gone.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import threading
import time
from collections.abc import Callable
from typing import Any

from groundstation.errors import (
    BadInputError,
    GroundStationError,
    LinkError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.links.base import LinkState
from groundstation.links.command import LIFE_S, CommandLink, CommandState
from groundstation.service.arming import Asking, ask_to_arm, ask_to_recover
from groundstation.service.config import DeadManConfig
from groundstation.service.dead_man import Standstill, watch
from groundstation.service.lease import Lease
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
"""How often the dead man looks, and repeats what it sends; where there is no command link."""
RECONNECT_S, RECONNECT_FAILED_S = 0.5, 5.0
DEAD_MAN = "dead man"
OPERATOR = "operator"


class Commander:
    """The command link and the lease on it. What does not wait is safe to call from any thread:
    the dead man looks from one of its own, whatever holds the event loop up.

    link: None where the daemon was given no command link.
    note: told (kind, text) of leases and of the dead man, from any thread.
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
        limits: DeadManConfig,
        *,
        note: Note,
        telemetry: Callable[[], tuple[LinkState, str]],
        motors: Callable[[CommandLink], Motors | None] = lambda link: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.link = link
        self.limits = limits
        self.setpoints = self.refused = self.interventions = 0
        self._note, self._telemetry, self._motors = note, telemetry, motors
        self._clock = clock
        self._stopping = Stopping(motors, note, clock)
        self._lease: Lease | None = None
        self._former: Lease | None = None  # the last one that is over
        self._lock = threading.RLock()
        self._asking = Asking(self._lock)  # to arm, disarm or recover
        self._standstill = Standstill()
        self._connecting = asyncio.Lock()
        self._closing = False
        self._rate = RateLimit(SETPOINTS_HZ, SETPOINTS_BURST, clock=clock)

    # -- what a client can do --------------------------------------------------------------

    @property
    def client(self) -> str | None:
        """Who commands at the moment."""
        return None if self._lease is None else self._lease.client

    @property
    def hindrance(self) -> str:
        """What, as the craft says, keeps it from flying; empty where it says nothing of that."""
        return "" if self.link is None else self.link.supervisor.hindrance

    @property
    def height_m(self) -> float | None:
        """Where the craft is by its own account, None where it is not sure of that."""
        return None if self.link is None else self.link.supervisor.height_m

    def acquire(self, client: str) -> Granted:
        """Begin a lease: its token, and the limits the client must keep."""
        with self._lock:
            link = self._require_link()
            _, reason = self._telemetry()
            if self._closing:
                reason = "the daemon ends"
            if reason:
                raise BadInputError(f"no craft can be commanded: {reason}")
            self._expire(self._clock())
            if self._lease is not None:
                self.refused += 1
                raise TakenError(f"{self._lease.client} is commanding; one client at a time")
            if link.state is not CommandState.CONNECTED:
                raise LinkError(f"{link.uri} is not connected ({link.state.value}); try again")
            lease = self._lease = Lease(client, secrets.token_urlsafe(24), self._clock())
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
        with self._lock:
            lease = self._require(token)
            self._leave(lease, lease.client)
            self._end(f"{lease.client} has released the craft")

    async def stop_own(self, token: str) -> str:
        """Stop the motors of the client that commands, as ``stop`` does, and keep its lease. One
        whose lease was ended is told what became of its motors."""
        with self._lock:
            stop = self._own_stop(token)
        return STOPPED if stop is None else await outcome(stop)

    async def stop(self) -> str:
        """Stop the motors, whoever commands, and end that lease: the operator's way out. What the
        craft then says of them, in words: ``STOPPED`` where they stand.

        Motors that do not stop are asked again, disarmed and stopped by the firmware, as after any
        stop."""
        with self._lock:
            self._asking.end()  # whatever became of the connection
            link = self._require_link()
            if link.state is not CommandState.CONNECTED:
                raise LinkError(
                    f"{link.uri} is not connected ({link.state.value}): the stop was not sent"
                )
            stop = self._stop_motors(OPERATOR)
            holder = self._lease
            if holder is not None:
                holder.stop = stop
            who = "nobody commanded" if holder is None else f"{holder.client} commands no more"
            self._end(f"the operator stops the motors; {who}", kind="stop", why=BY_OPERATOR)
        return STOPPED if stop is None else await outcome(stop)

    def level(self, on: bool) -> None:
        """Whether attitude and yaw rate of every setpoint are replaced by zero, the client's thrust
        or height kept; until it is switched off or the lease is over. Raises BadInputError where
        nobody commands."""
        if self._lease is None:
            raise BadInputError("nobody commands: there is nothing to hold level")
        if on is not self._lease.held_level:
            self._lease.held_level = on
            what = "holds the craft level" if on else "gives the attitude back"
            self._note("level", f"the operator {what}; {self._lease.client} commands")

    async def arm(self, on: bool) -> None:
        """Arm the motors or disarm them, whoever commands, and wait for the craft's answer.

        Raises BadInputError for a firmware that knows no arming, LinkError where it refuses or
        does not answer, TakenError where a stop or another such request came in between."""
        self._require_link()
        _, reason = self._telemetry()
        if on and reason:
            raise BadInputError(f"no craft can be armed: {reason}")
        if on:
            self._require_calm("the motors were not armed")
        await ask_to_arm(self._require_connected(), on, self._asking.begin())
        kind, does = ("armed", "arms") if on else ("disarmed", "disarms")
        self._note(kind, f"the operator {does} the motors")

    async def recover(self) -> None:
        """Let a craft that calls itself crashed be ready again, and wait until it says so.

        Raises BadInputError for one that has not crashed, TakenError while a client asks for
        thrust, LinkError where it does not recover."""
        if self._lease is not None and self._lease.flies:
            raise TakenError(f"{self._lease.client} asks for thrust: motors might turn at once")
        _, reason = self._telemetry()
        if reason:
            raise BadInputError(f"no craft can recover: {reason}")
        self._require_calm("the craft was not asked to recover")
        await ask_to_recover(self._require_connected(), self._asking.begin())
        self._note("recovered", "the operator has had the craft recover from its crash")

    async def leave(self) -> None:
        """Wait until nothing of the present craft is left to be done, before another is chosen.
        Raises TakenError while a client commands or motors are not known to have stopped."""
        end_s = self._clock() + SEEN_S
        while (
            self.client is None and self._stopping.goes_on(self._clock()) and self._clock() < end_s
        ):
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
            before, self.link = self.link, link
        async with self._connecting:
            if before is not None:
                await before.close()

    def keep(self, token: str) -> None:
        """Say that the client is alive. It does not keep motors running: setpoints do."""
        with self._lock:
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
        with self._lock:
            now_s = self._clock()
            lease = self._require(token)
            link = self._require_link()
            if not self._rate.allows():
                self.refused += 1
                raise BadInputError(
                    "setpoints come faster than 100 a second; this one was not sent"
                )
            stamped, made_s = made_s is not None, min(now_s if made_s is None else made_s, now_s)
            if thrust or height_m is not None:
                self._require_calm("the setpoint was not sent", stamped=stamped)
                if now_s > made_s + LIFE_S:
                    self.refused += 1
                    raise LinkError(
                        f"the setpoint was made {now_s - made_s:.1f} s ago: too old to be sent"
                    )
            if lease.held_level:
                roll_deg = pitch_deg = yaw_dps = 0.0
            try:
                sent_ns = link.setpoint(
                    roll_deg, pitch_deg, yaw_dps, thrust, height_m=height_m, client=lease.client,
                    until_s=made_s + LIFE_S,
                )  # fmt: skip
            except GroundStationError:
                self.refused += 1
                raise
            flew = lease.flies
            lease.setpoint_s, lease.levelled = made_s, False
            lease.thrust, lease.height_m = thrust, height_m
            lease.flew |= lease.flies
            if lease.flies:
                self._stopping.cancel()
            elif flew:
                self._stopping.settle(link, now_s, lease.client)
            self.setpoints += 1
            return sent_ns

    def parameters(self) -> dict[str, float]:
        """Every parameter of the craft, as last read; needs no lease."""
        return self._require_connected().parameters()

    async def write_parameters(self, token: str, values: dict[str, float]) -> dict[str, float]:
        """Write parameters; what the craft says they are now. All are checked before any is
        written; what was written before the craft failed to confirm one, or the lease ended,
        stays."""
        lease = self._require(token)
        link = self._require_connected()
        for name, value in values.items():
            link.require_parameter(name, value)
        confirmed = {}
        for name, value in values.items():
            if lease is not self._lease:
                raise NotAuthorisedError(
                    f"the lease is over; {name} and what comes after it was not written"
                )
            confirmed[name] = await link.write_parameter(name, value, client=lease.client)
            lease.heard_s = time.monotonic()
        return confirmed

    def status(self) -> dict[str, Any] | None:
        if self.link is None:
            return None
        return {
            "uri": self.link.uri,
            "state": self.link.state.value,
            "firmware": self.link.firmware,
            "client": self.client,
            "armed": self.link.armed,
            "hindrance": self.hindrance,
            "crashed": self.link.supervisor.crashed,
            "held_level": self._lease is not None and self._lease.held_level,
            "setpoints": self.setpoints,
            "superseded": self.link.superseded,
            "refused": self.refused,
            "interventions": self.interventions,
        }

    # -- the daemon's part -----------------------------------------------------------------

    async def keep_connected(self) -> None:
        """Connect the command link whenever there is a craft behind the telemetry and it is not."""
        told = ""
        while True:
            link = self.link
            # a stand-in answers only once its link is open
            state, reason = self._telemetry()
            wanted = state is LinkState.STREAMING and not reason and not self._closing
            if link is not None and wanted and _away(link):
                try:
                    async with self._connecting:
                        if link is self.link:
                            await link.close()
                            await link.open()
                    told = ""
                except LinkError as error:
                    if str(error) != told:
                        told = str(error)
                        self._note("waiting", told)
                    await asyncio.sleep(RECONNECT_FAILED_S)
            await asyncio.sleep(RECONNECT_S)

    async def disconnect(self) -> None:
        """The craft has been taken away: ``keep_connected`` looks for the next one."""
        if self.link is not None and self.link.uri.startswith("udp://"):
            await self.link.close()

    async def watch(self) -> None:
        """The dead man and the standing still of this loop, for as long as the daemon runs."""

        def every_s() -> float:
            return WATCH_S if self.link is not None else IDLE_S

        await watch(self.look, self.turn, self._clock, every_s)

    def turn(self, now_s: float) -> None:
        """The loop that hears the clients has turned."""
        self._standstill.turn(now_s)

    def look(self, now_s: float) -> None:
        """Do what the time since the client's last words demands."""
        with self._lock:
            self._expire(now_s)
            lease = self._lease
            repeat = lease is None or now_s > lease.setpoint_s + WATCH_S
            self._stopping.look(now_s, repeat=repeat)
            if lease is None or not lease.flies or self.link is None:
                return
            if now_s - lease.setpoint_s >= self.limits.level_s:
                if not lease.levelled:
                    lease.levelled = True
                    self._note("dead man", f"no setpoint from {lease.client}: level attitude")
                until_s = lease.setpoint_s + self.limits.stop_s
                send_level(self.link, lease.thrust, DEAD_MAN, lease.height_m, until_s)

    def _expire(self, now_s: float) -> None:
        """End a lease whose time is over, whoever notices first."""
        lease = self._lease
        if lease is None:
            return
        if lease.flies and now_s - lease.setpoint_s >= self.limits.stop_s:
            self.interventions += 1
            lease.stop = self._stop_motors(DEAD_MAN)
            self._end(
                f"{lease.client} has vanished: its motors are asked to stop", kind="fault",
                why="no setpoint came in time: the dead man has asked the motors to stop",
            )  # fmt: skip
        elif not lease.flies and now_s - lease.heard_s >= self.limits.lease_s:
            self._leave(lease, DEAD_MAN)
            text = f"{lease.client} was silent for {self.limits.lease_s:g} s: its lease is over"
            self._end(text, why=text)

    async def close(self) -> None:
        """Stop motors that still run, and disconnect; nobody commands after this. Safe to call
        twice."""
        with self._lock:
            self._closing = True
            self._asking.end()
            lease = self._lease
            if lease is not None:
                self._leave(lease, DEAD_MAN)
                text = f"the daemon ends: {lease.client} commands no more"
                self._end(text, why="the daemon ends")
        if self.link is not None:
            while self.link.state is CommandState.CONNECTED and self._stopping.goes_on(
                self._clock()
            ):
                self.look(self._clock())
                await asyncio.sleep(WATCH_S / 5)
            await self.link.close()

    def _require_link(self) -> CommandLink:
        if self.link is None:
            raise BadInputError(
                "the daemon has no command link; start it with --command udp://HOST:PORT or "
                "radio://..."
            )
        return self.link

    def _require_connected(self) -> CommandLink:
        link = self._require_link()
        if link.state is not CommandState.CONNECTED:
            raise LinkError(f"{link.uri} is not connected ({link.state.value})")
        return link

    def _require(self, token: str) -> Lease:
        now_s = self._clock()
        self._expire(now_s)
        lease = self._lease
        if lease is None or not _is_of(lease, token):
            self.refused += 1
            former = self._former
            if former is not None and _is_of(former, token):
                raise NotAuthorisedError(f"{former.ended}; acquire a lease")
            raise NotAuthorisedError("this token is not (or no more) in force; acquire a lease")
        lease.heard_s = now_s
        return lease

    def _require_calm(self, refused: str, *, stamped: bool = False) -> None:
        """That nothing forbids motors to turn. stamped: the request says when it was made."""
        if self._stopping.runs:
            self.refused += 1
            raise TakenError(f"the motors are being stopped: {refused}")
        if not stamped and self._standstill.holds(self._clock()):
            self.refused += 1
            raise LinkError(f"the daemon stood still, and nobody knows since when: {refused}")

    def _own_stop(self, token: str) -> Stop | None:
        former = self._former
        if self._lease is None and former is not None and _is_of(former, token):
            return former.stop
        lease = self._require(token)
        lease.heard_s += SEEN_S  # until it has its answer
        lease.stop = self._stop_motors(lease.client)
        return lease.stop

    def _leave(self, lease: Lease, client: str) -> None:
        """Stop what runs, or goes on turning at zero thrust, as assist modes and armed brushless
        motors do."""
        said = None if self.link is None else self._motors(self.link)
        if lease.flies or (lease.flew and said is not None and said.duty > 0.0):
            lease.stop = self._stop_motors(client)

    def _stop_motors(self, client: str) -> Stop | None:
        self._asking.end()
        if self._lease is not None:
            self._lease.set_down()
        return None if self.link is None else self._stopping.ask(self.link, client)

    def _end(self, text: str, *, kind: str = "command", why: str = "the lease is over") -> None:
        lease, self._lease = self._lease, None
        if lease is not None:
            lease.ended, self._former = why, lease
        self._note(kind, text)


def _is_of(lease: Lease, token: str) -> bool:
    return hmac.compare_digest(lease.token.encode(), token.encode())


def _away(link: CommandLink) -> bool:
    return link.state in (CommandState.CLOSED, CommandState.LOST)
