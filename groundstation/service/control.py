"""The control API: its table of operations, the status, metrics and schema, its server."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import json
import logging
import math
import os
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
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
from groundstation.links.base import LinkState
from groundstation.links.command import CommandLink, LinkEvent
from groundstation.links.factory import STAND_IN, argument_of, is_stand_in, split_name
from groundstation.recording.mcap_scan import CatalogueEntry
from groundstation.service import requests
from groundstation.service.client import http_server
from groundstation.service.config import ControlSocket, RateLimit, settings
from groundstation.service.jobs import Devices, Job, ModelEntry
from groundstation.service.lease import identity_of
from groundstation.service.requests import HealthStatus, Place, Status
from groundstation.service.station import Station
from groundstation.telemetry.packet import port_and_baud
from groundstation.text import printable

# The control API as a table: what can be asked, with which body, and what answers.


@dataclass(frozen=True, slots=True)
class Operation:
    """One thing that can be asked. body: type of the request's JSON, None for no body. limited:
    whether it counts against the rate of all requests."""

    method: str
    path: str
    summary: str
    work: Callable[..., Any]
    body: type | None
    answer: Any
    limited: bool


class Table(list[Operation]):
    """Operations, each a function: its docstring is the summary, the types of its argument and of
    what it returns are the body and the answer (``answer`` where that says more)."""

    def get(self, path: str, answer: Any = None) -> Callable[[Callable[..., Any]], None]:
        return lambda work: self._add("GET", path, work, answer, True)

    def post(
        self, path: str, answer: Any = None, *, limited: bool = True
    ) -> Callable[[Callable[..., Any]], None]:
        return lambda work: self._add("POST", path, work, answer, limited)

    def _add(
        self, method: str, path: str, work: Callable[..., Any], answer: Any, limited: bool
    ) -> None:
        hints = get_type_hints(work)
        returned = hints.pop("return")
        answer = answer or (requests.Done if returned is type(None) else returned)
        body = next(iter(hints.values()), None)
        summary = (work.__doc__ or "").rstrip(".")
        self.append(Operation(method, path, summary, work, body, answer, limited))


def operations(station: Station) -> list[Operation]:
    """Everything a client can ask of ``station``."""
    table = Table()
    for part in (_telemetry, _jobs, _settings, _lease, _command):
        part(table, station)
    return table


def _telemetry(table: Table, station: Station) -> None:
    @table.get("/status", Status)
    def status() -> dict[str, Any]:
        """What the daemon is doing."""
        return status_of(station)

    @table.get("/events", list[LinkEvent])
    def events() -> list[dict[str, Any]]:
        """The latest events, oldest first."""
        return [asdict(event) for event in station.journal.events]

    @table.post("/record/start")
    async def record_start() -> dict[str, Any]:
        """Begin a new recording."""
        await station.recordings.start()
        return station.sessions.status()

    @table.post("/record/stop")
    async def record_stop() -> dict[str, Any]:
        """Finish the recording."""
        return await station.recordings.stop()

    @table.post("/record/mark")
    def mark(body: requests.Mark) -> None:
        """Put a note into the recording."""
        station.mark(body.text, body.details)

    @table.get("/recordings", list[CatalogueEntry])
    async def recordings() -> list[dict[str, Any]]:
        """The folder's recordings by name."""
        return await asyncio.to_thread(station.recordings.entries)

    @table.post("/link", Status)
    async def switch(body: requests.LinkName) -> dict[str, Any]:
        """Receive from another link, recording on."""
        name, model = permitted_link(body.name, station.sessions.folder), ""
        if is_stand_in(name) and name != STAND_IN:
            model = await asyncio.to_thread(station.models.file, split_name(name)[1])
        await station.switch_link(name, model)
        return status_of(station)

    @table.get("/devices")
    async def devices() -> Devices:
        """What is plugged in or in reach."""
        return await station.devices.look()


