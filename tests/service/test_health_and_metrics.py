"""/health says whether the daemon does its work, /metrics how much of it."""

import asyncio
import http.client
import json
import socket

from prometheus_client.parser import text_string_to_metric_families

from groundstation.links.base import Link, LinkState
from groundstation.service.client import ask
from groundstation.service.config import Config, ControlSocket, RecordingConfig
from groundstation.service.control import ControlServer
from groundstation.service.station import Station
from support.waiting import until
from support.worlds import serve


def get(path, route):
    """Status and body."""
    connection = http.client.HTTPConnection("localhost")
    connection.sock = socket.socket(socket.AF_UNIX)
    connection.sock.connect(str(path))
    try:
        connection.request("GET", route)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


def config(tmp_path, **recording):
    return Config(
        recording=RecordingConfig(folder=str(tmp_path / "sessions"), low_space_mb=0, **recording)
    )


class SilentLink(Link):
    """Open, and nothing comes."""

    silence_s = 0.05

    def __init__(self):
        super().__init__("silent")

    async def _open(self):
        pass

    async def _read(self):
        await asyncio.sleep(3600)

    async def _close(self):
        pass


def test_every_figure_is_a_metric_of_the_right_kind(tmp_path):
    path = tmp_path / "control.sock"

    def conversation(station):
        until(
            lambda: (ask(path, "GET", "/status")["statistics"] or {}).get("packets"), "statistics"
        )
        status, text = get(path, "/metrics")
        assert status == 200
        families = {family.name: family for family in text_string_to_metric_families(text)}
        assert families["groundstation_link_rate_hz"].type == "gauge"
        assert families["groundstation_link_packets"].type == "counter"
        (packets,) = families["groundstation_link_packets"].samples
        assert packets.value > 0
        assert families["groundstation_healthy"].samples[0].value == 1
        tasks = {s.labels["task"] for s in families["groundstation_task_restarts"].samples}
        assert {"failsafe", "recordings", "statistics", "health"} <= tasks
        assert all(family.documentation for family in families.values())

    serve(config(tmp_path), path, conversation)


def test_a_daemon_that_records_what_streams_is_healthy(tmp_path):
    path = tmp_path / "control.sock"

    def conversation(station):
        until(lambda: station.receiver.state is LinkState.STREAMING, "telemetry")
        status, text = get(path, "/health")
        assert (status, json.loads(text)["problems"]) == (200, [])

    serve(config(tmp_path), path, conversation)


async def test_a_silent_link_a_dead_task_and_a_blocked_loop_are_not_healthy(tmp_path):
    path = tmp_path / "control.sock"

    station = Station(config(tmp_path, enabled=False))
    link = SilentLink()
    link.on_event, station.receiver.link = station.journal.take, link
    control = ControlSocket(path)
    server = ControlServer(station, control)
    await server.start()
    running = asyncio.create_task(station.run())
    async with asyncio.timeout(20):
        while station.receiver.state is not LinkState.SILENT:
            await asyncio.sleep(0.01)
    station.supervisor._tasks["statistics"].cancel()
    station.health._lags.append((2.5, "it waited in fsync"))
    await asyncio.sleep(0.05)
    answer = await asyncio.to_thread(get, path, "/health")
    station.stop()
    await running
    await server.stop()
    control.close()
    status, text = answer
    assert status == 503
    assert json.loads(text)["problems"] == [
        "link silent: silent",
        "task statistics is dead",
        "the event loop was held up for 2.5 s: it waited in fsync",
    ]
