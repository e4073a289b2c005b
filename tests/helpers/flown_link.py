"""A stand-in link read by a task, for tests that command the craft meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from typing import Any

from groundstation.links.stand_in import StandInLink


def free_udp_port() -> int:
    """A port nobody has at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.asynccontextmanager
async def flown(options: dict[str, Any]) -> AsyncIterator[str]:
    """Fly a stand-in in real time; yields the URI on which it takes commands."""
    port = free_udp_port()
    async with StandInLink(options, crtp=("127.0.0.1", port)) as link:

        async def read() -> None:
            while True:
                await link.read()

        reading = asyncio.create_task(read())
        try:
            yield f"udp://127.0.0.1:{port}"
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
