"""A stand-in link read by a task, for tests that command the craft meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

from ports import free_port

from groundstation.links.stand_in import StandInLink


@contextlib.asynccontextmanager
async def flown(options: dict[str, Any]) -> AsyncIterator[str]:
    """Fly a stand-in in real time; yields the URI on which it takes commands."""
    port = free_port()
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
