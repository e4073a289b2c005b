"""``learn`` of a craft behind a daemon: cflib over UDP to the software craft, telemetry through a
pseudo-terminal."""

import contextlib
import json
import signal

import pytest

from groundstation.cli.learn import DaemonPlace
from groundstation.errors import GroundStationError
from groundstation.recording.formats import open_recording
from groundstation.service.client import Pilot, ask
from support.commands import Beside, connected, software_craft
from support.daemons import Daemon, groundstation, require_failure
from support.findings import begun, planned
from support.programs import LONGEST_S, free_port
from support.waiting import in_real_time, until

DECK = "flow_deck = true"
CRAFT = 'plant = "reduced"\ncraft = "crazyflie21"\nprogram = "wait"\nseed = 3\n'
GAIN, STOCK = "pid_rate.roll_kp", 250.0


def streams(status):
    return status["link"]["rate_hz"] > 400 and connected(status)


@pytest.fixture
def station(tmp_path):
    """station(): a craft that has just been switched on, in a process of its own, and a daemon.
    more: its settings besides."""
    name, port = tmp_path / "craft", free_port()
    flown = ("--serial", f"pty:{name}", "--crtp", f"127.0.0.1:{port}")

    @contextlib.contextmanager
    def begin(more=DECK):
        with software_craft(tmp_path, f"{CRAFT}{more}\n", *flown) as craft:
            until(name.exists, "the pseudo-terminal is there")
            reached = ("--link", f"serial:{name}", "--command", f"udp://127.0.0.1:{port}")
            with Daemon(tmp_path, *reached, "--recordings", "sessions") as daemon:
                daemon.status_when(streams, "the craft is there")
                yield daemon, craft
        name.unlink(missing_ok=True)

    return begin


def journal(folder):
    return json.loads((folder / "learn.json").read_text())


def learn(folder, daemon):
    return Beside(daemon).begun("learn", "--yes", "-o", folder)


@contextlib.contextmanager
def learning(folder, daemon):
    """``learn``, in the midst of its third flight."""
    with learn(folder, daemon) as program:

        def flies():
            assert program.poll() is None, program.communicate()
            return programmes(daemon)

        with in_real_time():
            until(flies, "the third flight")
        yield program


def programmes(daemon):
    """How many have begun."""
    return Beside(daemon).events("mark").count("pid fly programme")


def require_kept(folder, cut):
    """The cut flight is the journal's last and can be read."""
    assert journal(folder)["flights"][-1]["file"] == cut
    assert journal(folder)["flights"][-1]["aborted"]
    recording = open_recording(folder / cut)
    assert recording.samples.duty.any()


def identity(daemon):
    """What the craft says that it is."""
    return ask(daemon.socket, "GET", "/status")["command"]["craft"]


def test_a_lost_link_and_a_killed_daemon_in_the_third_flight_lose_nothing_and_it_goes_on(
    station, tmp_path
):
    folder = tmp_path / "learnt"
    with station() as (daemon, craft):
        begun(folder, "daemon", "plan", identity(daemon))
        planned(folder)
        with learning(folder, daemon) as learns:
            craft.send_signal(signal.SIGSTOP)
            try:
                said, error = learns.communicate(timeout=100)
            finally:
                craft.send_signal(signal.SIGCONT)
        assert learns.returncode == 1
        assert "no telemetry for 1." in error or "no position from the craft for 1 s" in error
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
        assert "Ctrl-C: landing" in error
        assert "landed, motors are off" in error
        require_kept(folder, "flight3.cut3.mcap")
    assert [one["file"] for one in journal(folder)["flights"] if not one["aborted"]] == [
        "flight1.mcap",
        "flight2.mcap",
    ]


def test_a_stop_between_two_flights_ends_it_before_the_next(station, tmp_path):
    folder = tmp_path / "learnt"
    with station() as (daemon, _):
        begun(folder, "daemon", "plan", identity(daemon))
        with learn(folder, daemon) as learns:
            for line in learns.stdout:
                if "planning the next flight" in line:
                    break
            assert ask(daemon.socket, "POST", "/command/stop")["motors"] == "stopped"
            planned(folder)  # it need not compute it
            _, error = learns.communicate(timeout=LONGEST_S)
        assert learns.returncode == 1
        assert "motors were stopped since this program began; begin it again" in error
        assert programmes(daemon) == 0


