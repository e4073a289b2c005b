"""The control API: its table of operations, its schema, its server."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from groundstation import __version__
from groundstation.documents import decode_json
from groundstation.dynamics.registry import EFFECTS
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    NotAuthorisedError,
    TakenError,
)
from groundstation.links.command import LinkEvent
from groundstation.links.factory import STAND_IN, argument_of, is_stand_in, split_name
from groundstation.recording.mcap_scan import CatalogueEntry
from groundstation.service import overview, requests
from groundstation.service.client import http_server
from groundstation.service.config import ControlSocket, RateLimit, settings
from groundstation.service.jobs import Devices, Job, ModelEntry
from groundstation.service.overview import CONTENT_TYPE, metrics
from groundstation.service.requests import HealthStatus, Status
from groundstation.service.station import Station
from groundstation.telemetry.packet import port_and_baud
from groundstation.text import printable

# The control API as a table: what can be asked, with which body, and what answers.


Work = Callable[[Any], Awaitable[Any]]


@dataclass(frozen=True, slots=True)
class Operation:
    """One thing that can be asked. body: type of the request's JSON, None for no body. limited:
    whether it counts against the rate of all requests."""

    method: str
    path: str
    summary: str
    work: Work
    body: type | None = None
    answer: Any = dict[str, Any]
    limited: bool = True


def operations(station: Station) -> list[Operation]:
    """Everything a client can ask of ``station``."""
    parts = (_telemetry, _jobs, _settings, _lease, _stored, _command)
    return [one for part in parts for one in part(station)]


def _done(call: Callable[[Any], object]) -> Work:
    """What is done with a request's body and has nothing to say."""

    async def work(body: Any) -> requests.Done:
        call(body)
        return requests.Done()

    return work


def _telemetry(station: Station) -> list[Operation]:
    async def status(_: None) -> Any:
        return overview.status_of(station)

    async def events(_: None) -> Any:
        return [asdict(event) for event in station.journal.events]

    async def record_start(_: None) -> Any:
        await station.recordings.start()
        return station.sessions.status()

    async def record_stop(_: None) -> Any:
        return await station.recordings.stop()

    async def recordings(_: None) -> Any:
        return await asyncio.to_thread(station.recordings.entries)

    async def switch(body: requests.LinkName) -> Any:
        name, model = permitted_link(body.name, station.sessions.folder), ""
        if is_stand_in(name) and name != STAND_IN:
            model = await asyncio.to_thread(station.models.file, split_name(name)[1])
        await station.switch_link(name, model)
        return overview.status_of(station)

    async def devices(_: None) -> Any:
        return await station.devices.look()

    return [
        Operation("GET", "/status", "What the daemon is doing", status, answer=Status),
        Operation(
            "GET", "/events", "The latest events, oldest first", events, answer=list[LinkEvent]
        ),
        Operation("POST", "/record/start", "Begin a new recording", record_start),
        Operation("POST", "/record/stop", "Finish the recording", record_stop),
        Operation(
            "POST",
            "/record/mark",
            "Put a note into the recording",
            _done(lambda body: station.mark(body.text, body.details)),
            requests.Mark,
            requests.Done,
        ),
        Operation(
            "GET",
            "/recordings",
            "The folder's recordings by name",
            recordings,
            answer=list[CatalogueEntry],
        ),
        Operation(
            "POST",
            "/link",
            "Receive from another link, recording on",
            switch,
            requests.LinkName,
            Status,
        ),
        Operation("GET", "/devices", "What is plugged in or in reach", devices, answer=Devices),
    ]


