"""The control API: HTTP on a Unix socket that only its owner can reach."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import os
import socket
import stat
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from groundstation.errors import (
    BadInputError,
    GroundStationError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.service.api import Operation, operations
from groundstation.service.config import shared_folder
from groundstation.service.station import Station
from groundstation.text import printable

BACKLOG = 16
BODY_MOST = 1 << 16
PATH_MOST = 107
"""Bytes a Unix socket's address can hold."""


class ControlSocket:
    """The listening socket, held by a lock so that one daemon at a time has it."""

    def __init__(self, path: Path) -> None:
        if len(os.fsencode(path)) > PATH_MOST:
            raise GroundStationError(
                f"control socket {path}: longer than {PATH_MOST} bytes; set a shorter one with "
                "[control] socket or GROUNDSTATION_SOCKET"
            )
        self.path = path
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if path.parent == shared_folder():
                _require_private(path.parent)
            self._lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise GroundStationError(f"control socket {path}: {error.strerror}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.read(self._lock, 32).decode(errors="replace").strip()
            os.close(self._lock)
            raise TakenError(
                f"control socket {path} is taken by another groundstation (process {owner}); stop "
                "it, or give this one its own with GROUNDSTATION_SOCKET or [control] socket"
            ) from error
        os.ftruncate(self._lock, 0)
        os.pwrite(self._lock, str(os.getpid()).encode(), 0)
        if path.exists() and not path.is_socket():
            os.close(self._lock)
            raise GroundStationError(f"control socket {path}: is not a socket; choose another path")
        path.unlink(missing_ok=True)  # left by a daemon that was killed: nobody holds the lock
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            self.socket.bind(str(path))
        finally:
            os.umask(before)
        self.socket.listen(BACKLOG)
        self.socket.setblocking(False)

    def close(self) -> None:
        """Remove the socket and release the lock."""
        self.socket.close()
        self.path.unlink(missing_ok=True)
        os.close(self._lock)


def _require_private(folder: Path) -> None:
    """In a folder where anyone can write, someone else may have been there first."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise GroundStationError(
            f"control socket: {folder} is not a folder of yours alone (owner {found.st_uid}, mode "
            f"{stat.S_IMODE(found.st_mode):04o}); remove it, or set GROUNDSTATION_SOCKET"
        )


class _Server(uvicorn.Server):
    """Leaves signals to the daemon."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.should_exit = True


class ControlServer:
    """Serves a station's control API on ``control``."""

    def __init__(self, station: Station, control: ControlSocket) -> None:
        self._control = control
        self._server = _Server(
            uvicorn.Config(
                control_app(station),
                log_config=None,
                access_log=False,
                lifespan="off",
                ws="none",
                timeout_graceful_shutdown=1,
            )
        )
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        self._task = asyncio.create_task(
            self._server.serve(sockets=[self._control.socket]), name="control"
        )

    async def stop(self) -> None:
        self._server.should_exit = True
        if self._task is not None:
            await self._task


def control_app(station: Station) -> Starlette:
    """The routes; every answer is JSON, errors as ``{"error": text}``: status 400 for what the
    station refuses, 403 for a token that is not in force, 409 for what another client holds,
    413 and 429 beyond the limits, 500 for a fault of its own, which is an event too."""

    def answering(operation: Operation) -> Callable[[Request], Awaitable[Response]]:
        where = f"{operation.method} {operation.path}"

        async def answer(request: Request) -> Response:
            try:
                body = await _body(request, operation.body)
                return _Json(await operation.work(body))
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
                station.fault(f"{where}: {error!r}", source="control")
                return _refusal(500, f"{where}: internal fault: {error!r}")

        return answer

    async def stream(request: Request) -> Response:
        try:
            subscriber = station.stream.subscribe()
        except TakenError as error:
            return _refusal(409, error)

        async def messages() -> AsyncIterator[bytes]:
            try:
                async for message in subscriber.messages():
                    yield message
            finally:
                station.stream.leave(subscriber)

        return StreamingResponse(messages(), media_type="text/event-stream")

    return Starlette(
        routes=[
            *(
                Route(each.path, answering(each), methods=[each.method])
                for each in operations(station)
            ),
            Route("/stream", stream),
        ]
    )


class _TooLargeError(GroundStationError):
    pass


async def _body(request: Request, kind: type | None) -> Any:
    """The request's JSON as ``kind``. Raises BadInputError with the path of what is wrong."""
    if kind is None:
        return None
    content = b""
    async for piece in request.stream():
        content += piece
        if len(content) > BODY_MOST:
            raise _TooLargeError(f"the request is longer than {BODY_MOST} bytes")
    try:
        return msgspec.json.decode(content, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
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
