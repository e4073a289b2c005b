"""HTTP without endless patience: for a place, for a request, or for a reader."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterable, Iterator
from types import FrameType
from typing import Any

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_S = 10.0
"""A request must have arrived after so long."""
HEAD_MOST = 1 << 14
QUEUE = 2048
"""Connections that wait in the kernel."""
STALL_S = 20.0
"""A client that takes nothing of an answer for so long is cut off."""

_FULL = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"

Headers = Iterable[tuple[bytes, bytes]]


def http_server(
    app: ASGIApp,
    most: int,
    knows: Callable[[Headers], bool] = lambda headers: True,
    turned_away: Callable[[], None] = lambda: None,
) -> uvicorn.Server:
    """A server with ``most`` places. knows: whether a request's headers are those of somebody who
    was let in: who has shown nothing makes room for another, so that nobody can sit on every place.
    turned_away: told of each connection that came to a full house."""
    settings = {
        "most": most,
        "knows": staticmethod(knows),
        "turned_away": staticmethod(turned_away),
    }
    return _Server(
        uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            lifespan="off",
            http=type("_Patient", (_Protocol,), settings),
            ws="none",
            h11_max_incomplete_event_size=HEAD_MOST,
            server_header=False,
            timeout_graceful_shutdown=1,
            # so many are let in at each turn of the event loop, which reads what they said two
            # turns later: fewer come until then than can push out one whose request is there
            backlog=most // 4,
        )
    )


class _Server(uvicorn.Server):
    """Leaves signals to the program; lets in few connections at a time of many that wait."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for one in sockets or ():
            one.listen(QUEUE)

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.should_exit = True


class _Protocol(H11Protocol):
    most: int
    knows: Callable[[Headers], bool]
    turned_away: Callable[[], None]
    _since_s = 0.0
    _arriving: asyncio.TimerHandle | None = None
    _stalled: asyncio.TimerHandle | None = None

    # the server opens streams only: a narrower type than any transport's
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._since_s = self.loop.time()
        if len(self.connections) > self.most:
            self.turned_away()
            others: list[Any] = [one for one in self.connections if one is not self]
            strangers = [one for one in others if _is_stranger(one)]
            if not strangers:
                transport.write(_FULL)
                transport.close()
                return
            min(strangers, key=lambda one: one._since_s).transport.abort()
        self._arriving = self.loop.call_later(REQUEST_S, transport.abort)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            _cancel(self._arriving)
            self._arriving = None
        elif self._arriving is None:
            self._arriving = self.loop.call_later(REQUEST_S, self.transport.abort)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._stalled = self.loop.call_later(STALL_S, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        _cancel(self._stalled)

    def connection_lost(self, exc: Exception | None) -> None:
        _cancel(self._arriving)
        _cancel(self._stalled)
        super().connection_lost(exc)


def _is_stranger(one: Any) -> bool:
    """Without a whole request so far, or one that was not let in with its last."""
    if one.transport.is_closing():
        return False
    return one.headers is None or not one.knows(one.headers)


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
