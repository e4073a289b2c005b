"""The control API as a server: HTTP with limits on size, number, rate and patience."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from groundstation.documents import decode_json
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.service import overview
from groundstation.service.api import Operation, operations
from groundstation.service.connections import http_server
from groundstation.service.control_socket import ControlSocket
from groundstation.service.limits import RateLimit
from groundstation.service.metrics import CONTENT_TYPE, metrics
from groundstation.service.openapi import openapi
from groundstation.service.station import Station
from groundstation.text import printable

BODY_MOST = 1 << 16
CONNECTIONS_MOST = 64
REQUESTS_HZ, REQUESTS_BURST = 200.0, 400.0
"""Of all clients together; setpoints have a limit of their own, so that nobody's curiosity can
keep them from the craft."""
ROWS_HZ_LEAST = 1.0
"""Of a stream: one that is silent for longer would be taken for dead."""


class ControlServer:
    """Serves a station's control API on a Unix socket."""

    def __init__(self, station: Station, control: ControlSocket) -> None:
        self._station, self._socket = station, control.socket
        # what strangers send is no news, and faults of ours are events
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        self._server = http_server(control_app(station), CONNECTIONS_MOST, turned_away=self._full)
        self._task: asyncio.Task[None] | None = None

    def _full(self) -> None:
        self._station.turned_away += 1

    async def start(self) -> None:
        serving = self._server.serve(sockets=[self._socket])
        self._task = asyncio.create_task(serving, name="control")
        self._station.supervisor.adopt("control", self._task)

    async def stop(self) -> None:
        self._server.should_exit = True
        if self._task is not None:
            await self._task


def control_app(station: Station) -> Starlette:
    """The routes; every answer is JSON, errors as ``{"error": text}``: status 400 for what the
    station refuses, 403 for a token that is not in force and for web pages, 404 and 405 for what
    there is not, 409 for what another client holds, 413 and 429 beyond the limits, 500 for a fault
    of its own, which is an event too."""
    table = operations(station)
    guarded = partial(_guarded, station, RateLimit(REQUESTS_HZ, REQUESTS_BURST))

    def route(operation: Operation) -> Route:
        async def work(request: Request) -> Response:
            body = await _body(request, operation.body)
            return _Json(await operation.work(body))

        where = f"{operation.method} {operation.path}"
        return Route(
            operation.path,
            guarded(where, work, limited=operation.limited),
            methods=[operation.method],
        )

    async def nowhere(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        text = f"{request.method} {request.url.path}: {error.detail}; see GET /openapi.json"
        refusal = _refusal(error.status_code, text)
        refusal.headers.update(error.headers or {})
        return refusal

    return Starlette(
        routes=[
            *(route(operation) for operation in table),
            *(
                Route(path, guarded(f"GET {path}", work))
                for path, work in _others(station, openapi(table)).items()
            ),
        ],
        exception_handlers={HTTPException: nowhere},
    )


def _guarded(
    station: Station,
    rate: RateLimit,
    where: str,
    work: Callable[[Request], Awaitable[Response]],
    *,
    limited: bool = True,
) -> Callable[[Request], Awaitable[Response]]:
    """The answers of ``work`` within the limits, and a status for each of its errors."""

    async def answer(request: Request) -> Response:
        try:
            if limited and not rate.allows():
                station.turned_away += 1
                return _refusal(429, f"more than {REQUESTS_HZ:g} requests a second")
            if "origin" in request.headers:  # through a port that leads here, a browser's page
                return _refusal(403, "web pages are not answered here: use the daemon's own")
            return await work(request)
        except _TooLargeError as error:
            return _refusal(413, error)
        except NotAuthorisedError as error:
            return _refusal(403, error)
        except TakenError as error:
            return _refusal(409, error)
        except GroundStationError as error:
            return _refusal(400, error)
        except ClientDisconnect:
            return Response(status_code=499)
        except Exception as error:
            station.journal.fault(f"{where}: {error!r}", source="control")
            return _refusal(500, f"{where}: internal fault: {error!r}")

    return answer


def _others(
    station: Station, schema: dict[str, Any]
) -> dict[str, Callable[[Request], Awaitable[Response]]]:
    """What is asked by GET and answers something else than an operation, by path."""

    async def health(request: Request) -> Response:
        found = station.health.status(overview.problems(station))
        return _Json(found, status_code=200 if found["healthy"] else 503)

    async def scrape(request: Request) -> Response:
        return Response(metrics(station), media_type=CONTENT_TYPE)

    async def schema_of_all(request: Request) -> Response:
        return _Json(schema)

    async def stream(request: Request) -> Response:
        subscriber = station.stream.subscribe(_rows_hz(request))

        async def messages() -> AsyncIterator[bytes]:
            try:
                async for message in subscriber.messages():
                    yield message
            finally:
                station.stream.leave(subscriber)

        return StreamingResponse(messages(), media_type="text/event-stream")

    return {
        "/health": health,
        "/metrics": scrape,
        "/openapi.json": schema_of_all,
        "/stream": stream,
    }


class _TooLargeError(GroundStationError):
    pass


def _rows_hz(request: Request) -> float | None:
    """How many rows a second a client of the stream wants; None: all. Raises BadInputError."""
    text = request.query_params.get("rows_hz")
    if text is None:
        return None
    with contextlib.suppress(ValueError):
        if ROWS_HZ_LEAST <= (rows_hz := float(text)) < math.inf:
            return rows_hz
    raise BadInputError(f"rows_hz={printable(text)}: give a number of {ROWS_HZ_LEAST:g} or more")


async def _body(request: Request, kind: type | None) -> Any:
    """The request's JSON as ``kind``. Raises BadInputError with the path of what is wrong."""
    content = bytearray()
    async for piece in request.stream():
        content += piece
        if len(content) > BODY_MOST:
            raise _TooLargeError(f"the request is longer than {BODY_MOST} bytes")
    if kind is None:
        return None
    try:
        return decode_json(content, kind)
    except ValueError as error:
        raise BadInputError(f"the request's body: {error}") from error


def _refusal(status: int, error: GroundStationError | str) -> Response:
    return _Json({"error": printable(str(error))}, status_code=status)


class _Json(Response):
    media_type = "application/json"

    def render(self, content: Any) -> bytes:
        try:
            return msgspec.json.encode(content, enc_hook=str)
        except UnicodeEncodeError:  # the name of a file that is not UTF-8
            return json.dumps(content, separators=(",", ":"), default=str).encode("ascii")
