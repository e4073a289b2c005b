"""``pid fly`` of a craft with a Flow deck: back after each manoeuvre, landed whatever ends it."""

import contextlib
import json
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from groundstation.recording.formats import open_recording
from groundstation.service.client import ask
from support.commands import Beside, connected, software_craft
from support.daemons import Daemon, require_failure
from support.programs import free_port
from support.waiting import until

SHORT = ("--axis", "roll", "--repeat", "2", "--hold", "0.5")
LONG = ("--repeat", "20")
GAIN, STOCK = "pid_rate.roll_kp", 250.0
DECK = "flow_deck = true"
SETTINGS = 'plant = "reduced"\ncraft = "crazyflie21"\nprogram = "wait"\nseed = 3\n'


class Field(Beside):
    """A craft that is a program of its own, a daemon, and ``pid fly`` beside them."""

    def __init__(self, daemon):
        super().__init__(daemon)
        self.file = daemon.folder / "gains.toml"
        self.file.write_text(f'firmware = "2.x"\n"{GAIN}" = 200.0\n')

    @contextlib.contextmanager
    def in_programme(self):
        """Flying with other gains."""
        with self.flying("--gains", self.file, *LONG, mark="pid fly manoeuvre") as flight:
            assert self.gains()[GAIN] == 200.0
            yield flight

    def require_landed(self):
        until(lambda: any("has landed" in text for text in self.events("landing")), "it lands")
        until(lambda: self.gains()[GAIN] == STOCK, "the former gain is back")


@pytest.fixture
def more():
    """Settings of the craft besides."""
    return DECK


@pytest.fixture
def sessions(tmp_path):
    return tmp_path / "sessions"


@pytest.fixture
def field(tmp_path, more, sessions):
    uri = f"127.0.0.1:{free_port()}"
    configured = tmp_path / "groundstation.toml"
    configured.write_text(f'[recording]\nfolder = "{sessions}"\nlow_space_mb = 0\n')
    with (
        software_craft(tmp_path, f"{SETTINGS}{more}\n", "--crtp", uri),
        Daemon(tmp_path, "--link", f"udp://{uri}", "--config", configured) as daemon,
    ):
        daemon.status_when(connected, "the craft is there")
        yield Field(daemon)


def test_it_is_brought_back_between_manoeuvres_landed_and_its_steps_are_measured(field):
    flight = field.flown("--thrust", "height:0.6", "--json", *SHORT)
    report = json.loads(flight.stdout)
    assert report["motors"] == "landed, motors are off"
    assert "the craft holds 0.6 m by itself; Ctrl-C lands it" in flight.stderr
    assert report["axes"]["roll"]["edges"] == 6
    assert report["axes"]["roll"]["measured"]["overshoot_pct"] < 20.0
    recording = open_recording(Path(report["recording"]))
    sent = [e for e in recording.commands if e["kind"] == "setpoint" and "height_m" in e]
    assert {e["thrust"] for e in sent} == {0}
    assert abs(sent[0]["height_m"]) < 0.02
    assert max(e["height_m"] for e in sent) == pytest.approx(0.6, abs=0.02)
    leans = [e for e in sent if e["roll_deg"]]
    assert max(abs(e["roll_deg"]) for e in leans) == pytest.approx(10.0, abs=0.5)
    assert not any("vx_m_s" in e for e in leans)
    assert any(e["vx_m_s"] or e["vy_m_s"] for e in sent if "vx_m_s" in e)
    places = recording.tables["state"].columns
    away = np.hypot(places["stateEstimate.x"], places["stateEstimate.y"])
    assert 0.2 < away.max() < 1.0
    assert away[-1] < 0.3


def test_gains_that_flew_are_stored_and_cleared_again(field):
    asked = ("--gains", field.file, *SHORT)
    assert "give one" in require_failure(field.fly("--store", "--restore", *asked))
    flight = field.flown("--store", "--json", *asked)
    assert json.loads(flight.stdout)["stored"] == [GAIN]
    kept = ask(field.daemon.socket, "GET", "/command/stored")["parameters"][GAIN]
    assert kept == {"now": 200.0, "default": STOCK, "stored": 200.0}
    assert f"stored gains cleared, the stock ones are back: {GAIN}" in field.fly("--undo").stdout
    kept = ask(field.daemon.socket, "GET", "/command/stored")["parameters"][GAIN]
    assert kept == {"now": STOCK, "default": STOCK, "stored": None}


