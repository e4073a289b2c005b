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
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from groundstation.errors import (
    BadInputError,
    GroundStationError,
    LinkError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.links.base import LinkState
from groundstation.links.command import CommandLink, CommandState
from groundstation.service.arming import ask_to_arm, ask_to_recover
from groundstation.service.config import DeadManConfig
from groundstation.service.limits import RateLimit
from groundstation.service.motor_stop import SEEN_S, Motors, Note, Stopping, send_level
from groundstation.service.requests import Lease as Granted

SETPOINTS_HZ, SETPOINTS_BURST = 110.0, 100.0
"""100 Hz; a client that was held up for a second may catch up, for the newest replaces the rest."""
WATCH_S = 0.05
"""How often the dead man looks, and repeats what it sends."""
RECONNECT_S, RECONNECT_FAILED_S = 0.5, 5.0
DEAD_MAN = "dead man"
OPERATOR = "operator"


@dataclass(slots=True)
class Lease:
    """One client's right to command."""

    client: str
    token: str
    heard_s: float
    """When the client last said anything, monotonic."""
    setpoint_s: float = 0.0
    thrust: int = 0
    height_m: float | None = None
    levelled: bool = False
    """By the dead man."""
    held_level: bool = False
    """By the operator."""
    flew: bool = False
    """Whether motors ever ran for it."""

    @property
    def flies(self) -> bool:
        """Whether motors run for it."""
        return bool(self.thrust) or self.height_m is not None

    def set_down(self) -> None:
        self.thrust, self.height_m = 0, None


class Commander:
    """The command link and the lease on it.

    link: None where the daemon was given no command link.
    note: told (kind, text) of leases and of the dead man.
    telemetry: state of the telemetry link; why no craft can be commanded with it, or empty.
    motors: what the telemetry says of them, None where it does not.

    What refuses raises BadInputError for a value, NotAuthorisedError for a token that is not in
    force, TakenError where another client commands, LinkError where the craft is not connected.
    """

    def __init__(
        self,
        link: CommandLink | None,
        limits: DeadManConfig,
        *,
        note: Note,
        telemetry: Callable[[], tuple[LinkState, str]],
        motors: Callable[[], Motors | None] = lambda: None,
    ) -> None:
        self.link = link
        self.limits = limits
        self.setpoints = self.refused = self.interventions = 0
        self._note, self._telemetry, self._motors = note, telemetry, motors
        self._stopping = Stopping(lambda: self.link, motors, note, DEAD_MAN)
        self._lease: Lease | None = None
        self._connecting = asyncio.Lock()
        self._closing = False
        self._rate = RateLimit(SETPOINTS_HZ, SETPOINTS_BURST)

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
        link = self._require_link()
        _, reason = self._telemetry()
        if self._closing:
            reason = "the daemon ends"
        if reason:
            raise BadInputError(f"no craft can be commanded: {reason}")
        if self._lease is not None:
            self.refused += 1
            raise TakenError(f"{self._lease.client} is commanding; one client at a time")
        if link.state is not CommandState.CONNECTED:
            raise LinkError(f"{link.uri} is not connected ({link.state.value}); try again")
        self._lease = Lease(client, secrets.token_urlsafe(24), time.monotonic())
        self._rate = RateLimit(SETPOINTS_HZ, SETPOINTS_BURST)
        self._note("command", f"{client} commands now")
        link.record_parameters(client)
        return Granted(
            token=self._lease.token,
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
        lease = self._require(token)
        self._leave(lease, lease.client)
        self._end(f"{lease.client} has released the craft")

    async def stop_own(self, token: str) -> str:
        """Stop the motors of the client that commands, as ``stop`` does, and keep its lease."""
        lease = self._require(token)
        lease.heard_s += SEEN_S  # until it has its answer
        self._stop_motors(lease.client)
        return await self._stopping.outcome()

    async def stop(self) -> str:
        """Stop the motors, whoever commands, and end that lease: the operator's way out. What the
        craft then says of them, in words: ``STOPPED`` where they stand.

        Motors that do not stop are asked again, disarmed and stopped by the firmware, as after any
        stop."""
        link = self._require_link()
        if link.state is not CommandState.CONNECTED:
            raise LinkError(
                f"{link.uri} is not connected ({link.state.value}): the stop was not sent"
            )
        self._stop_motors(OPERATOR)
        holder = (
            "nobody commanded" if self._lease is None else f"{self._lease.client} commands no more"
        )
        self._end(f"the operator stops the motors; {holder}", kind="stop")
        return await self._stopping.outcome()

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
        does not answer."""
        self._require_link()
        _, reason = self._telemetry()
        if on and reason:
            raise BadInputError(f"no craft can be armed: {reason}")
        await ask_to_arm(self._require_connected(), on)
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
        await ask_to_recover(self._require_connected())
        self._note("recovered", "the operator has had the craft recover from its crash")

    async def replace(self, link: CommandLink) -> None:
        """Command through another link from now on. Raises TakenError while a client commands."""
        if self._lease is not None:
            raise TakenError(f"{self._lease.client} is commanding; it must release first")
        before, self.link = self.link, link
        async with self._connecting:
            if before is not None:
                await before.close()

    def keep(self, token: str) -> None:
        """Say that the client is alive. It does not keep motors running: setpoints do."""
        self._require(token)

    def setpoint(
        self,
        token: str,
        roll_deg: float,
        pitch_deg: float,
        yaw_dps: float,
        thrust: int,
        height_m: float | None = None,
    ) -> int:
        """Send one setpoint in the frame of the telemetry; when, Unix ns.

        Signs, and thrust or height, as in ``CommandLink.setpoint``.
        """
        lease = self._require(token)
        link = self._require_link()
        if not self._rate.allows():
            self.refused += 1
            raise BadInputError("setpoints come faster than 100 a second; this one was not sent")
        if lease.held_level:
            roll_deg = pitch_deg = yaw_dps = 0.0
        try:
            sent_ns = link.setpoint(
                roll_deg, pitch_deg, yaw_dps, thrust, height_m=height_m, client=lease.client
            )
        except GroundStationError:
            self.refused += 1
            raise
        flew = lease.flies
        lease.setpoint_s, lease.levelled = lease.heard_s, False
        lease.thrust, lease.height_m = thrust, height_m
        lease.flew |= lease.flies
        if lease.flies:
            self._stopping.cancel()
        elif flew:
            self._stopping.settle(lease.heard_s, lease.client)
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
        """The dead man: runs as long as the daemon, where there is anything to command."""
        while True:
            self.look(time.monotonic())
            await asyncio.sleep(WATCH_S)

    def look(self, now_s: float) -> None:
        """Do what the time since the client's last words demands."""
        lease = self._lease
        self._stopping.look(now_s, repeat=lease is None or now_s > lease.setpoint_s + WATCH_S)
        if lease is None:
            return
        silent_s = now_s - lease.setpoint_s
        if self._is_overdue(lease, now_s):
            self.interventions += 1
            self._stop_motors(DEAD_MAN)
            self._end(f"{lease.client} has vanished: its motors are asked to stop", kind="fault")
        elif lease.flies and silent_s >= self.limits.level_s:
            if not lease.levelled:
                lease.levelled = True
                self._note("dead man", f"no setpoint from {lease.client}: level attitude")
            send_level(self.link, lease.thrust, DEAD_MAN, lease.height_m)
        elif not lease.flies and now_s - lease.heard_s >= self.limits.lease_s:
            self._leave(lease, DEAD_MAN)
            self._end(f"{lease.client} was silent for {self.limits.lease_s:g} s: its lease is over")

    async def close(self) -> None:
        """Stop motors that still run, and disconnect; nobody commands after this. Safe to call
        twice."""
        self._closing = True
        lease = self._lease
        if lease is not None:
            self._leave(lease, DEAD_MAN)
            self._end(f"the daemon ends: {lease.client} commands no more")
        if self.link is not None:
            while self.link.state is CommandState.CONNECTED and self._stopping.goes_on(
                time.monotonic()
            ):
                self.look(time.monotonic())
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

    def _is_overdue(self, lease: Lease, now_s: float) -> bool:
        """Whether motors run although their client has been silent for too long."""
        return lease.flies and now_s - lease.setpoint_s >= self.limits.stop_s

    def _require(self, token: str) -> Lease:
        now_s = time.monotonic()
        # where the daemon itself stood still, a stale request may come before the dead man's turn
        if self._lease is not None and self._is_overdue(self._lease, now_s):
            self.look(now_s)
        lease = self._lease
        if lease is None or not hmac.compare_digest(lease.token.encode(), token.encode()):
            self.refused += 1
            raise NotAuthorisedError("this token is not (or no more) in force; acquire a lease")
        lease.heard_s = now_s
        return lease

    def _leave(self, lease: Lease, client: str) -> None:
        """Stop what runs, or goes on turning at zero thrust, as assist modes and armed brushless
        motors do."""
        said = self._motors()
        if lease.flies or (lease.flew and said is not None and said.duty > 0.0):
            self._stop_motors(client)

    def _stop_motors(self, client: str) -> None:
        if self._lease is not None:
            self._lease.set_down()
        self._stopping.ask(client)

    def _end(self, text: str, *, kind: str = "command") -> None:
        self._lease = None
        self._note(kind, text)


def _away(link: CommandLink) -> bool:
    return link.state in (CommandState.CLOSED, CommandState.LOST)
