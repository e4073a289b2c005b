"""The daemon's life: how it ends, and that there is one of it."""

import contextlib
import os
import signal
import socket
import stat

import numpy as np
import pytest

from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_scan import recover
from support import RECORDINGS
from support.daemons import Daemon, gaps, in_process, refused_run, require_failure
from support.programs import on_free_ports


def require_complete(path):
    """A finished, sound recording in which nothing is missing; it."""
    assert recover(path).sound
    recording = open_recording(path, raw=True)
    assert gaps(recording) == 0
    assert recording.damage == []
    assert len(recording.samples) > 0
    return recording


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_finishes_the_recording_and_is_no_error(tmp_path, number):
    with Daemon(tmp_path, "--link", "stand-in") as daemon:
        daemon.recording(samples=200)
        assert daemon.stop(number) == 0
        recording = require_complete(daemon.only_file())
        assert f"received {len(recording.samples)} samples, " in daemon.stdout
        assert [event["kind"] for event in recording.events][-1] == "closed"
        assert "Traceback" not in daemon.stderr
        assert not daemon.socket.exists()


def test_it_stops_by_itself_after_the_time_it_was_given(tmp_path):
    with Daemon(tmp_path, "--for", 2.5) as daemon:
        assert daemon.wait() == 0
        recording = require_complete(daemon.only_file())
        assert recording.link == "stand-in"
        assert {"session", "vehicle", "configuration"} <= set(recording.metadata)


def test_impatient_signals_do_not_spoil_the_recording(tmp_path):
    with Daemon(tmp_path) as daemon:
        daemon.recording(samples=200)
        for _ in range(5):
            daemon.process.send_signal(signal.SIGINT)
        assert daemon.wait() == 0
        require_complete(daemon.only_file())


def test_it_stops_while_flying_as_fast_as_possible(tmp_path):
    """A cancelled read must not swallow the wish to stop."""
    with Daemon(tmp_path, "--speed", "max") as daemon:
        daemon.recording()
        assert daemon.stop() == 0
        require_complete(daemon.only_file())


def test_the_end_of_a_replay_is_the_end_of_the_program(tmp_path):
    with Daemon(tmp_path, "--link", f"replay:{RECORDINGS / 'thesis_excerpt.csv'}") as daemon:
        assert daemon.wait() == 0
        recording = require_complete(daemon.only_file())
        assert len(recording.samples) == 25
        assert recording.samples.ticks[0] == 17114118
        assert "ended" in [event["kind"] for event in recording.events]


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_reader_of_its_output_that_goes_away_does_not_cost_the_recording(tmp_path, stream):
    """Ctrl-C in ``groundstation run | tee log`` ends tee first."""
    reading, writing = os.pipe()
    with Daemon(tmp_path, **{stream: writing}) as daemon:
        os.close(writing)
        daemon.recording(samples=200)
        os.close(reading)
        assert daemon.stop() == 0
        assert [event["kind"] for event in require_complete(daemon.only_file()).events][-1] == (
            "closed"
        )
        assert "Traceback" not in daemon.stderr + daemon.stdout
        assert not daemon.socket.exists()


def test_someone_who_stays_connected_does_not_keep_it_from_ending(tmp_path):
    with Daemon(tmp_path) as daemon, contextlib.ExitStack() as stack:
        daemon.recording(samples=200)
        peer, listener, silent = (
            stack.enter_context(socket.socket(socket.AF_UNIX)) for _ in range(3)
        )
        for one in (peer, listener, silent):
            one.connect(str(daemon.socket))
        peer.sendall(b"GET /status HTTP/1.1\r\nHost: x\r\n\r\n")
        assert peer.recv(64).startswith(b"HTTP/1.1 200")
        listener.sendall(b"GET /stream HTTP/1.1\r\nHost: x\r\n\r\n")
        assert b"event-stream" in listener.recv(4096)
        assert daemon.stop() == 0
        assert "Traceback" not in daemon.stderr
        require_complete(daemon.only_file())


def test_without_recording_there_is_no_file(tmp_path):
    with Daemon(tmp_path, "--no-record", "--for", 1.5) as daemon:
        assert daemon.wait() == 0
        assert daemon.files() == []
        assert "recording: none" in daemon.stdout


def test_a_second_daemon_names_the_socket_that_is_taken_and_by_whom(tmp_path):
    with Daemon(tmp_path / "first") as first:
        first.recording()
        with Daemon(tmp_path / "second", socket_path=first.socket) as second:
            assert second.wait() == 1
            assert str(first.socket) in second.last_line
            assert f"process {first.process.pid}" in second.last_line
            assert "Traceback" not in second.stderr
            assert second.files() == []
        assert first.status()["recording"]["state"] == "recording"
        assert first.stop() == 0