def test_a_first_ctrl_c_lands_it_and_puts_the_gains_back(field):
    with field.in_programme() as flight:
        flight.send_signal(signal.SIGINT)
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "flight aborted: Ctrl-C; landed, motors are off" in stderr
    assert "the former parameters are back" in stderr
    field.require_landed()


def test_a_ctrl_c_in_the_landing_is_told_and_puts_the_gains_back(field):
    with field.flying("--gains", field.file, *SHORT, mark="pid fly landing") as flight:
        flight.send_signal(signal.SIGINT)
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "flight aborted: Ctrl-C; landed, motors are off" in stderr
    field.require_landed()


def test_a_stop_in_the_landing_is_no_good_flight(field):
    with field.flying("--gains", field.file, *SHORT, mark="pid fly landing") as flight:
        field.daemon.ask("POST", "/command/stop")
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "Stopped by the operator, motors off" in stderr
    until(lambda: field.gains()[GAIN] == STOCK, "the former gain is back")


def test_a_second_ctrl_c_stops_its_motors(field):
    with field.in_programme() as flight:
        flight.send_signal(signal.SIGTERM)
        for line in flight.stderr:
            if "landing; Ctrl-C again stops the motors" in line:
                break
        flight.send_signal(signal.SIGINT)
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "stopping the motors" in stderr
    assert "flight aborted: SIGTERM; motors are off" in stderr
    assert field.gains()[GAIN] == STOCK
    assert not any("has landed" in text for text in field.events("landing"))


def test_a_client_that_stood_still_for_a_while_is_landed_and_its_gains_are_put_back(field):
    with field.in_programme() as flight:
        flight.send_signal(signal.SIGSTOP)
        time.sleep(1.2)
        flight.send_signal(signal.SIGCONT)
        _, stderr = flight.communicate(timeout=60)
    assert flight.returncode == 1
    assert "no setpoint came in time: the craft is landed" in stderr
    field.require_landed()


def test_the_operator_s_land_ends_it(field):
    with field.in_programme() as flight:
        landed = ask(field.daemon.socket, "POST", "/command/land")
        assert landed["motors"] == "landed"
        _, stderr = flight.communicate(timeout=60)
    assert "Landed by the operator, landed, motors off" in stderr
    field.require_landed()


def test_a_flight_that_is_no_more_recorded_lands(field):
    with field.in_programme() as flight:
        ask(field.daemon.socket, "POST", "/record/stop")
        _, stderr = flight.communicate(timeout=60)
    assert "flight aborted: recording: nothing is being recorded" in stderr
    assert "landed, motors are off" in stderr
    field.require_landed()


class TestOnASmallDisk:
    @pytest.fixture
    def sessions(self, small_disk):
        return small_disk("1200k")

    def test_a_disk_that_fills_in_flight_lands_it(self, field):
        with field.in_programme() as flight:
            _, stderr = flight.communicate(timeout=100)
        assert flight.returncode == 1
        assert "flight aborted: recording: " in stderr
        assert "landed, motors are off" in stderr
        field.require_landed()


@pytest.mark.parametrize("more", [f"{DECK}\nsoftware_build = true"])
def test_a_craft_that_refuses_to_store_says_so_and_has_flown(field):
    flight = field.fly("--store", "--gains", field.file, *SHORT)
    assert flight.returncode == 1
    assert "flown and recorded to" in flight.stderr
    assert "refused to store pid_rate.roll_kp" in flight.stderr


TILTED = "[effects.imu_misalignment]\nroll_deg = 12.0\npitch_deg = 0.0\nyaw_deg = 0.0"


@pytest.mark.parametrize("more", [f"{DECK}\n{TILTED}"])
def test_a_craft_that_does_not_stand_level_turns_no_motor(field):
    refused = require_failure(field.fly(*SHORT))
    assert "the craft does not stand: it is tilted by 12 deg" in refused
    assert refused.endswith("nothing was flown")
    assert field.events("mark") == []


@pytest.mark.parametrize("more", ["height_deck = true"])
def test_a_craft_that_knows_its_height_alone_flies_and_is_landed(field):
    flight = field.flown("--json", *SHORT)
    report = json.loads(flight.stdout)
    assert report["motors"] == "landed, motors are off"
    recording = open_recording(Path(report["recording"]))
    assert not any("vx_m_s" in entry for entry in recording.commands)
