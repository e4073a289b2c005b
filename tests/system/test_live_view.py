"""The live view may die, stall or be killed: the recording does not notice."""

import signal

import psutil
import pytest

from groundstation.recording.formats import open_recording
from groundstation.recording.quality import inspect_recording
from support import RECORDINGS
from support.daemons import Daemon, gaps
from support.programs import on_free_ports
from support.waiting import PATIENCE_S

FEEDER, SERVER = "groundstation.viewer.feeder", "--serve-web"
MEMORY_MOST = 30e6
"""How much the daemon may grow while a viewer is stuck, bytes: its queue is bounded."""


def serving_daemon(folder, *arguments):
    ports = on_free_ports("viewer.port", "viewer.web_port")
    return Daemon(folder, "--viewer", "serve", *ports, *arguments)


def is_serving(status):
    return status["viewer"]["state"] == "serving" and status["viewer"]["sent"] > 0


@pytest.mark.parametrize("victim", [FEEDER, SERVER])
def test_a_view_that_dies_or_stalls_costs_the_recording_nothing(tmp_path, victim):
    with serving_daemon(tmp_path) as daemon:
        daemon.recording()
        daemon.status_when(is_serving, "serving")
        process = psutil.Process(daemon.process.pid)
        memory = process.memory_info().rss
        for number in (signal.SIGKILL, signal.SIGSTOP):
            before = daemon.status()["viewer"]
            daemon.child(victim).send_signal(number)
            daemon.status_when(
                lambda status, restarts=before["restarts"]: (
                    status["viewer"]["restarts"] > restarts and is_serving(status)
                ),
                "serving again",
            )
        assert process.memory_info().rss - memory < MEMORY_MOST
        status = daemon.status()
        assert status["viewer"]["dropped"] > 0
        assert status["recording"]["dropped"] == 0
        assert daemon.stop() == 0
        path = daemon.only_file()
    recording = open_recording(path, raw=True)
    report = inspect_recording(recording)
    assert (report["lost_samples"], report["gap_count"], report["damage"]) == (0, 0, [])
    faults = [event for event in recording.events if event["kind"] == "fault"]
    assert {event["link"] for event in faults} == {"viewer"}
    assert len(faults) >= 2


def test_nothing_outlives_a_daemon_that_is_killed(tmp_path):
    with serving_daemon(tmp_path) as daemon:
        daemon.recording()
        daemon.status_when(is_serving, "serving")
        children = daemon.children()
        assert len(children) >= 2
        daemon.child(FEEDER).send_signal(signal.SIGSTOP)
        daemon.stop(signal.SIGKILL)
        _, alive = psutil.wait_procs(children, timeout=PATIENCE_S)
        assert not alive
        assert gaps(open_recording(daemon.only_file())) == 0


def test_the_addresses_to_open_are_printed_and_in_the_status(tmp_path):
    with serving_daemon(tmp_path) as daemon:
        status = daemon.status_when(is_serving, "serving")
        for url in status["viewer"]["urls"]:
            assert url in daemon.stdout
        children = daemon.children()
        assert daemon.stop() == 0
        assert not [process for process in children if process.is_running()]


def test_a_short_replay_stays_on_view_until_it_is_stopped(tmp_path):
    """The real excerpt lasts 50 ms, the viewer takes seconds to start."""
    excerpt = RECORDINGS / "thesis_excerpt.csv"
    with serving_daemon(tmp_path, "--link", f"replay:{excerpt}") as daemon:
        status = daemon.status_when(
            lambda status: is_serving(status) and status["viewer"]["sent"] >= 25, "all is shown"
        )
        assert status["link"]["state"] == "ended"
        assert status["viewer"]["dropped"] == 0
        assert status["recording"]["state"] == "finished"
        assert status["recording"]["samples"] == 25
        assert daemon.stop() == 0
        assert "received 25 samples, 0 lost" in daemon.stdout
        assert len(open_recording(daemon.only_file()).samples) == 25
