"""Between cflib's threads and ours: futures that callbacks of either side settle, and packets."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any


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


def protocol_of(craft: Any) -> int:
    """Version of CRTP that cflib's object speaks with, -1 for one that knows no versions."""
    return int(craft.platform.get_protocol_version())
