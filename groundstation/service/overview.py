"""What the daemon is doing, and what keeps it from doing what it is there for."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from groundstation.links.base import LinkState

if TYPE_CHECKING:
    from groundstation.service.station import Station


def status(station: Station) -> dict[str, Any]:
    """The keys of the design's ``status --json``, and more (``answers.Status``)."""
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
        "command": _command(station),
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


def _command(station: Station) -> dict[str, Any] | None:
    """The craft that is commanded, and by whom."""
    commander = station.commander
    link, lease = commander.link, commander.leases.present
    if link is None:
        return None
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
    }
