"""The control API as a table: what can be asked, with which body, and what answers."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from groundstation.dynamics.registry import EFFECTS
from groundstation.errors import BadInputError
from groundstation.links.command import LinkEvent
from groundstation.links.factory import STAND_IN, argument_of, is_stand_in, split_name
from groundstation.recording.mcap_scan import CatalogueEntry
from groundstation.service import overview, requests
from groundstation.service.answers import Status
from groundstation.service.config import settings
from groundstation.service.devices import Devices
from groundstation.service.jobs import Job
from groundstation.service.models import ModelEntry
from groundstation.service.station import Station
from groundstation.telemetry.packet import port_and_baud

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
        return overview.status(station)

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
        return overview.status(station)

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
        return overview.status(station)

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
        return overview.status(station)

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
