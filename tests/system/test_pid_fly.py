"""``pid fly`` against a real daemon: cflib over UDP to the stand-in, real packets back."""

import contextlib
import json
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from groundstation.cli.flying import kept
from groundstation.recording.formats import open_recording
from groundstation.service.client import Pilot, ask
from support import RECORDINGS
from support.commands import Beside, connected
from support.daemons import Daemon, groundstation, in_process, require_failure
from support.programs import free_port
from support.waiting import until

DATA = Path(__file__).parents[1] / "control" / "data"
BODY, GAINS = DATA / "body.json", DATA / "gains.toml"
SHORT = ("--axis", "roll", "--repeat", "2", "--hold", "0.6", "--rest", "0.4")
ONCE = ("--axis", "roll", "--repeat", "1", "--hold", "0.5", "--rest", "0.2")
GAIN = "pid_rate.roll_kp"
STOCK, DESIGNED = 70.0, 2.847


@pytest.fixture
def port():
    return free_port()


class Station(Beside):
    def gain(self):
        return self.gains()[GAIN]


@pytest.fixture
def craft():
    return "crazyflie1"


@pytest.fixture
def deck():
    """What the craft measures height and speed with, as its setting says."""
    return ""


@pytest.fixture
def station(tmp_path, craft, deck):
    with station_in(tmp_path, craft, deck) as found:
        yield found


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    """One for all that refuse to fly."""
    with station_in(tmp_path_factory.mktemp("resting"), "crazyflie1", deck="") as found:
        yield found


@contextlib.contextmanager
def station_in(folder, craft, deck):
    settings = folder / "groundstation.toml"
    settings.write_text(
        f'command = "udp://127.0.0.1:{free_port()}"\n'
        '[link]\nname = "stand-in"\n'
        "[stand_in]\n"
        f'craft = "{craft}"\nprogram = "wait"\nseed = 3\n{deck}\n'
        f'[recording]\nfolder = "{folder / "sessions"}"\nlow_space_mb = 0\n'
    )
    with Daemon(folder, "--config", settings) as daemon:
        daemon.status_when(connected, "the command link is connected")
        yield Station(daemon)


def test_gains_are_flown_measured_beside_the_prediction_and_put_back(station, tmp_path):
    page = tmp_path / "flight.html"
    flight = station.flown(
        "--gains", GAINS, "--model", BODY, *SHORT, "--restore", "--html", page, "--json"
    )
    report = json.loads(flight.stdout)
    roll = report["axes"]["roll"]
    assert roll["edges"] == 6
    assert roll["measured"]["rms"] == pytest.approx(roll["predicted"]["rms"], rel=0.15)
    assert report["delay_s"] < 0.05
    assert "<svg" in page.read_text()
    assert station.gain() == STOCK
    recording = open_recording(Path(report["recording"]))
    writes = [e for e in recording.commands if e["kind"] == "parameter" and e["name"] == GAIN]
    assert [(e["direction"], pytest.approx(e["value"], rel=1e-6)) for e in writes] == [
        ("out", DESIGNED),
        ("in", DESIGNED),
        ("out", STOCK),
        ("in", STOCK),
    ]
    sent = [e for e in recording.commands if e["kind"] == "setpoint"]
    assert {e["client"] for e in sent} - {"dead man"} == {"pid fly"}
    assert sent[-1]["thrust"] == 0
    assert max(abs(e["roll_deg"]) for e in sent) == 10.0
    samples = recording.samples
    assert np.degrees(np.abs(samples.attitude[:, 0])).max() > 7
    assert not samples.duty[-20:].any()
    again = station.fly("--undo")
    assert "nothing was left changed" in again.stdout


