"""Between cflib's threads and ours: futures that callbacks of either side settle, and packets."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Any

LOG_CONTROL = (5, 1)
"""Port and channel of the requests that make, start and end log blocks."""
CREATE, APPEND, START, CREATE_V2, APPEND_V2, START_V2 = 0, 1, 3, 6, 7, 8
NOT_TWICE = (CREATE, APPEND, START, CREATE_V2, APPEND_V2, START_V2)


def resolve(future: asyncio.Future[Any], result: Any) -> None:
    """Set a future once, from whichever callback comes first."""
    if future.done():
        return
    if isinstance(result, Exception):
        future.set_exception(result)
    else:
        future.set_result(result)


def elsewhere(function: Callable[[], None]) -> None:
    """Let a thread of its own call it: one that may not wait for the thread that asks."""
    threading.Thread(target=function, daemon=True).start()


def newest_only(
    loop: asyncio.AbstractEventLoop, function: Callable[[Any], None]
) -> Callable[[Any], None]:
    """For another thread: lets the loop call ``function`` with the newest of what it is given; one
    call waits at most, however fast they come."""
    lock, waiting = threading.Lock(), list[Any]()

    def call() -> None:
        with lock:
            value = waiting.pop()
        function(value)

    def tell(value: Any) -> None:
        with lock:
            is_first = not waiting
            waiting[:] = [value]
        if is_first:
            with contextlib.suppress(RuntimeError):  # cflib's threads may outlast the loop
                loop.call_soon_threadsafe(call)

    return tell


def crtp_packet(port: int, channel: int, data: bytes) -> Any:
    """One of cflib's packets."""
    from cflib.crtp.crtpstack import CRTPPacket

    made = CRTPPacket()
    made.set_header(port, channel)
    made.data = data
    return made


def ask_again(craft: Any, uri: str) -> Callable[[], None]:
    """Let cflib's object send a request that UDP lost once more, as it does for a radio, and on no
    link a request that makes a log block, adds to one or starts it: who made the block starts over,
    for one that was half made, or had more added twice, sends something else, and one that is
    started twice skips a moment.

    What is returned lets it send nothing any more: what it still wants to ask again would find the
    link gone.
    """
    send, sending, hushed = craft.send_packet, threading.Lock(), threading.Event()

    def once(
        packet: Any, expected_reply: tuple[int, ...] = (), resend: bool = False, wait_s: float = 0.2
    ) -> None:
        with sending:
            link = craft.link
            if link is None or hushed.is_set():
                return
            link.needs_resending |= uri.startswith("udp://")
            if (packet.port, packet.channel) == LOG_CONTROL and packet.data[0] in NOT_TWICE:
                expected_reply = ()
            try:
                send(packet, expected_reply, resend, wait_s)
            except AttributeError:  # lost at this moment; cflib keeps its own lock
                if craft.link is not None:
                    raise
                with contextlib.suppress(RuntimeError):
                    craft._send_lock.release()

    def hush() -> None:
        with sending:
            hushed.set()

    craft.send_packet = once
    return hush


def begin_once(craft: Any) -> None:
    """Let the first answer alone begin the reading of a craft's tables.

    cflib begins anew with each that says which protocol is spoken, of which several may come late
    together; it then clears the log of the craft once more, at any moment, and whoever logs by
    then hears nothing any more.
    """
    fetch = craft.platform.fetch_platform_informations

    def fetch_once(callback: Callable[[], None]) -> None:
        begun = threading.Event()

        def begin() -> None:
            if not begun.is_set():
                begun.set()
                callback()

        fetch(begin)

    craft.platform.fetch_platform_informations = fetch_once


def protocol_of(craft: Any) -> int:
    """Version of CRTP that cflib's object speaks with, -1 for one that knows no versions."""
    return int(craft.platform.get_protocol_version())
