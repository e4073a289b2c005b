"""The live twin of the installed command: on the stand-in, and on a recording of a flight."""

import json

import pytest

from groundstation.dynamics.model import save_model
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import RecordingFile, session_metadata
from support import RECORDINGS
from support.daemons import Daemon, in_process, refused_run
from support.flights import BASE
from support.flights import twin_flight as flight

CONFIG = """
[stand_in]
plant = "reduced"
copies = 1
seed = 3
[stand_in.gains]
"pid_rate.roll_kp" = 30.0
"pid_rate.pitch_kp" = 30.0
"pid_attitude.roll_kp" = 3.0
"pid_attitude.pitch_kp" = 3.0
"pid_attitude.roll_ki" = 3.0
"pid_attitude.pitch_ki" = 3.0
[stand_in.effects.accelerometer_bias]
x_g = 0.05
"""


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    save_model(BASE, path)
    return path


def test_a_hidden_effect_is_told_while_the_stand_in_flies_and_is_in_the_recording(tmp_path, model):
    (tmp_path / "config.toml").write_text(CONFIG)
    arguments = ("--config", "config.toml", "--speed", "8", "--twin", model)
    with Daemon(tmp_path, *arguments) as daemon:
        status = daemon.status_when(
            lambda status: status["twin"] and status["twin"]["disagreements"], "a disagreement"
        )
        told = [each for each in daemon.ask("GET", "/events") if each["link"] == "twin"]
        assert daemon.stop() == 0
    assert status["twin"]["state"] == "watching"
    assert status["twin"]["gap"]["accelerometer_x"] > 1.2
    (each,) = status["twin"]["disagreements"]
    assert (each["channel"], each["end_s"]) == ("accelerometer_x", None)
    (event,) = (each for each in told if each["kind"] == "gap")
    assert event["text"].startswith("forward force disagrees throughout: ")
    assert event["text"] in daemon.stderr
    recording = open_recording(daemon.only_file())
    kept = next(each for each in recording.events if each["kind"] == "gap")
    assert kept["details"] == event["details"]
    report = json.loads(in_process("inspect", daemon.only_file(), "--json").stdout)
    assert report["marks"][0]["text"] == event["text"]
    assert [each["details"]["why"] for each in report["marks"]] == ["", "the daemon ended"]


def test_on_a_replayed_flight_it_tells_the_same_as_in_fast_time(tmp_path, model):
    samples = flight(60.0, 5, "rotor_acceleration_torque")
    recorded = RecordingFile(tmp_path / "flight.mcap", {"session": session_metadata("stand-in")})
    recorded.samples(samples)
    recorded.finish()
    with Daemon(
        tmp_path, "--link", f"replay:{tmp_path / 'flight.mcap'}", "--speed", "max", "--twin", model
    ) as daemon:
        assert daemon.wait() == 0
    events = [each for each in open_recording(daemon.only_file()).events if each["link"] == "twin"]
    places = [(each["details"]["channel"], each["details"]["regime"]) for each in events
              if each["kind"] == "gap"]  # fmt: skip
    assert ("gyro_z", "rotor acceleration") in places


def test_a_model_that_cannot_fly_is_refused_at_once(tmp_path):
    assert "nowhere.json" in refused_run(tmp_path, "--twin", tmp_path / "nowhere.json")
    assert list(tmp_path.iterdir()) == []


def test_telemetry_that_lacks_what_the_model_needs_costs_the_twin_only(tmp_path, model):
    with Daemon(
        tmp_path, "--link", f"replay:{RECORDINGS / 'microsd_log16'}", "--speed", "max", "--twin",
        model,
    ) as daemon:  # fmt: skip
        assert daemon.wait() == 0
        told = [
            each for each in open_recording(daemon.only_file()).events if each["link"] == "twin"
        ]
    assert [each["kind"] for each in told if each["kind"] != "preparing"] == ["waiting"]
    assert "the twin cannot fly: the telemetry has no" in told[-1]["text"]