def test_a_killed_flight_ends_with_motors_off_and_the_daemon_puts_the_gains_back(station):
    with station.flying("--gains", GAINS, *SHORT):
        pass
    until(
        lambda: any("motors stopped, " in text for text in station.events("command")),
        "the failsafe has stopped the motors",
    )
    time.sleep(1.0)
    recorded = Path(ask(station.daemon.socket, "POST", "/record/stop")["file"])
    recording = open_recording(recorded)
    sent = [entry for entry in recording.commands if entry["kind"] == "setpoint"]
    last = max(place for place, entry in enumerate(sent) if entry["client"] == "pid fly")
    after = [entry["thrust"] for entry in sent[last + 1 :]]
    assert after[0] == sent[last]["thrust"] > 0
    assert after == sorted(after, reverse=True)
    assert after[-1] == 0
    turning = recording.samples.duty.any(axis=1)
    last_ns = int(recording.samples.host_time_ns[np.flatnonzero(turning)[-1]])
    assert last_ns > sent[last]["time_ns"]
    assert not turning[-1]
    until(lambda: station.gain() == STOCK, "the daemon has put the former gain back")
    assert station.fly("--undo").stdout.startswith(f"the former values are back: {GAIN}")


def test_sigterm_stops_the_motors_and_puts_the_gains_back(station):
    with station.flying("--gains", GAINS, *SHORT) as flight:
        flight.send_signal(signal.SIGTERM)
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "flight aborted: SIGTERM; motors are off" in stderr
    assert station.gain() == STOCK


def test_a_flight_that_the_operator_stops_says_so_and_puts_the_gains_back(station):
    with station.flying("--gains", GAINS, *SHORT) as flight:
        station.daemon.ask("POST", "/command/stop")
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "Stopped by the operator, motors off" in stderr
    assert "the daemon puts the former parameters back" in stderr
    until(lambda: station.gain() == STOCK, "the former gain is back")


def test_an_impatient_ctrl_c_does_not_keep_the_motors_from_being_stopped(station):
    with station.flying("--gains", GAINS, *SHORT) as flight:
        flight.send_signal(signal.SIGINT)
        assert any(line == "stopping the motors\n" for line in flight.stderr)
        flight.send_signal(signal.SIGINT)
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1, stderr
    assert "flight aborted: Ctrl-C; motors are off" in stderr
    assert station.gain() == STOCK


def test_gains_that_cannot_fly_abort_and_are_put_back(station, tmp_path):
    gains = tmp_path / "wild.toml"
    gains.write_text('"pid_attitude.roll_kp" = 30.0\n"pid_attitude.pitch_kp" = 30.0\n')
    flight = station.fly("--gains", gains, *ONCE, "--restore")
    assert "flight aborted: " in flight.stderr
    assert "tilt of" in flight.stderr or "rate of" in flight.stderr
    assert station.gains()["pid_attitude.roll_kp"] == 3.5


def test_a_flight_that_is_no_more_recorded_lands_and_puts_the_gains_back(station):
    long = ("--axis", "roll", "--repeat", "20")  # a busy machine may begin to ask late
    with station.flying("--gains", GAINS, *long, mark="pid fly begins") as flight:
        ask(station.daemon.socket, "POST", "/record/stop")  # nowhere to put the next mark
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "flight aborted: recording: nothing is being recorded" in stderr
    assert "motors are off" in stderr
    assert station.gain() == STOCK
    assert "nothing was left changed" in station.fly("--undo").stdout


def test_the_lease_lasts_while_a_human_thinks(tmp_path, port):
    settings = tmp_path / "short.toml"
    settings.write_text(
        f'command = "udp://127.0.0.1:{port}"\n'
        '[link]\nname = "stand-in"\n[stand_in]\nprogram = "wait"\n'
        "[recording]\nenabled = false\n[failsafe]\nlease_s = 1.0\n"
    )
    with Daemon(tmp_path, "--config", settings) as daemon:
        daemon.status_when(connected, "the command link is connected")
        with Pilot(daemon.socket, "a human") as pilot:
            with kept(pilot):
                time.sleep(2.0)
            assert ask(daemon.socket, "GET", "/status")["command"]["client"] == "a human"
            pilot.keep()


