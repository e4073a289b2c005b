"""One client's right to command, and whose it is at the moment."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Callable
from dataclasses import dataclass

from groundstation.errors import NotAuthorisedError, TakenError
from groundstation.links.command import CommandLink, is_software
from groundstation.service import requests
from groundstation.service.config import FailsafeConfig
from groundstation.service.lander import LANDS, Descent
from groundstation.service.motor_stop import Note, Stop

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


def granted(lease: Lease, link: CommandLink, limits: FailsafeConfig, stops: int) -> requests.Lease:
    """What the client of a new lease is told."""
    return requests.Lease(
        token=lease.token,
        stops=stops,
        lease_s=limits.lease_s,
        level_s=limits.level_s,
        stop_s=limits.stop_s,
        uri=link.uri,
        state=link.state.value,
        firmware=link.firmware,
        holds_height=link.holds_height,
        holds_place=link.holds_place,
        software=is_software(link.uri),
        craft=identity_of(link),
    )


def identity_of(link: CommandLink) -> requests.CraftIdentity:
    """Which craft it is, as far as it says so."""
    return requests.CraftIdentity(
        uri=link.uri, vehicle=link.vehicle, firmware=link.firmware, id=link.craft_id
    )
