"""What the daemon is doing, what keeps it from that, and the same as Prometheus wants it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from groundstation.links.base import LinkState
from groundstation.links.command import CommandLink
from groundstation.service.lease import Lease, identity_of
from groundstation.service.requests import Place

if TYPE_CHECKING:
    from groundstation.service.station import Station

# What the daemon is doing, and what keeps it from doing what it is there for.


def status_of(station: Station) -> dict[str, Any]:
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
        for name, text, path in _GAUGES:
            if (value := _at(status, path)) is not None:
                yield GaugeMetricFamily(PREFIX + name, text, value=float(value))
        for name, text, path in _COUNTERS:
            if (value := _at(status, path)) is not None:
                yield CounterMetricFamily(PREFIX + name, text, value=float(value))
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
