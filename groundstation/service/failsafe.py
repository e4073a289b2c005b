"""The failsafe's clock: it does not depend on the load of the loop that it watches."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from groundstation.background import in_background
from groundstation.service.freshness import STOOD_S

TURN_S = STOOD_S / 3
"""Between two turns that are counted."""


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