@pytest.mark.parametrize("which", ["viewer.port", "viewer.web_port"])
def test_a_second_daemon_names_the_viewer_port_that_is_taken(tmp_path, which):
    ports = on_free_ports("viewer.port", "viewer.web_port")
    (taken,) = (int(word.partition("=")[2]) for word in ports if word.startswith(f"{which}="))
    daemon = Daemon(tmp_path, "--viewer", "serve", *ports)
    with socket.create_server(("127.0.0.1", taken)), daemon:
        assert daemon.wait() == 1
        assert f"port {taken} is taken" in daemon.last_line
        assert daemon.stderr.count("groundstation: ") == 1
        assert daemon.files() == []
        assert not daemon.socket.exists()


def test_only_its_owner_can_reach_the_socket(tmp_path):
    before = os.umask(0)
    try:
        folder = tmp_path / "runtime"
        with Daemon(tmp_path, "--no-record", socket_path=folder / "control.sock") as daemon:
            daemon.status_when(lambda status: True, "an answer")
            assert stat.S_IMODE(daemon.socket.stat().st_mode) == 0o600
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
            assert daemon.stop() == 0
    finally:
        os.umask(before)


@pytest.mark.parametrize(
    ("arguments", "mentions"),
    [
        (("--link", "replay:nowhere.mcap"), "nowhere.mcap"),
        (("--config", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_what_it_cannot_do_is_one_line_and_no_file(tmp_path, arguments, mentions):
    assert mentions in refused_run(tmp_path, *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "mentions"),
    [
        (("--link", "teleport"), ("--link", "stand-in", "replay:FILE")),
        (("--link", "replay:"), ("--link", "replay:FILE")),
        (("--speed", "fast"), ("--speed", "max")),
        (("--speed", "0"), ("--speed", "max")),
        (("--viewer", "hologram"), ("--viewer", "off", "serve", "spawn")),
    ],
)
def test_a_mistyped_option_is_a_usage_error_that_lists_what_is_valid(tmp_path, arguments, mentions):
    refused = in_process("run", *arguments, cwd=tmp_path)
    assert refused.returncode == 2
    assert [word for word in mentions if word not in refused.stderr] == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        ("vehicle = 'banana'\n", "vehicle"),
        ("[recording]\nlow_space_mb = -1\n", "recording.low_space_mb"),
        ("[recording]\nlow_space_mb = nan\n", "recording.low_space_mb"),
        ("[recording]\nfolder = ''\n", "recording.folder"),
        ("[viewer]\nport = 99999\n", "viewer.port"),
        ("[viewer]\nmode = 'serve'\nport = 9090\n", "viewer.web_port"),
        ("[link]\nnmae = 'stand-in'\n", "nmae"),
        ("[link\n", "config.toml"),
        ("[stand_in]\nprogram = 'loop the loop'\n", "loop the loop"),
        ("[stand_in]\nplant = 'perfect'\n", "plant"),
        ("vehicle = 3\n", "vehicle"),
    ],
)
def test_a_wrong_configuration_names_what_is_wrong(tmp_path, text, mentions):
    (tmp_path / "config.toml").write_text(text)
    assert mentions in refused_run(tmp_path, "--config", "config.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["config.toml"]


def test_the_configuration_file_is_followed_and_the_command_line_wins(tmp_path):
    (tmp_path / "config.toml").write_text(
        "[recording]\nfolder = 'elsewhere'\n[stand_in]\nbridge_dedup = true\n"
        "loss = {good_loss = 0.0}\n[stand_in.effects.rotor_drag]\n[link]\nspeed = 'max'\n"
    )
    with Daemon(tmp_path, "--config", "config.toml", "--speed", "2", "--for", "2") as daemon:
        assert daemon.wait() == 0
    (path,) = (tmp_path / "elsewhere").glob("*.mcap")
    recording = require_complete(path)
    assert recording.metadata["configuration"]["speed"] == "2.0"
    np.testing.assert_array_equal(recording.samples.copies, 1)
    told = f"{recording.metadata} {recording.events} {recording.statistics}"
    assert "stand-in" in told
    assert "rotor_drag" not in told, "a recording never says what a stand-in hides"


def test_commands_without_a_daemon_say_how_to_start_one(tmp_path):
    nowhere = tmp_path / "nobody.sock"
    for command in (["status"], ["events"], ["record", "start"], ["record", "stop"]):
        line = require_failure(in_process(*command, socket_path=nowhere))
        assert str(nowhere) in line
        assert "groundstation run" in line
