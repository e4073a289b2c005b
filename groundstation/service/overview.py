"""What the daemon is doing, and what keeps it from doing what it is there for."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from groundstation.links.base import LinkState
from groundstation.links.command import CommandLink
from groundstation.service.lease import Lease, identity_of
from groundstation.service.requests import Place

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
        "stops": commander.operator.stops,
        "landing": commander.lands,
        "announced": _announced(lease),
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
    )


def _announced(lease: Lease | None) -> dict[str, Any] | None:
    if lease is None or lease.announced is None:
        return None
    text, at_s = lease.announced
    return {"text": text, "in_s": round(max(at_s - time.monotonic(), 0.0), 1)}
