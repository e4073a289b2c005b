"""The control API as a table: what can be asked, with which body, and what answers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass
from typing import Any

from groundstation.service import requests
from groundstation.service.station import Station

Work = Callable[[Any], Awaitable[Any]]


@dataclass(frozen=True, slots=True)
class Operation:
    """One thing that can be asked. body: type of the request's JSON, None for no body."""

    method: str
    path: str
    summary: str
    work: Work
    body: type | None = None
    answer: Any = dict[str, Any]


def operations(station: Station) -> list[Operation]:
    """Everything a client can ask of ``station``."""
    commander = station.commander

    async def status(_: None) -> Any:
        return station.status()

    async def events(_: None) -> Any:
        return [asdict(event) for event in station.events]

    async def record_start(_: None) -> Any:
        await station.start_recording()
        return station.sessions.status()

    async def record_stop(_: None) -> Any:
        return await station.stop_recording()

    async def record_mark(body: requests.Mark) -> Any:
        station.mark(body.text, body.details)
        return requests.Done()

    async def acquire(body: requests.Acquire) -> Any:
        return commander.acquire(body.client)

    async def release(body: requests.Holder) -> Any:
        commander.release(body.token)
        return requests.Done()

    async def keep(body: requests.Holder) -> Any:
        commander.keep(body.token)
        return requests.Done()

    async def setpoint(body: requests.Setpoint) -> Any:
        time_ns = commander.setpoint(
            body.token, body.roll_deg, body.pitch_deg, body.yaw_dps, body.thrust
        )
        return requests.Sent(
            time_ns=time_ns,
            telemetry=station.newest(),
            link_state=station.link_state().value,
        )

    async def parameters(_: None) -> Any:
        return requests.Values(values=commander.parameters())

    async def write_parameters(body: requests.Parameters) -> Any:
        return requests.Values(values=await commander.write_parameters(body.token, body.values))

    return [
        Operation("GET", "/status", "What the daemon is doing", status),
        Operation("GET", "/events", "The latest events, oldest first", events,
                  answer=list[dict[str, Any]]),
        Operation("POST", "/record/start", "Begin a new recording", record_start),
        Operation("POST", "/record/stop", "Finish the recording", record_stop),
        Operation("POST", "/record/mark", "Put a note into the recording", record_mark,
                  requests.Mark, requests.Done),
        Operation("POST", "/command/acquire", "Become the one client that commands", acquire,
                  requests.Acquire, requests.Lease),
        Operation("POST", "/command/release", "Stop the motors and give the lease back", release,
                  requests.Holder, requests.Done),
        Operation("POST", "/command/keep", "Keep the lease while nothing is sent", keep,
                  requests.Holder, requests.Done),
        Operation("POST", "/command/setpoint", "Send one setpoint, up to 100 a second", setpoint,
                  requests.Setpoint, requests.Sent),
        Operation("GET", "/command/parameters", "The craft's parameters", parameters,
                  answer=requests.Values),
        Operation("POST", "/command/parameters", "Write parameters and read them back",
                  write_parameters, requests.Parameters, requests.Values),
    ]  # fmt: skip