def test_another_craft_is_neither_flown_nor_written_to(station, tmp_path):
    folder = tmp_path / "learnt"
    with station() as (daemon, _):
        begun(folder, "daemon", "plan", {**identity(daemon), "id": "00" * 12})
        refused = groundstation("learn", "--yes", "-o", folder, socket_path=daemon.socket)
        assert "this is another craft" in require_failure(refused)
        assert programmes(daemon) == 0
        written = {**journal(folder), "gains": "written: better", "former": {GAIN: 180.0}}
        (folder / "learn.json").write_text(json.dumps(written))
        undone = groundstation("learn", "--undo", "-o", folder, socket_path=daemon.socket)
        assert "this is another craft" in require_failure(undone)
        values = ask(daemon.socket, "GET", "/command/parameters")["values"]
        assert values[GAIN] == STOCK


def test_a_folder_that_does_not_say_which_craft_it_was_is_not_flown_on(station, tmp_path):
    folder = tmp_path / "learnt"
    begun(folder, "daemon", "plan")
    refused = groundstation("learn", "--yes", "-o", folder, socket_path=tmp_path / "none.sock")
    assert "did not note which craft it was" in require_failure(refused)


def test_a_craft_that_does_not_know_its_speed_is_not_learnt(station, tmp_path):
    with station("height_deck = true") as (daemon, _):
        refused = groundstation(
            "learn", "--yes", "-o", tmp_path / "learnt", socket_path=daemon.socket
        )
    assert "does not know its velocity over ground" in require_failure(refused)


def test_a_craft_that_is_not_level_is_waited_for_and_told_why_once(station, tmp_path):
    """Its IMU leans: to the program it is one that somebody holds."""
    tilted = "[effects.imu_misalignment]\nroll_deg = 12.0\npitch_deg = 0.0\nyaw_deg = 0.0\n"
    with (
        station(f"{DECK}\n{tilted}") as (daemon, _),
        learn(tmp_path / "learnt", daemon) as learns,
    ):
        for line in learns.stdout:
            if line.startswith("waiting for the craft"):
                break
        assert "it is tilted by 12 deg, 10 is the most" in line
        learns.send_signal(signal.SIGINT)
        said, _ = learns.communicate(timeout=LONGEST_S)
        assert learns.returncode == 130
        assert "waiting for the craft" not in said
        assert programmes(daemon) == 0


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
        assert "the operator has ended it" in ended["text"]
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


def test_gains_that_flew_better_are_written_and_stored(station, monkeypatch):
    with station() as (daemon, _):
        monkeypatch.setenv("GROUNDSTATION_SOCKET", str(daemon.socket))
        place = DaemonPlace(0.5, 1.0, daemon.status()["command"]["stops"], print)
        place.require_storing()
        assert place.store({GAIN: 180.0}) == [GAIN]
        assert daemon.status()["command"]["stored"] == {GAIN: 180.0}
        shown = groundstation("status", socket_path=daemon.socket).stdout
    assert f"stored     {GAIN} 180" in shown


@pytest.mark.parametrize("noted", ["written: better", "being written"])
def test_undo_writes_the_former_gains_to_the_craft_once_and_clears_stored_ones(
    station, tmp_path, noted
):
    folder = tmp_path / "learnt"
    with station() as (daemon, _):
        begun(folder, "daemon", "plan", identity(daemon))
        written = {**journal(folder), "gains": noted, "former": {GAIN: STOCK}}
        (folder / "learn.json").write_text(json.dumps(written))
        with Pilot(daemon.socket, "learn") as pilot:
            pilot.write({GAIN: 180.0})
            pilot.store()
        undo = ("learn", "--undo", "-o", folder)
        done = groundstation(*undo, socket_path=daemon.socket)
        assert done.returncode == 0, done.stderr
        assert GAIN in done.stdout
        assert f"stored gains cleared: {GAIN}" in done.stdout
        assert daemon.status()["command"]["stored"] == {}
        assert ask(daemon.socket, "GET", "/command/parameters")["values"][GAIN] == STOCK
        again = groundstation(*undo, socket_path=daemon.socket)
    assert "nothing to put back" in require_failure(again)
    assert journal(folder)["gains"] == f"put back by --undo; they were {noted}"
