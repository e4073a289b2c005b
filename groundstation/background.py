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


async def in_background(
    function: Callable[[], T], *, what: str = "", discard: Callable[[T], object] | None = None
) -> T:
    """What ``function`` gives, run in a daemon thread; when cancelled, the thread is left behind.

    The function must own everything it changes. what: a name for ``left_running``. discard:
    takes the result back when it comes after nobody waits any more.
    """
    loop = asyncio.get_running_loop()
    result: asyncio.Future[T] = loop.create_future()

    def settle(value: T | None, error: BaseException | None) -> None:
        if result.done():  # nobody waits any more
            if discard is not None and error is None:
                discard(value)  # type: ignore[arg-type]  # no error: it is a T
            return
        if error is not None:
            result.set_exception(error)
        else:
            result.set_result(value)  # type: ignore[arg-type]  # no error: it is a T

    def run() -> None:
        value, error = None, None
        try:
            value = function()
        except BaseException as raised:
            error = raised
        with contextlib.suppress(RuntimeError):  # the loop is closed: the program has ended
            loop.call_soon_threadsafe(settle, value, error)

    thread = threading.Thread(target=run, name=_NAME, daemon=True)
    thread.start()
    try:
        return await result
    except asyncio.CancelledError:
        thread.name = _left(what)
        if discard is not None and not result.cancelled() and result.exception() is None:
            discard(result.result())  # it came in the same moment
        raise


def left_running(what: str) -> bool:
    """Whether work of this name was left behind and runs: what hangs must not be begun again and
    again."""
    return any(thread.name == _left(what) for thread in threading.enumerate())


def _left(what: str) -> str:
    return f"{_NAME}, left: {what}"


def left_behind() -> bool:
    """Whether such a thread still runs: the interpreter cannot be torn down under a compiler."""
    return any(thread.name.startswith(_NAME) for thread in threading.enumerate())
