"""The dead man's clock: it does not depend on the load of the loop that it watches."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from groundstation.background import in_background

STOOD_S = 0.3
"""A loop that did not turn for so long stood still."""
TURN_S = STOOD_S / 3
"""Between two turns that are counted."""
WAKES_S = 0.5
"""So long after that requests come in that were made before."""


async def watch(
    look: Callable[[float], None],
    turn: Callable[[float], None],
    clock: Callable[[], float],
    every_s: Callable[[], float],
) -> None:
    """Call ``look`` from a thread of its own, so often as ``every_s`` says each time, and ``turn``
    from this loop, each with the time. Raises what ``look`` does."""
    ended = threading.Event()

    def keep_looking() -> None:
        while not ended.wait(every_s()):
            look(clock())

    looking = asyncio.ensure_future(in_background(keep_looking))
    try:
        while not looking.done():
            turn(clock())
            await asyncio.sleep(TURN_S)
        await looking
    finally:
        ended.set()
        looking.cancel()


class Standstill:
    """Whether what is heard now may have been said long ago: what waits in sockets while a process
    stands still has no age."""

    def __init__(self) -> None:
        self._turned_s: float | None = None
        self._until_s = 0.0

    def turn(self, now_s: float) -> None:
        """The loop that hears requests has turned."""
        if self._stands(now_s):
            self._until_s = now_s + WAKES_S
        self._turned_s = now_s

    def holds(self, now_s: float) -> bool:
        """Whether it stands still, or did so just now."""
        return self._stands(now_s) or now_s < self._until_s

    def _stands(self, now_s: float) -> bool:
        return self._turned_s is not None and now_s - self._turned_s > STOOD_S
