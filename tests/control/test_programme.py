"""What ``pid fly`` commands, and when it must not go on."""

import math

import numpy as np
import pytest

from groundstation.control.programme import (
    LANDING,
    SETTLE_S,
    AbortLimits,
    LowBattery,
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


def test_a_craft_that_holds_its_place_flies_the_same_manoeuvres_one_by_one():
    programme = Programme(axes=("roll", "yaw"), repeats=2, hold_s=0.5)
    names, tables = zip(*programme.parts(), strict=True)
    assert names == ("roll doublet", "roll doublet", "yaw doublet", "yaw doublet")
    moved = programme.setpoints()
    moved = moved[moved.any(axis=1)]
    np.testing.assert_array_equal(moved, np.vstack(tables))
    assert programme.held_seconds > programme.seconds


def test_a_craft_that_holds_its_place_is_given_room_and_speed_for_its_programme_and_little_more():
    programme = Programme()
    assert programme.reach_m + 0.2 < programme.held_reach_m < programme.reach_m + 0.6
    speed = 9.81 * math.tan(math.radians(10.0)) * programme.hold_s
    assert speed < programme.speed_most_m_s < 1.3 * speed
    assert Programme(axes=("yaw",)).held_reach_m < 0.3
    assert Programme(axes=("yaw",)).speed_most_m_s == 1.5
    assert not Programme(shape="level").parts()


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
        ({"battery_v": None}, "battery"),
        ({"age_s": 1.2}, "no telemetry for 1.20 s"),
        ({"age_s": math.nan}, "no telemetry"),
        ({"link_state": "lost"}, "telemetry lost"),
        ({"link_state": "silent", "age_s": 1.01}, "no telemetry for 1.01 s"),
    ],
)
def test_each_loss_ends_the_flight(changes, complaint):
    assert complaint in reason_to_abort(answer(**changes), LowBattery())


def test_a_flight_that_is_well_goes_on():
    assert reason_to_abort(answer(), LowBattery()) == ""
    # a computer that is held up for half a second
    assert reason_to_abort(answer(link_state="silent", age_s=0.6), LowBattery()) == ""
    assert reason_to_abort({"telemetry": None, "link_state": "streaming"}, LowBattery()) != ""
    edge = answer(yaw_deg=-179.0, roll_deg=AbortLimits().tilt_deg)
    assert reason_to_abort(edge, LowBattery()) == ""


def test_a_craft_that_never_tells_its_battery_is_flown_on_what_else_it_tells():
    assert reason_to_abort(answer(battery_v=None), None) == ""
    assert "tilt" in reason_to_abort(answer(battery_v=None, roll_deg=60.0), None)


def test_meeting_the_ground_is_no_reason_to_abort_a_landing():
    hit = answer(roll_deg=70.0, gyro_dps=[1500.0, 0.0, 0.0])
    assert reason_to_abort(hit, LowBattery()) != ""
    assert reason_to_abort(hit, LowBattery(), LANDING) == ""


def low_at(seconds, low, battery_v, age_s=0.01):
    said = answer(battery_v=battery_v, age_s=age_s)
    said["time_ns"] = 1_000_000_000_000 + round(1e9 * (seconds + age_s))
    return reason_to_abort(said, low)


def test_a_sag_of_starting_rotors_does_not_end_a_flight_and_one_that_lasts_does():
    low = LowBattery()
    assert low_at(0.0, low, 2.2) == ""
    assert low_at(0.01, low, 3.4) == ""
    for tick in range(200):
        assert low_at(1.0 + 0.01 * tick, low, 2.8 if tick else 2.6) == "", tick
    reason = low_at(3.0, low, 2.85)
    assert reason.startswith("battery below 3 V for 2.0 s, now 2.85 V, 2.60 V at the least")
    assert low_at(3.01, low, 3.1) == ""
    assert low_at(5.02, low, 2.9) == ""


def test_one_low_reading_heard_again_and_again_is_still_one():
    low = LowBattery()
    assert [low_at(0.0, low, 2.2, age_s=0.1 * step) for step in range(10)] == [""] * 10
