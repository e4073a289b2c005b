"""CRTP on UDP: the stand-in as official clients reach it (``udp://host:port``)."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from firmware_sim.craft import StandIn
from firmware_sim.crtp import Conversation

DEFAULT_PORT = 19850
"""Where clients that scan look first."""
LOG_TICK_S = 0.01
MAX_CLIENTS = 8
"""Beyond these the client that has been silent for longest is forgotten."""

Address = tuple[Any, ...]


@dataclass(slots=True)
class ServerCounts:
    """Datagrams since the start: taken, answered, and clients forgotten for room."""

    received: int = 0
    sent: int = 0
    forgotten: int = 0


class CrtpServer(asyncio.DatagramProtocol):
    """Serves a craft that somebody else advances. ``close`` may be called twice."""

    def __init__(self, craft: StandIn, host: str = "127.0.0.1", port: int = DEFAULT_PORT) -> None:
        self.counts = ServerCounts()
        self._craft = craft
        self._address = (host, port)
        self._clients: OrderedDict[Address, Conversation] = OrderedDict()
        self._transport: asyncio.DatagramTransport | None = None
        self._logging: asyncio.Task[None] | None = None
        self._unbound = asyncio.Event()

    async def start(self) -> None:
        """Bind and serve. Raises OSError when the port is taken."""
        loop = asyncio.get_running_loop()
        self._unbound.clear()
        self._transport, _ = await loop.create_datagram_endpoint(
            lambda: self, local_addr=self._address
        )
        self._logging = loop.create_task(self._log(), name="crtp-log")

    @property
    def port(self) -> int:
        """The port that is served (useful after asking for port 0)."""
        if self._transport is None:
            return self._address[1]
        return int(self._transport.get_extra_info("sockname")[1])

    async def close(self) -> None:
        """Stop serving; the port is free behind it."""
        if self._logging is not None:
            self._logging.cancel()
            await asyncio.gather(self._logging, return_exceptions=True)
            self._logging = None
        if self._transport is not None:
            self._transport.close()
            self._transport = None
            await self._unbound.wait()

    def connection_lost(self, exc: Exception | None) -> None:
        self._unbound.set()

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self.counts.received += 1
        client = self._clients.get(addr)
        if client is None:
            client = self._clients[addr] = Conversation(self._craft)
            if len(self._clients) > MAX_CLIENTS:
                self._clients.popitem(last=False)
                self.counts.forgotten += 1
        self._clients.move_to_end(addr)
        for packet in client.answer(data):
            self._send(packet, addr)

    def error_received(self, exc: Exception) -> None:
        """A client went away: its port answers no more. Its own silence is what matters."""

    def _send(self, packet: bytes, addr: Address) -> None:
        if self._transport is not None:
            self._transport.sendto(packet, addr)
            self.counts.sent += 1

    async def _log(self) -> None:
        while True:
            await asyncio.sleep(LOG_TICK_S / 2)
            now_ms = self._craft.uptime_ms
            for addr, client in list(self._clients.items()):
                for packet in client.due(now_ms):
                    self._send(packet, addr)
