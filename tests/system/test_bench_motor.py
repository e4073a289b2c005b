"""``bench motor`` against a real daemon: thrust out over CRTP, blade times back, a motor."""

import json
import signal
from pathlib import Path

import pytest

from groundstation.dynamics.model import load_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.recording.formats import open_recording
from support.commands import Beside, connected, run
from support.daemons import Daemon
from support.programs import free_port
from support.waiting import until


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    settings = folder / "groundstation.toml"
    port = free_port()
    settings.write_text(
        f'command = "udp://127.0.0.1:{port}"\n[link]\nname = "stand-in"\n'
        '[stand_in]\nprogram = "bench"\nplant = "reduced"\nseed = 5\n'
        f'[recording]\nfolder = "{folder / "sessions"}"\nlow_space_mb = 0\n'
    )
    with Daemon(folder, "--config", settings) as running:
        running.status_when(connected, "the command link is connected")
        yield Beside(running)


def test_a_motor_driven_over_the_command_link_is_the_one_that_was_fitted(beside, tmp_path):
    model, page = tmp_path / "motor.json", tmp_path / "motor.html"
    done = beside.run("bench", "motor", "--seconds", 8, "--seed", 3, "--json")
    assert done.returncode == 0, done.stderr
    recorded = json.loads(done.stdout)["recording"]
    run("fit", "motor", recorded, "-o", model, "--html", page)
    assert "PROPELLERS WILL TURN at up to 80% of full thrust for 8 s" in done.stderr
    truth, motor = load_vehicle("crazyflie1").motor, load_model(model).motor
    for name in ("a0", "a1", "a2"):
        assert getattr(motor, name) == pytest.approx(getattr(truth, name), rel=0.03)
    assert "<svg" in page.read_text()
    recording = open_recording(Path(recorded))
    sent = [e["thrust"] for e in recording.commands if e["kind"] == "setpoint"]
    assert max(sent) <= 0.8 * 65535 + 1
    assert sent[-1] == 0
    assert not recording.samples.duty[-20:].any()
    assert any(e["text"] == "bench motor begins" for e in recording.events)


def test_ctrl_c_stops_the_motors_and_names_the_recording(beside):
    def begun():
        """How often motors have been driven."""
        return beside.events("mark").count("bench motor begins")

    before = begun()
    with beside.begun("bench", "motor", "--profile", "chirp", "--seconds", 60) as driving:
        until(lambda: begun() > before, "the motors are driven")
        driving.send_signal(signal.SIGINT)
        _, said = driving.communicate(timeout=60)
    assert driving.returncode == 1
    assert "bench aborted: Ctrl-C; motors are off, the recording is" in said
