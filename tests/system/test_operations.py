"""What an operator does with a running daemon, and what a service manager does."""

import contextlib
import json
import os
import pty
import re
import shutil
import signal
import socket
import subprocess
import time

import pytest

from groundstation.recording.formats import open_recording
from groundstation.service.config import Config, load_config, settings
from support import RECORDINGS
from support.daemons import COMMAND, Daemon, in_process, require_failure
from support.programs import Program, on_free_ports, run_program
from support.waiting import until

FLIGHT = "stand_in_flight.mcap"


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    folder = tmp_path_factory.mktemp("daemon")
    (folder / "sessions").mkdir()
    shutil.copy(RECORDINGS / FLIGHT, folder / "sessions")
    (folder / "station.toml").write_text("[recording]\nrotate_mb = 500\n")
    with Daemon(folder, "--config", "station.toml") as running:
        running.recording(samples=200)
        yield running
        assert running.stop() == 0


def tell(daemon, *arguments):
    result = in_process(*arguments, socket_path=daemon.socket, cwd=daemon.folder)
    assert result.returncode == 0, result.stderr
    return result.stdout


def refused(daemon, *arguments):
    return require_failure(in_process(*arguments, socket_path=daemon.socket, cwd=daemon.folder))


def test_the_link_is_switched_and_back_within_one_recording(daemon):
    before = daemon.status()["recording"]["file"]
    assert tell(daemon, "link", f"replay:sessions/{FLIGHT}").startswith("replay:")  # as typed here
    assert tell(daemon, "link", f"replay:{FLIGHT}").startswith("replay:")  # in the daemon's folder
    daemon.status_when(lambda s: s["link"]["rate_hz"] > 400, "the replay")
    assert "is not in the recordings folder" in refused(daemon, "link", "replay:/etc/passwd")
    assert "no such file" in refused(daemon, "link", "replay:nothing.mcap")
    assert json.loads(tell(daemon, "link", "stand-in", "--json"))["link"]["name"] == "stand-in"
    after = daemon.recording(samples=100)["recording"]
    assert (after["file"], after["dropped"]) == (before, 0)
    told = tell(daemon, "events")
    assert re.search(r"link +switched from stand-in to replay:", told)
    assert re.search(r"link +switched from replay:.* to stand-in", told)


def test_a_mark_and_the_index_of_recordings(daemon):
    assert tell(daemon, "record", "mark", "new propellers") == "marked\n"
    shown = tell(daemon, "inspect", daemon.sessions)
    assert f"{FLIGHT} " in shown
    assert " recording\n" in shown
    tell(daemon, "record", "stop")
    assert "nothing is being recorded" in refused(daemon, "record", "mark", "too late")
    entries = json.loads(tell(daemon, "inspect", daemon.sessions, "--json"))
    names = [entry["file"] for entry in entries]
    assert names == sorted(names)
    (ours,) = [entry for entry in entries if entry["file"] != FLIGHT]
    assert (ours["state"], ours["marks"], ours["link"]) == ("finished", 1, "stand-in")
    recording = open_recording(daemon.sessions / ours["file"])
    assert ours["samples"] == len(recording.samples)
    assert "new propellers" in [event["text"] for event in recording.events]
    tell(daemon, "record", "start")


def test_the_status_screen_keeps_showing_and_ends_with_ctrl_c(daemon):
    main, screen = pty.openpty()
    os.set_blocking(main, False)
    shown = b""

    def look():
        nonlocal shown
        with contextlib.suppress(BlockingIOError):
            shown += os.read(main, 65536)
        return shown.count(b"samples/s") >= 2 and b"health" in shown

    with Program(
        [COMMAND, "status", "--watch"], stdin=screen, stdout=screen, stderr=subprocess.PIPE,
        env={**os.environ, "GROUNDSTATION_SOCKET": str(daemon.socket), "COLUMNS": "140",
             "TERM": "xterm"},
    ) as process:  # fmt: skip
        os.close(screen)
        until(look, "two pictures of the status")
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
    os.close(main)
    for what in (b"link", b"recording", b"disk", b"viewer", b"stream", b"MB", b"good"):
        assert what in shown