def _jobs(table: Table, station: Station) -> None:
    @table.get("/jobs")
    async def jobs() -> list[Job]:
        """Work on recordings, the oldest first."""
        return await asyncio.to_thread(station.jobs.entries)

    @table.post("/jobs/start")
    def job_start(body: requests.NewJob) -> Job:
        """Begin a job, or let it wait for its turn."""
        return station.jobs.add(**msgspec.structs.asdict(body))

    @table.post("/jobs/log")
    async def job_log(body: requests.JobName) -> requests.JobLog:
        """The end of a job's log."""
        return requests.JobLog(text=await asyncio.to_thread(station.jobs.log, body.id))

    @table.post("/jobs/cancel")
    async def job_cancel(body: requests.JobName) -> Job:
        """End a job that waits or runs."""
        return await station.jobs.cancel(body.id)

    @table.get("/models")
    async def models() -> list[ModelEntry]:
        """The models that jobs have made, and the built-in one."""
        return await asyncio.to_thread(station.models.entries)

    @table.get("/effects")
    def effects() -> list[requests.EffectEntry]:
        """The effects that a model can have."""
        return [requests.EffectEntry(name=one.name, adds=one.adds) for one in EFFECTS.values()]

    @table.post("/models/watch", Status)
    async def watch(body: requests.Watched) -> dict[str, Any]:
        """Watch the craft with a model, or with none."""
        model = await asyncio.to_thread(station.models.file, body.model) if body.model else ""
        station.twin.configure(model)
        return status_of(station)


def _settings(table: Table, station: Station) -> None:
    @table.post("/page/address")
    def page_address() -> requests.PageAddress:
        """A new address of the operator's page."""
        return requests.PageAddress(url=station.page.address())

    @table.post("/page/admit")
    def admit(body: requests.PageToken) -> None:
        """Use up the token of such an address."""
        station.page.admit(body.token)

    @table.get("/config")
    def configuration() -> dict[str, Any]:
        """Every key of the configuration in force."""
        return {each.name: each.value for each in settings(station.config)}


def _lease(table: Table, station: Station) -> None:
    """What the one client that commands asks."""
    commander = station.commander

    @table.post("/command/acquire")
    def acquire(body: requests.Acquire) -> requests.Lease:
        """Become the one client that commands."""
        return commander.acquire(body.client, body.stops)

    @table.post("/command/release")
    def release(body: requests.Release) -> None:
        """Land the craft, or stop its motors, and give the lease back."""
        commander.release(body.token, content=body.content)

    @table.post("/command/keep")
    def keep(body: requests.Holder) -> None:
        """Keep the lease while nothing is sent."""
        commander.keep(body.token)

    @table.post("/command/setpoint", limited=False)
    def setpoint(body: requests.Setpoint) -> requests.Sent:
        """Send one setpoint, up to 100 a second."""
        return requests.Sent(
            time_ns=commander.setpoint(**msgspec.structs.asdict(body)),
            telemetry=station.newest.telemetry(),
            link_state=station.receiver.state.value,
            hindrance=commander.supervisor.hindrance,
            height_m=commander.supervisor.height_m,
            place=place(commander.link),
        )

    @table.post("/command/stop_own", limited=False)
    async def stop_own(body: requests.Holder) -> requests.Stopped:
        """Stop the motors and keep the lease."""
        return requests.Stopped(motors=await commander.stop_own(body.token))

    @table.post("/command/land_own", limited=False)
    async def land_own(body: requests.Holder) -> requests.Stopped:
        """Land the craft and keep the lease."""
        return requests.Stopped(motors=await commander.land_own(body.token))

    @table.post("/command/announce")
    def announce(body: requests.Announcement) -> None:
        """Say what is about to happen to the craft."""
        commander.announce(body.token, body.text, body.in_s)

    @table.post("/command/parameters")
    async def write_parameters(body: requests.Parameters) -> requests.Values:
        """Write parameters and read them back."""
        return requests.Values(values=await commander.write_parameters(body.token, body.values))

    keeping = commander.stored

    @table.get("/command/stored")
    async def stored() -> requests.StoredValues:
        """What the craft keeps while it is switched off."""
        return requests.StoredValues(parameters=await keeping.states())

    @table.post("/command/stored/store")
    async def store(body: requests.StoredNames) -> requests.StoredValues:
        """Let the craft keep present values while it is switched off."""
        return requests.StoredValues(parameters=await keeping.store(body.token, body.names))

    @table.post("/command/stored/clear")
    async def clear(body: requests.StoredNames) -> requests.StoredValues:
        """Let the craft forget what it has stored."""
        return requests.StoredValues(parameters=await keeping.clear(body.token, body.names))


