"""Talking to a running daemon with the other commands."""

import json

import pytest

from groundstation.recording.formats import open_recording
from support.daemons import Daemon, gaps, in_process, require_failure


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    with Daemon(tmp_path_factory.mktemp("daemon"), "--no-record") as running:
        running.status_when(lambda status: status["link"]["rate_hz"] > 400, "telemetry")
        yield running
        assert running.stop() == 0


def tell(daemon, *arguments):
    return in_process(*arguments, socket_path=daemon.socket)


def answer(daemon, *arguments):
    result = tell(daemon, *arguments, "--json")
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_status_has_the_keys_that_programs_read(daemon):
    status = answer(daemon, "status")
    assert {"link", "recording", "viewer", "uptime_s"} <= set(status)
    assert {"name", "state", "rate_hz", "lost", "latency_ms"} <= set(status["link"])
    assert {"file", "bytes", "samples"} <= set(status["recording"])
    assert {"state", "dropped"} <= set(status["viewer"])
    assert status["link"]["name"] == "stand-in"
    assert status["link"]["state"] == "streaming"
    assert status["viewer"] | {"state": "off", "dropped": 0} == status["viewer"]
    assert status["uptime_s"] > 0


def test_status_for_people_says_the_same(daemon):
    shown = tell(daemon, "status")
    assert shown.returncode == 0
    assert "stand-in  streaming" in shown.stdout
    assert "samples/s, 0 lost" in shown.stdout


def test_events_are_told_oldest_first(daemon):
    events = answer(daemon, "events")
    kinds = [event["kind"] for event in events if event["kind"] != "preparing"]  # a slow machine
    assert kinds[:2] == ["opening", "streaming"]
    stamps = [event["time_ns"] for event in events]
    assert stamps == sorted(stamps)
    shown = tell(daemon, "events")
    assert len(shown.stdout.splitlines()) >= len(events)


def test_recordings_start_and_stop_on_demand_and_twice_is_refused(daemon):
    for number in (1, 2):
        started = answer(daemon, "record", "start")
        assert started["state"] == "recording"
        refused = require_failure(tell(daemon, "record", "start"))
        assert f"already recording to {started['file']}" in refused
        daemon.recording(samples=100)
        stopped = answer(daemon, "record", "stop")
        assert stopped["file"] == started["file"]
        assert stopped["state"] == "finished"
        assert stopped["dropped"] == 0
        assert "nothing is being recorded" in require_failure(tell(daemon, "record", "stop"))
        assert len(daemon.files()) == number
        recording = open_recording(daemon.folder / stopped["file"])
        assert len(recording.samples) == stopped["samples"] >= 100
        assert gaps(recording) == 0