def test_what_config_shows_is_a_configuration(tmp_path):
    path = tmp_path / "shown.toml"
    given = ("--set", "viewer.port=1111", "--set", "link.speed=max", "--set", "vehicle=crazyflie21")
    path.write_text(in_process("config", *given).stdout)
    config = load_config(path)
    assert (config.viewer.port, config.link.speed, config.vehicle) == (1111, "max", "crazyflie21")
    plain = tmp_path / "plain.toml"
    plain.write_text(in_process("config").stdout)
    assert load_config(plain) == Config()
    as_json = json.loads(in_process("config", "--json").stdout)
    assert set(as_json) == {setting.name for setting in settings(Config())}
    assert "usage" in in_process("config", "--set", "viewer.prt=1").stderr.lower()
    assert "viewer.port" in require_failure(in_process("config", "--set", "viewer.port=web"))


def test_the_service_manager_is_told_ready_alive_and_stopping(tmp_path):
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(path))
        manager.settimeout(60)
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "400000"}
        with Daemon(tmp_path, environment=environment) as daemon:
            said = []
            while said.count("READY=1") < 1 or said.count("WATCHDOG=1") < 3:
                said.append(manager.recv(100).decode())
            daemon.process.send_signal(signal.SIGSTOP)
            manager.settimeout(1.0)
            with pytest.raises(TimeoutError):  # a daemon that stands still says nothing
                said += [manager.recv(100).decode() for _ in range(50)]
            manager.settimeout(60)
            daemon.process.send_signal(signal.SIGCONT)
            daemon.recording(samples=10)
            daemon.process.send_signal(signal.SIGINT)
            while said[-1] != "STOPPING=1":  # at once: the daemon does not wait for a full queue
                said.append(manager.recv(100).decode())
            assert daemon.wait() == 0


def test_the_log_can_be_json_one_object_a_line(tmp_path):
    with Daemon(tmp_path, "--set", "log.format=json") as daemon:
        daemon.recording(samples=10)
        assert daemon.stop() == 0
        lines = [json.loads(line) for line in daemon.stderr.splitlines()]
    assert {"event", "kind", "source", "level", "timestamp"} <= set(lines[0])
    assert "streaming" in [line["kind"] for line in lines]


def test_the_systemd_unit_is_sound_and_shuts_the_daemon_in(tmp_path):
    printed = in_process("install", "service", "--print")
    assert printed.returncode == 0
    assert f"ExecStart={COMMAND} run" in printed.stdout
    assert "User=groundstation" in printed.stdout
    assert "Type=notify" in printed.stdout
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("[viewer]\nport = 'web'\n")
    assert "viewer.port" in require_failure(
        in_process("install", "service", "--print", "--config", wrong)
    )
    if shutil.which("systemd-analyze") is None:
        pytest.skip("checking a unit needs systemd-analyze")
    unit = tmp_path / "groundstation.service"
    unit.write_text(printed.stdout)
    checked = run_program(["systemd-analyze", "verify", unit])
    assert "groundstation.service" not in checked.stderr, checked.stderr
    rated = run_program(["systemd-analyze", "security", "--offline=yes", unit])
    level = re.search(r"exposure level.*: ([\d.]+)", rated.stdout)
    assert level is None or float(level[1]) < 3.0, rated.stdout


def test_nothing_listens_beyond_loopback(tmp_path):
    import psutil

    ports = on_free_ports("viewer.port", "viewer.web_port")
    with Daemon(tmp_path, "--viewer", "serve", *ports) as daemon:
        daemon.status_when(lambda s: s["viewer"]["state"] == "serving", "the view")
        time.sleep(0.2)
        processes = [psutil.Process(daemon.process.pid), *daemon.children()]
        listening = [
            connection.laddr.ip
            for process in processes
            for connection in process.net_connections("inet")
            if connection.status == psutil.CONN_LISTEN
        ]
        assert len(listening) >= 2
        assert all(address.startswith("127.") for address in listening)
        assert daemon.stop() == 0


def test_no_privilege_is_needed(tmp_path):
    if shutil.which("setpriv") is None:
        pytest.skip("dropping privileges needs setpriv (util-linux)")
    drop = ["setpriv", "--bounding-set", "-all", "--inh-caps", "-all", "--no-new-privs"]
    result = run_program(
        [*drop, COMMAND, "run", "--for", "1.5"], cwd=tmp_path,
        env={**os.environ, "GROUNDSTATION_SOCKET": str(tmp_path / "control.sock")}, timeout=60,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert " 0 lost, " in result.stdout
