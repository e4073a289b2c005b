"""The daemon on a serial port whose other end comes, dies and comes back."""

import numpy as np
import pytest

from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_scan import recover
from support.commands import software_craft
from support.daemons import Daemon, refused_run
from support.waiting import until


@pytest.fixture
def name(tmp_path):
    return tmp_path / "craft"


def in_state(state):
    return lambda status: status["link"]["state"] == state


def flown_over_a_port(folder):
    """What a daemon recorded, and what it said."""
    folder.mkdir()
    name = folder / "craft"
    with (
        software_craft(folder, "[loss]\ngood_loss = 0.0\n", "--serial", f"pty:{name}"),
        Daemon(folder, "--link", f"serial:{name}") as daemon,
    ):
        daemon.recording(samples=1000)
        assert daemon.stop() == 0
    recording = open_recording(daemon.only_file(), raw=True)
    assert recover(daemon.only_file()).sound
    assert recording.link == f"serial:{name}"
    return recording, daemon.stderr


def test_a_flight_over_a_serial_port_is_recorded_whole(tmp_path):
    """A machine that stands still for longer than a port has room loses rows: it is given three
    chances to keep up, by the times at which packets came."""
    for number in range(3):
        recording, said = flown_over_a_port(tmp_path / str(number))
        if np.diff(recording.raw.host_time_ns).max() < 0.1e9:
            break
    steps = np.diff(recording.samples.ticks)
    assert steps.max() < 1.5 * np.median(steps)
    assert (recording.samples.copies[1:-2] == 4).all()
    assert len(recording.raw) >= 4 * len(recording.samples) - 6
    assert "Traceback" not in said


def test_a_port_that_is_absent_then_there_then_dead_then_back(tmp_path, name):
    with Daemon(tmp_path, "--link", f"serial:{name}") as daemon:
        daemon.status_when(in_state("opening"), "waiting for the port")
        until(lambda: "is not there" in daemon.stderr, "the daemon says so")
        assert daemon.files() == []
        with software_craft(tmp_path, "seed = 1\n", "--serial", f"pty:{name}"):
            daemon.recording(samples=500)
            assert daemon.status()["link"]["state"] == "streaming"
        daemon.status_when(in_state("lost"), "the daemon sees that the port died")
        before = daemon.status()["recording"]["samples"]
        with software_craft(tmp_path, "seed = 2\n", "--serial", f"pty:{name}"):
            # the last of the first bridge may not have been in the file yet
            daemon.recording(samples=before + 600)
        daemon.status_when(in_state("lost"), "lost again")
        kinds = [event["kind"] for event in daemon.ask("GET", "/events")]
        assert 1 <= kinds.count("waiting") <= 3  # at most once for each absence
        assert daemon.stop() == 0
    path = daemon.only_file()
    assert recover(path).sound
    recording = open_recording(path)
    assert set(recording.samples.segment) == {0, 1}
    assert np.count_nonzero(recording.samples.segment == 1) >= 500
    told = [event["kind"] for event in recording.events if event["link"] == f"serial:{name}"]
    assert told.count("streaming") == 2
    assert told.count("lost") == 2
    assert "Traceback" not in daemon.stderr


@pytest.mark.parametrize("port", ["/dev/null", "/", "/dev/ttyS0@0"])
def test_what_can_never_be_a_serial_port_ends_the_daemon_in_one_line(tmp_path, port):
    assert port in refused_run(tmp_path, "--link", f"serial:{port}")
    assert not list(tmp_path.rglob("*.mcap"))
