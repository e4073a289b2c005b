"""What Ctrl-C and its relatives do to the daemon."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from types import FrameType

PATIENCE_S = 1.0
"""What an orderly end is still given after the second signal."""
_NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextlib.contextmanager
def stopped_by_signals(stop: Callable[[], None], last_resort: Callable[[], None]) -> Iterator[None]:
    """While inside, SIGINT, SIGTERM or SIGHUP calls ``stop`` on the running loop.

    A second signal ends the process with status 128 + its number, unless it ends by itself
    within a second: after ``last_resort``, called from another thread, whatever the loop does.
    """
    loop = asyncio.get_running_loop()
    ended = threading.Event()
    received: list[int] = []

    def give_up() -> None:
        if not ended.wait(PATIENCE_S):
            try:
                last_resort()
            finally:
                os._exit(128 + received[1])

    def handle(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) == 1:
            loop.call_soon_threadsafe(stop)
        elif len(received) == 2:
            threading.Thread(target=give_up, name="give-up", daemon=True).start()

    # nohup: a signal that is ignored stays so
    numbers = [n for n in _NUMBERS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    # not the loop's own handlers: those say nothing while the loop is blocked
    before = {number: signal.signal(number, handle) for number in numbers}
    # a signal that comes just before the loop waits would wait with it
    awake, wake = socket.socketpair()
    for end in (awake, wake):
        end.setblocking(False)
    former = signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)
    loop.add_reader(awake, awake.recv, 64)
    try:
        yield
    finally:
        ended.set()
        loop.remove_reader(awake)
        signal.set_wakeup_fd(former)
        awake.close()
        wake.close()
        for number, handler in before.items():
            signal.signal(number, handler)
