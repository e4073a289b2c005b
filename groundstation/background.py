"""Work that must not hold up the end of the program: in threads that nobody waits for.

``asyncio.to_thread`` uses an executor whose threads are joined when the loop closes. A compiler
run cannot be interrupted, so Ctrl-C would wait for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

_NAME = "groundstation-background"


async def in_background(function: Callable[[], T]) -> T:
    """What ``function`` gives, run in a daemon thread; when cancelled, the thread is left behind.

    The function must own everything it changes.
    """
    loop = asyncio.get_running_loop()
    result: asyncio.Future[T] = loop.create_future()

    def settle(value: T | None, error: BaseException | None) -> None:
        if result.done():
            return  # nobody waits any more
        if error is not None:
            result.set_exception(error)
        else:
            result.set_result(value)  # type: ignore[arg-type]

    def run() -> None:
        value, error = None, None
        try:
            value = function()
        except BaseException as raised:
            error = raised
        with contextlib.suppress(RuntimeError):  # the loop is closed: the program has ended
            loop.call_soon_threadsafe(settle, value, error)

    threading.Thread(target=run, name=_NAME, daemon=True).start()
    return await result


def left_behind() -> bool:
    """Whether such a thread still runs: the interpreter cannot be torn down under a compiler."""
    return any(thread.name == _NAME for thread in threading.enumerate())
