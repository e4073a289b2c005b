"""Asking a craft to arm its motors, to disarm them or to recover from a crash, until it has
answered."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

from groundstation.errors import BadInputError, LinkError, TakenError
from groundstation.links.command import LOOK_S, TUMBLED, CommandLink

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