def _jobs(station: Station) -> list[Operation]:
    async def jobs(_: None) -> Any:
        return await asyncio.to_thread(station.jobs.entries)

    async def job_start(body: requests.NewJob) -> Any:
        return station.jobs.add(
            body.kind,
            body.recordings,
            body.validate,
            body.model,
            body.effects,
            body.measured_rotors,
        )

    async def job_log(body: requests.JobName) -> Any:
        return requests.JobLog(text=await asyncio.to_thread(station.jobs.log, body.id))

    async def job_cancel(body: requests.JobName) -> Any:
        return await station.jobs.cancel(body.id)

    async def models(_: None) -> Any:
        return await asyncio.to_thread(station.models.entries)

    async def effects(_: None) -> Any:
        return [requests.EffectEntry(name=one.name, adds=one.adds) for one in EFFECTS.values()]

    async def watch(body: requests.Watched) -> Any:
        model = await asyncio.to_thread(station.models.file, body.model) if body.model else ""
        station.twin.configure(model)
        return overview.status_of(station)

    return [
        Operation("GET", "/jobs", "Work on recordings, the oldest first", jobs, answer=list[Job]),
        Operation(
            "POST",
            "/jobs/start",
            "Begin a job, or let it wait for its turn",
            job_start,
            requests.NewJob,
            Job,
        ),
        Operation(
            "POST",
            "/jobs/log",
            "The end of a job's log",
            job_log,
            requests.JobName,
            requests.JobLog,
        ),
        Operation(
            "POST",
            "/jobs/cancel",
            "End a job that waits or runs",
            job_cancel,
            requests.JobName,
            Job,
        ),
        Operation(
            "GET",
            "/models",
            "The models that jobs have made, and the built-in one",
            models,
            answer=list[ModelEntry],
        ),
        Operation(
            "GET",
            "/effects",
            "The effects that a model can have",
            effects,
            answer=list[requests.EffectEntry],
        ),
        Operation(
            "POST",
            "/models/watch",
            "Watch the craft with a model, or with none",
            watch,
            requests.Watched,
            Status,
        ),
    ]


def _settings(station: Station) -> list[Operation]:
    async def configuration(_: None) -> Any:
        return {each.name: each.value for each in settings(station.config)}

    async def page_address(_: None) -> Any:
        return requests.PageAddress(url=station.page.address())

    return [
        Operation(
            "POST",
            "/page/address",
            "A new address of the operator's page",
            page_address,
            answer=requests.PageAddress,
        ),
        Operation(
            "POST",
            "/page/admit",
            "Use up the token of such an address",
            _done(lambda body: station.page.admit(body.token)),
            requests.PageToken,
            requests.Done,
        ),
        Operation("GET", "/config", "Every key of the configuration in force", configuration),
    ]


def _lease(station: Station) -> list[Operation]:
    """What the one client that commands asks."""
    commander = station.commander

    async def acquire(body: requests.Acquire) -> Any:
        return commander.acquire(body.client, body.stops)

    async def setpoint(body: requests.Setpoint) -> Any:
        values = msgspec.structs.asdict(body)
        time_ns = commander.setpoint(values.pop("token"), **values)
        return requests.Sent(
            time_ns=time_ns,
            telemetry=station.newest.telemetry(),
            link_state=station.receiver.state.value,
            hindrance=commander.supervisor.hindrance,
            height_m=commander.supervisor.height_m,
            place=overview.place(commander.link),
        )

    async def stop_own(body: requests.Holder) -> Any:
        return requests.Stopped(motors=await commander.stop_own(body.token))

    async def land_own(body: requests.Holder) -> Any:
        return requests.Stopped(motors=await commander.land_own(body.token))

    async def write_parameters(body: requests.Parameters) -> Any:
        return requests.Values(values=await commander.write_parameters(body.token, body.values))

    return [
        Operation(
            "POST",
            "/command/acquire",
            "Become the one client that commands",
            acquire,
            requests.Acquire,
            requests.Lease,
        ),
        Operation(
            "POST",
            "/command/release",
            "Land the craft, or stop its motors, and give the lease back",
            _done(lambda body: commander.release(body.token)),
            requests.Holder,
            requests.Done,
        ),
        Operation(
            "POST",
            "/command/keep",
            "Keep the lease while nothing is sent",
            _done(lambda body: commander.keep(body.token)),
            requests.Holder,
            requests.Done,
        ),
        Operation(
            "POST",
            "/command/setpoint",
            "Send one setpoint, up to 100 a second",
            setpoint,
            requests.Setpoint,
            requests.Sent,
            limited=False,
        ),
        Operation(
            "POST",
            "/command/stop_own",
            "Stop the motors and keep the lease",
            stop_own,
            requests.Holder,
            requests.Stopped,
            limited=False,
        ),
        Operation(
            "POST",
            "/command/land_own",
            "Land the craft and keep the lease",
            land_own,
            requests.Holder,
            requests.Stopped,
            limited=False,
        ),
        Operation(
            "POST",
            "/command/announce",
            "Say what is about to happen to the craft",
            _done(lambda body: commander.announce(body.token, body.text, body.in_s)),
            requests.Announcement,
            requests.Done,
        ),
        Operation(
            "POST",
            "/command/parameters",
            "Write parameters and read them back",
            write_parameters,
            requests.Parameters,
            requests.Values,
        ),
    ]