def _command(table: Table, station: Station) -> None:
    """What is asked of the craft, whoever commands."""
    commander, operator = station.commander, station.commander.operator

    @table.post("/command/stop", limited=False)
    async def stop() -> requests.Stopped:
        """Stop the motors, whoever commands."""
        ended = station.jobs.end_flying()
        return requests.Stopped(motors=await operator.stop(), ended=ended)

    @table.post("/command/land", limited=False)
    async def land() -> requests.Stopped:
        """Land the craft, whoever commands."""
        landing = asyncio.ensure_future(operator.land())
        await asyncio.sleep(0)  # it is refused at once, or has begun
        ended = [] if landing.done() and landing.exception() else station.jobs.end_flying()
        return requests.Stopped(motors=await landing, ended=ended)

    @table.post("/command/level", limited=False)
    def level(body: requests.Level) -> None:
        """Hold the craft level, or no more."""
        operator.level(body.on)

    @table.post("/command/arm")
    async def arm(body: requests.Armed) -> None:
        """Arm the motors or disarm them, whoever commands."""
        await operator.arm(body.on)

    @table.post("/command/recover")
    async def recover() -> None:
        """Let a crashed craft be ready again."""
        await operator.recover()

    @table.post("/command/connect", Status)
    async def connect(body: requests.CommandUri) -> dict[str, Any]:
        """Command the craft at another address."""
        await station.craft.connect_command(body.uri)
        return status_of(station)

    @table.get("/command/parameters")
    def parameters() -> requests.Values:
        """The craft's parameters."""
        return requests.Values(values=commander.parameters())

    @table.post("/command/restore")
    async def restore() -> requests.Values:
        """Write former parameters back; what was, since the daemon began."""
        return requests.Values(values=await commander.restore())


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
    elif what not in ("", "MODEL"):
        raise BadInputError(f"{name}: a request cannot choose a {what}; start a daemon with --link")
    return name


_FOR_ALL = ("/dev/shm", "/dev/mqueue")


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise BadInputError(f"{path}: leads nowhere") from error


# What the daemon is doing, and what keeps it from doing what it is there for.


def status_of(station: Station) -> dict[str, Any]:
    """The keys of the design's ``status --json``, and more (``requests.Status``)."""
    statistics, receiver = station.statistics, station.receiver
    link = receiver.link
    return {
        "link": {
            "name": link.name,
            "state": receiver.state.value,
            "rate_hz": statistics.rate_hz if statistics else 0.0,
            "lost": statistics.lost if statistics else 0,
            "latency_ms": statistics.latency_ms if statistics else None,
            "doing": link.doing,
            "pauses": link.pauses,
        },
        "vehicle": station.craft.vehicle,
        "recording": station.recordings.status(),
        "viewer": station.viewer.status(),
        "page": station.page.status(),
        "command": _commanded(station),
        "twin": station.twin.status(),
        "stream": {"clients": len(station.stream), "dropped": station.stream.dropped},
        "tasks": station.supervisor.status(),
        "health": station.health.status(problems(station)),
        "faults": station.journal.faults,
        "turned_away": station.turned_away,
        "uptime_s": time.monotonic() - station.started_s,
        "statistics": statistics.as_dict() if statistics else None,
    }


