"""What ``pid fly`` commands, and when it must not go on."""

import math

import numpy as np
import pytest

from groundstation.control.programme import (
    LANDING,
    SETTLE_S,
    AbortLimits,
    Programme,
    reason_to_abort,
    require_flyable,
)
from groundstation.errors import BadInputError


def answer(**changes):
    telemetry = {
        "age_s": 0.01,
        "timestamp": 1,
        "roll_deg": 3.0,
        "pitch_deg": -4.0,
        "yaw_deg": 170.0,
        "gyro_dps": [10.0, -20.0, 30.0],
        "battery_v": 3.7,
        "motors": [0.5] * 4,
    }
    link = changes.pop("link_state", "streaming")
    return {"time_ns": 1, "telemetry": {**telemetry, **changes}, "link_state": link}


def test_a_doublet_goes_there_across_and_back_with_alternating_sign():
    table = Programme(axes=("pitch",), repeats=2, hold_s=0.5, rest_s=0.2).setpoints()
    start = round(SETTLE_S * 100)
    assert not table[:start].any()
    assert not table[-start:].any()
    one, other = np.split(table[start:-start, 1], 2)
    assert one.tolist() == [10.0] * 50 + [-10.0] * 50 + [0.0] * 20
    np.testing.assert_array_equal(other, -one)
    assert not table[:, [0, 2]].any()


def test_a_doublet_returns_the_speed_it_gave():
    table = Programme(axes=("roll",), repeats=1).setpoints()
    acceleration = -9.81 * np.tan(np.radians(table[:, 0]))
    speed = np.cumsum(acceleration) * 0.01
    place = np.cumsum(speed) * 0.01
    assert speed[-1] == pytest.approx(0, abs=1e-9)
    assert np.abs(place).max() == pytest.approx(Programme().reach_m, rel=0.02)


def test_a_step_stays_on_its_side_and_level_flight_commands_nothing():
    step = Programme(shape="step", axes=("yaw",), repeats=1).setpoints()[:, 2]
    assert set(step.tolist()) == {0.0, 60.0}
    assert not Programme(shape="level").setpoints().any()


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"angle_deg": 40.0}, "--amplitude 40"),
        ({"angle_deg": math.nan}, "--amplitude nan"),
        ({"yaw_dps": 500.0}, "--yaw-rate 500"),
        ({"hold_s": 0.01}, "--hold"),
        ({"repeats": 0}, "--repeat 0"),
        ({"shape": "loop"}, "doublet, step, level"),
        ({"axes": ("height",)}, "roll, pitch, yaw"),
    ],
)
def test_what_should_not_be_flown_is_refused(changes, complaint):
    with pytest.raises(BadInputError, match=complaint):
        require_flyable(Programme(**changes))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"roll_deg": -51.0}, "tilt of 51 deg"),
        ({"pitch_deg": 60.0}, "tilt of 60 deg"),
        ({"pitch_deg": None}, "tilt"),
        ({"roll_deg": math.nan}, "tilt"),
        ({"gyro_dps": [0.0, 0.0, -900.0]}, "rate of 900 deg/s"),
        ({"gyro_dps": [0.0, None, 0.0]}, "rate"),
        ({"battery_v": 2.9}, "battery at 2.9 V"),
        ({"battery_v": None}, "battery"),
        ({"age_s": 1.2}, "no telemetry for 1.20 s"),
        ({"age_s": math.nan}, "no telemetry"),
        ({"link_state": "lost"}, "telemetry lost"),
        ({"link_state": "silent"}, "telemetry lost"),
    ],
)
def test_each_loss_ends_the_flight(changes, complaint):
    assert complaint in reason_to_abort(answer(**changes))


def test_a_flight_that_is_well_goes_on():
    assert reason_to_abort(answer()) == ""
    assert reason_to_abort({"telemetry": None, "link_state": "streaming"}) != ""
    assert reason_to_abort(answer(yaw_deg=-179.0, roll_deg=AbortLimits().tilt_deg)) == ""


def test_meeting_the_ground_is_no_reason_to_abort_a_landing():
    hit = answer(roll_deg=70.0, gyro_dps=[1500.0, 0.0, 0.0])
    assert reason_to_abort(hit) != ""
    assert reason_to_abort(hit, LANDING) == ""
    assert "battery" in reason_to_abort(answer(battery_v=2.0), LANDING)