def _stored(station: Station) -> list[Operation]:
    """What the craft keeps while it is switched off."""
    keeping = station.commander.stored

    async def stored(_: None) -> Any:
        return requests.StoredValues(parameters=await keeping.states())

    async def store(body: requests.StoredNames) -> Any:
        return requests.StoredValues(parameters=await keeping.store(body.token, body.names))

    async def clear(body: requests.StoredNames) -> Any:
        return requests.StoredValues(parameters=await keeping.clear(body.token, body.names))

    return [
        Operation(
            "GET",
            "/command/stored",
            "What the craft keeps while it is switched off",
            stored,
            answer=requests.StoredValues,
        ),
        Operation(
            "POST",
            "/command/stored/store",
            "Let the craft keep present values while it is switched off",
            store,
            requests.StoredNames,
            requests.StoredValues,
        ),
        Operation(
            "POST",
            "/command/stored/clear",
            "Let the craft forget what it has stored",
            clear,
            requests.StoredNames,
            requests.StoredValues,
        ),
    ]


def _command(station: Station) -> list[Operation]:
    """What is asked of the craft, whoever commands."""
    commander, operator = station.commander, station.commander.operator

    async def stop(_: None) -> Any:
        ended = station.jobs.end_flying()
        return requests.Stopped(motors=await operator.stop(), ended=ended)

    async def land(_: None) -> Any:
        landing = asyncio.ensure_future(operator.land())
        await asyncio.sleep(0)  # it is refused at once, or has begun
        ended = [] if landing.done() and landing.exception() else station.jobs.end_flying()
        return requests.Stopped(motors=await landing, ended=ended)

    async def arm(body: requests.Armed) -> Any:
        await operator.arm(body.on)
        return requests.Done()

    async def recover(_: None) -> Any:
        await operator.recover()
        return requests.Done()

    async def connect(body: requests.CommandUri) -> Any:
        await station.craft.connect_command(body.uri)
        return overview.status_of(station)

    async def parameters(_: None) -> Any:
        return requests.Values(values=commander.parameters())

    async def restore(_: None) -> Any:
        return requests.Values(values=await commander.restore())

    return [
        Operation(
            "POST",
            "/command/stop",
            "Stop the motors, whoever commands",
            stop,
            answer=requests.Stopped,
            limited=False,
        ),
        Operation(
            "POST",
            "/command/land",
            "Land the craft, whoever commands",
            land,
            answer=requests.Stopped,
            limited=False,
        ),
        Operation(
            "POST",
            "/command/level",
            "Hold the craft level, or no more",
            _done(lambda body: operator.level(body.on)),
            requests.Level,
            requests.Done,
            limited=False,
        ),
        Operation(
            "POST",
            "/command/arm",
            "Arm the motors or disarm them, whoever commands",
            arm,
            requests.Armed,
            requests.Done,
        ),
        Operation(
            "POST",
            "/command/recover",
            "Let a crashed craft be ready again",
            recover,
            answer=requests.Done,
        ),
        Operation(
            "POST",
            "/command/connect",
            "Command the craft at another address",
            connect,
            requests.CommandUri,
            Status,
        ),
        Operation(
            "GET",
            "/command/parameters",
            "The craft's parameters",
            parameters,
            answer=requests.Values,
        ),
        Operation(
            "POST",
            "/command/restore",
            "Write former parameters back; what was, since the daemon began",
            restore,
            answer=requests.Values,
        ),
    ]


