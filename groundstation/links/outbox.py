"""What waits for the radio, and for how long it is worth sending."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from groundstation.errors import LinkError

LOCKS_AFTER_S = 2.0
"""Today's firmware stops a craft that heard no setpoint for so long, and locks its thrust."""
SEND_S = 2.5
"""cflib waits 2 s for a radio that takes nothing."""
REQUESTS_MOST = 8
"""Requests to arm, disarm and stop; the oldest is dropped, for the newest is what is wanted."""


@dataclass(frozen=True, slots=True)
class _Setpoint:
    """until_s: monotonic; later it is worth nothing. unlocks: whether it holds thrust, which may
    have to be unlocked first."""

    send: Callable[[], None]
    until_s: float
    unlocks: bool


@dataclass(frozen=True, slots=True)
class _Request:
    """until_s: monotonic; later it is not sent. arms: whether it asks for motors that turn."""

    send: Callable[[], None]
    until_s: float
    arms: bool


class Outbox:
    """The newest setpoint, and the requests in their order; safe to use from any thread.

    unlock: sends zero thrust, for a firmware that takes thrust only after it, again after each
    silence; None for one that does not. clock: monotonic, s. expired: what had grown too old to be
    sent.
    """

    def __init__(
        self, unlock: Callable[[], None] | None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.expired = 0
        self._unlock, self._clock = unlock, clock
        self._sent_s = -LOCKS_AFTER_S
        self._setpoint: _Setpoint | None = None
        self._requests: deque[_Request] = deque(maxlen=REQUESTS_MOST)
        self._changed = threading.Condition()
        self._closing = False

    def put(self, send: Callable[[], None], until_s: float, *, unlocks: bool = True) -> bool:
        """A setpoint, in the place of one that still waits; whether there was one."""
        with self._changed:
            replaced = self._setpoint is not None
            self._setpoint = _Setpoint(send, until_s, unlocks)
            self._changed.notify()
        return replaced

    def request(
        self, send: Callable[[], None], *, until_s: float = math.inf, arms: bool = False
    ) -> None:
        """Something that is sent before the setpoint that waits, until then. arms: it asks for
        motors that turn, and can be withdrawn."""
        with self._changed:
            self._requests.append(_Request(send, until_s, arms))
            self._changed.notify()

    def withdraw_arming(self) -> None:
        """What asks for motors that turn, and waits, is not sent."""
        with self._changed:
            kept = [one for one in self._requests if not one.arms]
            self._requests.clear()
            self._requests.extend(kept)

    def close(self) -> None:
        """What waits is still sent."""
        with self._changed:
            self._closing = True
            self._changed.notify()

    def wait(self) -> bool:
        """Until something is to be sent; False when nothing will be any more."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._requests or self._setpoint is not None or self._closing
            )
            return bool(self._requests) or self._setpoint is not None

    def send(self) -> None:
        """Send what waits; may block for as long as the radio does."""
        while (request := self._next()) is not None:
            if self._clock() > request.until_s:
                self.expired += 1
            else:
                request.send()
        with self._changed:
            setpoint, self._setpoint = self._setpoint, None
        if setpoint is None:
            return
        silent_s = self._clock() - self._sent_s
        if self._unlock is not None and setpoint.unlocks and silent_s >= LOCKS_AFTER_S:
            self._unlock()
        # the last moment before the radio has it: a process may have stood still anywhere above
        if self._clock() > setpoint.until_s:
            self.expired += 1
            return
        setpoint.send()
        if setpoint.unlocks:
            self._sent_s = self._clock()

    def _next(self) -> _Request | None:
        """One at a time: the radio may block, and what waits behind it be withdrawn."""
        with self._changed:
            return self._requests.popleft() if self._requests else None


class Sender:
    """Hands setpoints and requests to cflib from a thread of its own, for a radio may block for
    seconds.

    locks: whether the firmware takes thrust only after zero thrust, again after each silence.
    """

    def __init__(self, craft: Any, *, locks: bool) -> None:
        def unlock() -> None:
            craft.commander.send_setpoint(0, 0, 0, 0)

        self.outbox = Outbox(unlock if locks else None)
        self._thread = threading.Thread(target=self._run, name="setpoints", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send what waits, if the radio takes it soon, and end."""
        self.outbox.close()
        self._thread.join(SEND_S)

    def _run(self) -> None:
        while self.outbox.wait():
            with contextlib.suppress(LinkError):  # it has gone meanwhile
                self.outbox.send()
