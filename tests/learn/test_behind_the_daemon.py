"""``learn`` of a craft behind a daemon: cflib over UDP to the software craft, telemetry through a
pseudo-terminal."""

import contextlib
import json
import os
import signal
import subprocess
import sys

import pytest

from groundstation.errors import GroundStationError
from groundstation.recording.open_recording import open_recording
from groundstation.service.client import Pilot, ask
from support.daemons import COMMAND, Daemon, groundstation, require_failure
from support.learning import begun, planned
from support.programs import Program, free_port
from support.waiting import in_real_time, until

CRAFT = 'plant = "reduced"\ncraft = "crazyflie21"\nprogram = "wait"\nheight_deck = true\nseed = 3\n'
GAIN, STOCK = "pid_rate.roll_kp", 250.0


def connected(status):
    command = status["command"]
    streams = status["link"]["rate_hz"] > 400
    return streams and command is not None and command["state"] == "connected"


@pytest.fixture
def station(tmp_path):
    """station(): a craft that has just been switched on, in a process of its own, and a daemon."""
    name, settings, port = tmp_path / "craft", tmp_path / "craft.toml", free_port()
    settings.write_text(CRAFT)

    @contextlib.contextmanager
    def begin():
        with Program(
            [
                sys.executable, "-m", "firmware_sim", "--settings", settings,
                "--serial", f"pty:{name}", "--crtp", f"127.0.0.1:{port}",
            ],
            stdout=subprocess.PIPE,
            text=True,
        ) as craft:  # fmt: skip
            until(name.exists, "the pseudo-terminal is there")
            reached = ("--link", f"serial:{name}", "--command", f"udp://127.0.0.1:{port}")
            with Daemon(tmp_path, *reached, "--recordings", "sessions") as daemon:
                daemon.status_when(connected, "the craft is there")
                yield daemon, craft
        name.unlink(missing_ok=True)

    return begin


def journal(folder):
    return json.loads((folder / "learn.json").read_text())


@contextlib.contextmanager
def learning(folder, daemon):
    """``learn``, in the midst of its third flight."""
    with Program(
        [COMMAND, "learn", "--yes", "-o", folder],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "NO_COLOR": "1", "GROUNDSTATION_SOCKET": str(daemon.socket)},
    ) as program:

        def flies():
            assert program.poll() is None, program.communicate()
            return programmes(daemon)

        with in_real_time():
            until(flies, "the third flight")
        yield program


def programmes(daemon):
    """How many have begun."""
    events = ask(daemon.socket, "GET", "/events")
    return sum(event["text"] == "pid fly programme" for event in events)


def require_kept(folder, cut):
    """The cut flight is the journal's last and can be read."""
    assert journal(folder)["flights"][-1]["file"] == cut
    assert journal(folder)["flights"][-1]["aborted"]
    recording = open_recording(folder / cut)
    assert recording.samples.duty.any()


def test_a_lost_link_and_a_killed_daemon_in_the_third_flight_lose_nothing_and_it_goes_on(
    station, tmp_path
):
    folder = tmp_path / "learnt"
    begun(folder, "daemon", "crazyflie21", "plan")
    planned(folder)
    with station() as (daemon, craft):
        with learning(folder, daemon) as learns:
            craft.send_signal(signal.SIGSTOP)
            try:
                said, error = learns.communicate(timeout=100)
            finally:
                craft.send_signal(signal.SIGCONT)
        assert learns.returncode == 1
        assert "telemetry lost" in error
        assert "flying flight1" not in said
        require_kept(folder, "flight3.cut1.mcap")
    with station() as (daemon, _):
        with learning(folder, daemon) as learns:
            daemon.process.kill()
            learns.communicate(timeout=100)
        assert learns.returncode == 1
        require_kept(folder, "flight3.cut2.mcap")
    with station() as (daemon, _):
        with learning(folder, daemon) as learns:
            learns.send_signal(signal.SIGINT)
            _, error = learns.communicate(timeout=100)
        assert learns.returncode == 130
        assert "motors are off" in error
        require_kept(folder, "flight3.cut3.mcap")
    assert [one["file"] for one in journal(folder)["flights"] if not one["aborted"]] == [
        "flight1.mcap",
        "flight2.mcap",
    ]


def test_the_page_s_job_flies_tells_what_it_does_is_stopped_by_stop_and_goes_on(station):
    with station() as (daemon, _):

        def start(flown, **more):
            job = ask(daemon.socket, "POST", "/jobs/start", {"kind": "learn", **more})
            with in_real_time():
                until(lambda: programmes(daemon) == flown, "it flies")
            assert "flying flight1" in now(job["id"])["stage"]
            return job["id"]

        def now(name):
            (job,) = [one for one in ask(daemon.socket, "GET", "/jobs") if one["id"] == name]
            return job

        first = start(1)
        until(lambda: stopped(daemon), "Stop is obeyed")
        ended = until(
            lambda: now(first)["state"] in ("failed", "cancelled") and now(first), "it has ended"
        )
        assert "flight cut short" in ended["text"]
        second = start(2, model=first)
        assert now(second)["command"].endswith(f"jobs/{first}/learnt")
        ask(daemon.socket, "POST", "/jobs/cancel", {"id": second})
        until(lambda: now(second)["state"] == "cancelled", "it is cancelled")
        folder = daemon.sessions / "jobs" / first / "learnt"
        until(lambda: len(journal(folder)["flights"]) == 2, "what was flown is kept")
        for one in journal(folder)["flights"]:
            assert open_recording(folder / one["file"]).samples.duty.any()
        with pytest.raises(GroundStationError, match="no such job"):
            start(3, model="2026-01-01T00-00-00-000Z_fit")


def stopped(daemon):
    return ask(daemon.socket, "POST", "/command/stop")["motors"] == "stopped"


def test_undo_writes_the_former_gains_to_the_craft_once(station, tmp_path):
    folder = tmp_path / "learnt"
    begun(folder, "daemon", "crazyflie21", "plan")
    written = {**journal(folder), "gains": "written: better", "former": {GAIN: STOCK}}
    (folder / "learn.json").write_text(json.dumps(written))
    with station() as (daemon, _):
        with Pilot(daemon.socket, "learn") as pilot:
            pilot.write({GAIN: 180.0})
        undo = ("learn", "--undo", "-o", folder)
        done = groundstation(*undo, socket_path=daemon.socket)
        assert done.returncode == 0, done.stderr
        assert GAIN in done.stdout
        assert ask(daemon.socket, "GET", "/command/parameters")["values"][GAIN] == STOCK
        again = groundstation(*undo, socket_path=daemon.socket)
    assert "nothing to put back" in require_failure(again)
    assert journal(folder)["gains"] == "put back by --undo; they were written: better"
