"""A programme is flown in software, by the identified model, before the real craft flies it."""

import json

import msgspec
import pytest

from groundstation.control.firmware_loop import gains_text
from groundstation.dynamics.model import EffectTerm, Estimate, save_model, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from support.daemons import in_process, require_failure

TURNED = EffectTerm(
    "imu_misalignment",
    {"roll_deg": Estimate(2.0), "pitch_deg": Estimate(-1.0), "yaw_deg": Estimate(0.0)},
)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A craft with an IMU that is turned: it has a trim, and drifts."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    plain = vehicle_model(BUILT_IN["crazyflie21"])
    save_model(msgspec.structs.replace(plain, effects=(TURNED,)), path)
    return path


def rehearsed(model, *more):
    return in_process("pid", "fly", "--rehearse", "--model", model, "--repeat", "1", *more)


def test_it_is_told_how_far_it_goes_and_how_its_steps_come_out(model):
    done = rehearsed(model)
    assert done.returncode == 0, done.stderr
    assert "rehearsed in software" in done.stdout
    told = json.loads(rehearsed(model, "--json").stdout)
    assert 0.05 < told["rehearsal"]["farthest_m"] < 1.7
    assert 0.1 < told["rehearsal"]["top_m_s"] < 1.5
    assert set(told["axes"]) == {"roll", "pitch", "yaw"}
    assert 0.2 < told["axes"]["roll"]["measured"]["rms"] / told["axes"]["roll"]["step"] < 0.6


def test_gains_with_which_the_model_does_not_fly_end_it_and_no_daemon_is_asked(model, tmp_path):
    gains = tmp_path / "gains.toml"
    wrong = {"pid_rate.roll_kp": 2.0, "pid_rate.roll_ki": 0.0, "pid_attitude.roll_kp": 60.0}
    gains.write_text(gains_text(wrong, "2.x"))
    done = rehearsed(model, "--gains", gains)
    assert done.returncode == 1
    line = done.stderr.rstrip().rpartition("\n")[2]
    assert "the model does not fly this to its end" in line
    assert line.endswith("no craft was touched")


def test_without_a_model_there_is_nothing_to_rehearse():
    line = require_failure(in_process("pid", "fly", "--rehearse"))
    assert "give the identified craft, --model" in line
