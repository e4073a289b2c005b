"""Between cflib's threads and ours: futures that callbacks of either side settle, and packets."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

LOG_CONTROL = (5, 1)
"""Port and channel of the requests that make, start and end log blocks."""
CREATE, APPEND, CREATE_V2, APPEND_V2, START_V2 = 0, 1, 6, 7, 8
NOT_TWICE = (CREATE, APPEND, CREATE_V2, APPEND_V2)


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


def crtp_packet(port: int, channel: int, data: bytes) -> Any:
    """One of cflib's packets."""
    from cflib.crtp.crtpstack import CRTPPacket

    made = CRTPPacket()
    made.set_header(port, channel)
    made.data = data
    return made


def ask_again(craft: Any, uri: str) -> None:
    """Let cflib's object send a request that UDP lost once more, as it does for a radio, and on no
    link a request that makes a log block or adds to one: whoever made the block starts over, for a
    block that was only half made, or had more added twice, sends something else."""
    send = craft.send_packet

    def once(
        packet: Any, expected_reply: tuple[int, ...] = (), resend: bool = False, wait_s: float = 0.2
    ) -> None:
        if uri.startswith("udp://") and (link := craft.link) is not None:
            link.needs_resending = True
        if (packet.port, packet.channel) == LOG_CONTROL and packet.data[0] in NOT_TWICE:
            expected_reply = ()
        send(packet, expected_reply, resend, wait_s)

    craft.send_packet = once


def protocol_of(craft: Any) -> int:
    """Version of CRTP that cflib's object speaks with, -1 for one that knows no versions."""
    return int(craft.platform.get_protocol_version())