def problems(station: Station) -> list[str]:
    """What keeps the daemon from doing what it is there for, in words."""
    found = []
    state, link = station.receiver.state, station.receiver.link
    if state not in (LinkState.STREAMING, LinkState.ENDED) and not link.pauses:
        found.append(f"link {link.name}: {state.value}")
    recording = station.recordings.status()
    if recording["wanted"] and recording["state"] != "recording":
        found.append(f"recording: {recording['state']}; {recording.get('text', '')}")
    if recording["state"] == "recording" and recording["dropped"]:
        found.append(f"recording: {recording['dropped']} dropped; the disk is too slow")
    viewer = station.viewer.status()["state"]
    if viewer in ("restarting", "failed"):
        found.append(f"viewer: {viewer}")
    if station.page.status()["state"] == "restarting":
        found.append("page: restarting")
    command = station.commander.link
    if command is not None and command.state.value not in ("connected", "connecting"):
        found.append(f"command link {command.uri}: {command.state.value}")
    if reason := station.craft.out_of_reach():
        found.append(reason)
    found += [f"task {name} is dead" for name in station.supervisor.dead()]
    return found


def _commanded(station: Station) -> dict[str, Any] | None:
    """The craft that is commanded, and by whom."""
    commander = station.commander
    link, lease = commander.link, commander.leases.present
    if link is None:
        return None
    announced = None
    if lease is not None and lease.announced is not None:
        text, at_s = lease.announced
        announced = {"text": text, "in_s": round(max(at_s - time.monotonic(), 0.0), 1)}
    return {
        "uri": link.uri,
        "state": link.state.value,
        "firmware": link.firmware,
        "client": commander.client,
        "armed": link.armed,
        "hindrance": link.supervisor.hindrance,
        "crashed": link.supervisor.crashed,
        "held_level": lease is not None and lease.held_level,
        "setpoints": commander.setpoints,
        "superseded": link.superseded,
        "refused": commander.refused,
        "interventions": commander.leases.vanished,
        "out_of_reach": station.craft.out_of_reach(),
        "stops": commander.operator.stops,
        "landing": commander.lands,
        "announced": announced,
        "unproven": {}
        if lease is not None
        else {
            name: {"former": one.former, "now": now, "client": one.client}
            for name, (one, now) in commander.written.left(link).items()
        },
        "stores": link.storage is not None,
        "stored": commander.stored.told(link),
        "craft": identity_of(link),
        "holds_height": link.holds_height,
        "place": place(link),
    }


def place(link: CommandLink | None) -> Place | None:
    """Where the craft is by its own account; None for one that measures no velocity over the
    ground, whose account is worth nothing."""
    said = None if link is None else link.supervisor.place
    if link is None or said is None or not link.holds_place:
        return None
    return Place(
        x_m=said.x_m,
        y_m=said.y_m,
        z_m=said.z_m,
        vx_m_s=said.vx_m_s,
        vy_m_s=said.vy_m_s,
        vz_m_s=said.vz_m_s,
        age_s=round(link.monotonic() - said.heard_s, 4),
        at_s=None if math.isnan(said.at_s) else said.at_s,
    )


# ``/metrics``: what the status says, as Prometheus wants it.


CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
PREFIX = "groundstation_"

