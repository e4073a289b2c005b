"""``/metrics``: what the status says, as Prometheus wants it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from groundstation.service import overview

if TYPE_CHECKING:
    from groundstation.service.station import Station

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
        status = overview.status(self._station)
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
