"""``python -m groundstation.page LISTENING_FD CONTROL_SOCKET``: serves the page until it is ended.

Begun by the daemon (``service/page.py``), which hands over the port and the key of the cookies. An
empty line on stderr every half second is a sign of life.
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
from pathlib import Path

from groundstation.page.app import Access, page_app
from groundstation.page.follower import Follower
from groundstation.service.client import http_server

BEAT_S = 0.5
CONNECTIONS_MOST = 200
"""A browser has six at most."""


async def serve(listening: socket.socket, control: Path, key: str) -> None:
    """Serve browsers on ``listening`` for as long as the process lives."""
    follower = Follower(control)
    access = Access(bytes.fromhex(key), listening.getsockname()[1])
    server = http_server(page_app(control, access, follower), CONNECTIONS_MOST, access.knows)
    beat = asyncio.create_task(_beat())
    try:
        await server.serve(sockets=[listening])
    finally:
        beat.cancel()


async def _beat() -> None:
    while True:
        print(file=sys.stderr, flush=True)
        await asyncio.sleep(BEAT_S)


if __name__ == "__main__":
    asyncio.run(
        serve(
            socket.socket(fileno=int(sys.argv[1])),
            Path(sys.argv[2]),
            os.environ.pop("GROUNDSTATION_PAGE_KEY"),
        )
    )