_GAUGES = (
    ("link_rate_hz", "Samples a second", "statistics.rate_hz"),
    ("link_packets_hz", "Packets a second, copies included", "statistics.packets_hz"),
    ("link_loss_percent", "Samples missing in the last second", "statistics.loss_pct"),
    ("link_latency_ms", "Median lateness of packets", "statistics.latency_ms"),
    ("link_latency_p99_ms", "99th percentile of lateness", "statistics.latency_p99_ms"),
    ("link_jitter_ms", "Interquartile range of lateness", "statistics.jitter_ms"),
    ("link_clock_ppm", "Device clock against host clock", "statistics.clock_ppm"),
    ("recording_bytes", "Size of the present recording", "recording.bytes"),
    ("recording_samples", "Samples in the present recording", "recording.samples"),
    ("stream_clients", "Programs that read the live stream", "stream.clients"),
    ("uptime_seconds", "Time since the start", "uptime_s"),
    ("healthy", "1 when /health says so", "health.healthy"),
    ("loop_lag_ms", "Worst delay of the event loop in a minute", "health.loop_lag_ms"),
    ("memory_megabytes", "Resident memory", "health.memory_mb"),
    ("descriptors", "Open file descriptors", "health.descriptors"),
    ("threads", "Threads", "health.threads"),
)
_COUNTERS = (
    ("link_packets", "Packets, copies included", "statistics.packets"),
    ("link_samples", "Samples decoded", "statistics.samples"),
    ("link_lost", "Samples lost on the link", "statistics.lost"),
    ("link_duplicates", "Further copies of a sample", "statistics.duplicates"),
    ("link_malformed", "Packets that cannot be any", "statistics.malformed"),
    ("link_restarts", "Restarts of the device", "statistics.restarts"),
    ("recording_dropped", "Items the recorder's queue had no room for", "recording.dropped"),
    ("recording_rotations", "Files ended to begin the next part", "recording.rotations"),
    ("recording_resumed", "Recordings resumed after a fault", "recording.resumed"),
    ("recording_deleted", "Recordings deleted for space", "recording.deleted"),
    ("viewer_dropped", "Items the viewer was too slow for", "viewer.dropped"),
    ("viewer_restarts", "Restarts of the viewer", "viewer.restarts"),
    ("stream_dropped", "Items that stream clients were too slow for", "stream.dropped"),
    ("twin_events", "Disagreements that the twin told", "twin.events"),
    ("twin_dropped", "Samples that the twin was too slow for", "twin.dropped"),
    ("command_setpoints", "Setpoints of clients", "command.setpoints"),
    ("command_refused", "Requests to command that were refused", "command.refused"),
    ("command_interventions", "Times the failsafe stopped the motors", "command.interventions"),
    ("command_superseded", "Setpoints replaced by a newer one", "command.superseded"),
    ("control_turned_away", "Requests beyond the API's limits", "turned_away"),
    ("faults", "Faults of the program, survived", "faults"),
    ("cpu_seconds", "Processor time", "health.cpu_s"),
)


class _Collector:
    def __init__(self, station: Station) -> None:
        self._station = station

    def collect(self) -> Iterator[Any]:
        status = status_of(self._station)
        for table, kind in ((_GAUGES, GaugeMetricFamily), (_COUNTERS, CounterMetricFamily)):
            for name, text, path in table:
                if (value := _at(status, path)) is not None:
                    yield kind(PREFIX + name, text, value=float(value))
        restarts = CounterMetricFamily(
            PREFIX + "task_restarts", "Restarts of a supervised task", labels=["task"]
        )
        for task, count in status["tasks"].items():
            restarts.add_metric([task], float(count["restarts"]))
        yield restarts


def metrics(station: Station) -> bytes:
    """The text of one scrape."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collector(station))
    return generate_latest(registry)


def _at(status: dict[str, Any], path: str) -> Any:
    value: Any = status
    for key in path.split("."):
        if not isinstance(value, dict):
            return None
        value = value.get(key)
    return value


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
            found = operation.work() if operation.body is None else operation.work(body)
            if inspect.isawaitable(found):
                found = await found
            return _Json(requests.Done() if found is None else found)

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
        found = station.health.status(problems(station))
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
            content = msgspec.to_builtins(content, enc_hook=str)
            return json.dumps(content, separators=(",", ":")).encode("ascii")