def permitted_link(name: str, folder: Path) -> str:
    """A link as a request may name it: no path leaves the recordings folder, no port is outside
    /dev. Raises BadInputError for another."""
    kind, argument = split_name(name)
    what = argument_of(name)
    if "\0" in argument:
        raise BadInputError("a path cannot hold a zero byte")
    if what == "FILE":
        path = _resolved(folder / argument)
        if not path.is_relative_to(folder.resolve()):
            raise BadInputError(
                f"{argument} is not in the recordings folder {folder}; for a file elsewhere start "
                f"a daemon with --link {kind}:FILE"
            )
        if path.exists() and not path.is_file():  # a pipe would be waited for for ever
            raise BadInputError(f"{path}: not a file; give the recording itself")
        return f"{kind}:{path}"
    if what == "PORT":
        try:
            port = Path(port_and_baud(argument)[0])
        except ValueError as error:
            raise BadInputError(str(error)) from error
        # where anyone may write, a link can lead elsewhere by the time it is opened
        for path in (Path(os.path.abspath(port)), _resolved(port)):
            if not path.is_relative_to("/dev") or any(map(path.is_relative_to, _FOR_ALL)):
                raise BadInputError(f"{port} is not a device in /dev")
    return name


_FOR_ALL = ("/dev/shm", "/dev/mqueue")


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise BadInputError(f"{path}: leads nowhere") from error


# The control API's schema (OpenAPI 3.1), made from its table of operations.


_REFUSALS = {
    "400": "Refused; the text says why",
    "403": "The token is not in force",
    "409": "Another client has it",
    "413": "The request is too large",
    "429": "Too many requests",
}
_ERROR = {
    "type": "object",
    "properties": {"error": {"type": "string"}},
    "required": ["error"],
}


def openapi(operations: list[Operation]) -> dict[str, Any]:
    """The whole document. Requests are validated by the same types that it is made from."""
    kinds = [HealthStatus, *(operation.answer for operation in operations)]
    kinds += [operation.body for operation in operations if operation.body is not None]
    schemas, components = msgspec.json.schema_components(
        kinds, ref_template="#/components/schemas/{name}"
    )
    healthy, *rest = schemas
    answers, bodies = rest[: len(operations)], iter(rest[len(operations) :])
    paths: dict[str, Any] = {}
    for operation, answer in zip(operations, answers, strict=True):
        described: dict[str, Any] = {
            "summary": operation.summary,
            "responses": {
                "200": {"description": "Done", "content": _json(answer)},
                **{
                    status: {"description": text, "content": _json(_ERROR)}
                    for status, text in _REFUSALS.items()
                },
            },
        }
        if operation.body is not None:
            described["requestBody"] = {"required": True, "content": _json(next(bodies))}
        paths.setdefault(operation.path, {})[operation.method.lower()] = described
    health = {
        "200": {"description": "Healthy", "content": _json(healthy)},
        "503": {"description": "Not healthy, and why", "content": _json(healthy)},
    }
    paths["/health"] = {"get": {"summary": "Whether all is well", "responses": health}}
    paths["/metrics"] = {"get": _text("Figures for Prometheus", "text/plain")}
    stream = _text("Live telemetry as server-sent events", "text/event-stream")
    stream["parameters"] = [
        {
            "name": "rows_hz",
            "in": "query",
            "description": "About so many rows a second, the newest among them; else all",
            "schema": {"type": "number", "minimum": 1},
        }
    ]
    paths["/stream"] = {"get": stream}
    paths["/openapi.json"] = {
        "get": {
            "summary": "This document",
            "responses": {"200": {"description": "It", "content": _json({"type": "object"})}},
        }
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "groundstation control API", "version": __version__},
        "paths": paths,
        "components": {"schemas": components},
    }


def _json(schema: dict[str, Any]) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}


def _text(summary: str, kind: str) -> dict[str, Any]:
    content = {kind: {"schema": {"type": "string"}}}
    return {"summary": summary, "responses": {"200": {"description": "Text", "content": content}}}


# The control API as a server: HTTP with limits on size, number, rate and patience.


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