def test_a_replay_cannot_be_commanded(tmp_path, port):
    replayed = RECORDINGS / sorted(p.name for p in RECORDINGS.glob("*.mcap"))[0]
    with Daemon(
        tmp_path, "--link", f"replay:{replayed}", "--command", f"udp://127.0.0.1:{port}"
    ) as daemon:
        daemon.status_when(lambda status: True, "an answer")
        refused = Station(daemon).fly(*SHORT)
    assert "replay" in require_failure(refused)


@pytest.mark.parametrize("craft", ["crazyflie21"])
def test_todays_craft_flies_its_own_gains_and_is_never_given_those_of_2014(station, tmp_path):
    before = station.gain()
    assert before == 250.0
    said = require_failure(station.fly("--gains", GAINS, *ONCE))
    assert "taken for firmware 2014" in said
    assert "flies 2.x" in said
    assert "a crazyflie1 flies 2014" in require_failure(station.fly("--model", BODY, *ONCE))
    assert station.gain() == before
    gains = tmp_path / "today.toml"
    gains.write_text('firmware = "2.x"\n"pid_rate.roll_kp" = 200.0\n')
    flight = station.flown("--gains", gains, "--restore", "--json", *SHORT)
    report = json.loads(flight.stdout)
    assert report["firmware"] == "2.x"
    assert report["gains"]["pid_rate.roll_kp"] == 200.0
    roll = report["axes"]["roll"]["measured"]
    assert roll["overshoot_pct"] < 20.0
    assert station.gain() == before


@pytest.mark.parametrize("craft", ["brushless"])
def test_a_craft_that_is_not_armed_is_told_and_not_measured_on_the_ground(station):
    def disarmed():
        ask(station.daemon.socket, "POST", "/command/arm", {"on": False})
        return flight.poll() is not None

    refused = require_failure(station.fly(*ONCE))
    assert "groundstation motors arm" in refused
    assert refused.endswith("nothing was flown")
    ask(station.daemon.socket, "POST", "/command/arm", {"on": True})
    with station.flying(*ONCE, mark="pid fly begins") as flight:
        until(disarmed, "the flight has ended")
        said = flight.stderr.read()
    assert flight.returncode
    assert "the craft is not armed" in said
    assert "groundstation motors arm" in said
    assert "pid fly programme" not in station.events("mark")


@pytest.mark.parametrize("craft", ["brushless"])
def test_the_motors_are_armed_disarmed_and_stopped_from_the_command_line(station):
    def told(*arguments):
        done = groundstation("motors", *arguments, socket_path=station.daemon.socket)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    assert told("disarm") == "disarmed"
    assert json.loads(told("disarm", "--json")) == {"motors": "disarmed"}
    assert told("arm") == "armed"
    assert told("stop").startswith("stopped")
    events = ask(station.daemon.socket, "GET", "/events")
    kinds = [event["kind"] for event in events]
    assert kinds.index("disarmed") < kinds.index("armed") < kinds.index("stop")


def test_a_craft_that_stores_nothing_says_so_before_it_flies(resting):
    line = require_failure(resting.fly("--store", *SHORT))
    assert "this craft's firmware stores no parameters" in line
    assert "nothing was flown" in line
    assert "nothing was left changed" in resting.fly("--undo").stdout


def test_only_one_may_command(resting):
    with Pilot(resting.daemon.socket, "somebody else"):
        refused = resting.fly(*SHORT)
    assert "somebody else is commanding" in require_failure(refused)


def test_firmware_without_arming_and_a_daemon_without_a_craft_say_so(resting, tmp_path):
    said = require_failure(in_process("motors", "arm", socket_path=resting.daemon.socket))
    assert "knows no arming" in said
    for word in ("arm", "disarm", "stop"):
        nobody = in_process("motors", word, socket_path=tmp_path / "none.sock")
        assert "groundstation run" in require_failure(nobody)


def test_a_craft_without_a_deck_is_not_flown_by_height(resting):
    said = require_failure(resting.fly("--thrust", "height", *ONCE))
    assert "holds no height by itself" in said
