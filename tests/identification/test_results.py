"""What could not be fitted is no result; what could begins with what it is good for."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.dynamics.meanings import Use, suitability
from groundstation.dynamics.model import origin_notes, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN, load_vehicle
from groundstation.errors import BadInputError
from groundstation.identification.estimate import no_results, require_results
from groundstation.identification.report import advice_of, good_for, next_of

VEHICLE = load_vehicle("crazyflie1")
BEFORE = vehicle_model(VEHICLE)
C0, _, C2 = VEHICLE.body_constants


def account(validation=None, **estimates):
    values, errors = zip(*estimates.values(), strict=True) if estimates else ((), ())
    found = {"names": list(estimates), "values": list(values), "stderr": list(errors)}
    return {"what": "body", "estimates": found, "validation": validation or {}}


def judged(**given):
    return no_results(account(**given), BEFORE, VEHICLE)


@given(st.floats(0.5, 2.0), st.floats(1e-4, 0.2))
def test_what_a_craft_of_the_profile_can_have_is_a_result(factor, error):
    assert judged(c0=(1.01 * factor * C0, error * C0)) == ([], [], [])


@given(st.floats(5.01, 1e4), st.booleans())
def test_what_none_can_have_is_none(factor, less):
    value = C0 / factor if less else C0 * factor
    reasons, _, _ = judged(c0=(value, 0.01 * value))
    assert len(reasons) == 1
    assert "by the profile 'crazyflie1'" in reasons[0]


def test_a_constant_that_is_only_unusual_is_worth_a_word():
    assert [len(one) for one in judged(c0=(3 * C0, 0.01 * C0))] == [0, 0, 1]
    assert [len(one) for one in judged(c2=(8 * C2, 0.01 * C2))] == [0, 0, 1]


@pytest.mark.parametrize("error", [0.0, np.nan, np.inf])
def test_an_error_that_nothing_tells_is_no_result(error):
    reasons, _, _ = judged(c0=(1.2 * C0, error))
    assert len(reasons) == 1


def test_an_estimate_that_stands_where_it_began_is_none():
    (reason,), _, _ = judged(c0=(C0, 0.0))
    assert "where it began" in reason
    (reason,), _, _ = judged(a0=(VEHICLE.motor.a0, 0.1))
    assert "did not move" in reason


def predicted(roll, pitch, **others):
    """Held-out figures from the per cent of fit of roll and pitch 20 ms ahead."""
    tilt = {"gyro_roll_fit_percent_20ms": roll, "gyro_pitch_fit_percent_20ms": pitch}
    return judged(validation=tilt | others)


def test_a_prediction_worse_than_the_mean_is_said_and_one_of_twice_its_error_is_poor():
    told = predicted(70.0, 60.0, accelerometer_z_fit_percent=-3.0)
    assert [len(one) for one in told] == [0, 0, 1]
    reasons, (poor,), (doubt,) = predicted(-37.0, -250.0)
    assert not reasons
    assert "gyro pitch 20ms on unseen data is predicted worse than by its mean" in poor
    assert "gyro roll 20ms" in doubt


def test_motors_that_predict_no_speed_are_none():
    rotors = [{"recording": "a", "rotor_fit_percent": -120.0, "rotor_rms_rev_s": 9.0}]
    motor = account(validation=rotors) | {"what": "motor"}
    (reason,), poor, _ = no_results(motor, BEFORE, VEHICLE)
    assert "rotor speed of a" in reason
    assert not poor


def bad_account():
    figures = dict.fromkeys(("gyro_roll_fit_percent_20ms", "gyro_pitch_fit_percent_20ms"), -250.0)
    return account(validation=figures, c0=(1.2 * C0, 0.01 * C0))


def test_a_body_that_predicts_badly_is_written_as_poor_and_is_for_a_search_alone():
    told = bad_account()
    doubts = require_results(told, BEFORE, VEHICLE)
    assert len(doubts) == 2
    assert told["quality"] == "poor"
    model = msgspec.structs.replace(BEFORE, fit={"body": told})
    assert not any(one.designs for one in suitability(model).values())
    said, kind = good_for(BEFORE, told)
    assert said.startswith("Roll, pitch and yaw: only to search for what is missing")
    assert kind == "bad"
    assert next_of(told).startswith("look for what is missing: groundstation discrepancy")
    assert any("only search with it" in line for line in origin_notes(model))


@pytest.mark.parametrize(
    ("verdict", "use"),
    [
        ("effects_found", Use.FIRST_DESIGN),
        ("found_in_part", Use.SIMULATION),
        ("no_discrepancy", Use.SIMULATION),
        ("unexplained", Use.SEARCH),
    ],
)
def test_what_a_search_found_decides_what_a_poor_body_is_good_for(verdict, use):
    told = bad_account()
    require_results(told, BEFORE, VEHICLE)
    searched = {"body": told, "discrepancy": {"verdict": verdict}}
    model = msgspec.structs.replace(BEFORE, fit=searched)
    assert {one.use for one in suitability(model).values()} == {use}
    warned = any("only search with it" in line for line in origin_notes(model))
    assert warned == (use == Use.SEARCH)


def test_a_body_of_recordings_that_contradict_themselves_is_none():
    with pytest.raises(BadInputError, match=r"worse than by its mean.*turns against"):
        require_results(bad_account(), BEFORE, VEHICLE, ["a: attitude turns against the gyro"])


@pytest.mark.parametrize("channel", ["accelerometer_z", "gyro_yaw"])
def test_a_channel_that_hardly_moves_does_not_refute_a_model_of_roll_and_pitch(channel):
    reasons, poor, (doubt,) = predicted(70.0, 70.0, **{f"{channel}_fit_percent": -244.0})
    assert not reasons
    assert not poor
    assert "on unseen data is predicted worse than by its mean" in doubt


def test_a_flight_that_turns_about_pitch_alone_does_not_refute_a_model_by_its_roll():
    reasons, poor, (doubt,) = predicted(-407.0, 78.0)
    assert not reasons
    assert not poor
    assert "gyro roll 20ms on unseen data" in doubt


MODEL = vehicle_model(BUILT_IN["crazyflie21"])

FILES = {"recordings": [{"file": "a.mcap"}, {"file": "b.mcap"}], "held_out": [{"file": "c.mcap"}]}


def known_to(c0=0.02, c1=0.02, c2=0.02, **more):
    """A body fit whose constants are known to these shares."""
    names, shares = ["c0", "c1", "c2", "thrust_per_mass"], [c0, c1, c2, 0.001]
    estimates = {"names": names, "values": [1.0] * 4, "stderr": shares}
    return {"what": "body", "estimates": estimates, "rate_hz": 500.0, **FILES, **more}


def test_a_model_that_knows_every_axis_is_good_enough_to_design_with():
    said, kind = good_for(MODEL, known_to())
    assert said.startswith("Good enough to design roll, pitch and yaw with.")
    assert "roll to 2 %" in said
    assert kind == "good"
    assert "groundstation discrepancy" in next_of(known_to())
    assert advice_of(known_to(), []) == []


def test_an_axis_that_is_not_identified_is_said_with_what_to_fly():
    reason = {"c2": "yaw is hardly excited: 2e-05 +- 0.0002"}
    one = known_to(c2=9.0, not_identified=reason)
    said, kind = good_for(MODEL, one)
    assert "Good enough to design roll and pitch with; yaw: not identified" in said
    assert "yaw to" not in said
    assert kind == "neutral"
    assert next_of(one).startswith("fly yaw steps of 60 degrees both ways")
    (first,) = advice_of(one, [])
    assert first.what == "Yaw is not identified: yaw is hardly excited: 2e-05 +- 0.0002"
    assert first.fly.startswith("Fly yaw steps")


@pytest.mark.parametrize(
    ("share", "words"), [(0.12, "first, cautious design"), (0.5, "rough simulation only")]
)
def test_what_is_known_worse_is_good_for_less(share, words):
    said, _ = good_for(MODEL, known_to(c0=share, c1=share))
    assert f"oll and pitch: for a {words}" in said
    assert [one.what for one in advice_of(known_to(c0=share), [])] == [
        f"Roll is known to {100 * share:.0f} % only"
    ]


def test_what_no_manoeuvre_tells_is_to_be_recorded_otherwise():
    one = known_to(c2=1.0, not_identified={"c2": "rows fold"}, record={"c2": "500 rows a second"})
    assert next_of(one) == "record 500 rows a second, and fit both recordings together."
    assert advice_of(one, [])[0].fly == "Record 500 rows a second"


def test_what_shows_and_was_left_out_is_offered_as_the_next_command():
    one = known_to(left_out=["dead_time", "rotor_acceleration_torque"])
    assert next_of(one).endswith(
        "groundstation fit body a.mcap b.mcap --validate c.mcap -o NEW_FILE --with"
        " dead_time,rotor_acceleration_torque"
    )


def test_slow_samples_and_inputs_that_still_show_are_told():
    slow, left = advice_of(known_to(rate_hz=100.0), ["yaw rate"])
    assert slow.what == "100 samples a second show one in 5.0 of the motors' settings"
    assert left.what == "The input still shows in what is left of yaw rate"
