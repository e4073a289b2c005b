"""What a fit leaves that could not fit is never passed on as a result."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.fit_record import no_results

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
    assert judged(c0=(1.01 * factor * C0, error * C0)) == ([], [])


@given(st.floats(5.01, 1e4), st.booleans())
def test_what_none_can_have_is_none(factor, less):
    value = C0 / factor if less else C0 * factor
    reasons, _ = judged(c0=(value, 0.01 * value))
    assert len(reasons) == 1
    assert "by the profile 'crazyflie1'" in reasons[0]


def test_a_constant_that_is_only_unusual_is_worth_a_word():
    assert [len(one) for one in judged(c0=(3 * C0, 0.01 * C0))] == [0, 1]
    assert [len(one) for one in judged(c2=(8 * C2, 0.01 * C2))] == [0, 1]


@pytest.mark.parametrize("error", [0.0, np.nan, np.inf])
def test_an_error_that_nothing_tells_is_no_result(error):
    reasons, _ = judged(c0=(1.2 * C0, error))
    assert len(reasons) == 1


def test_an_estimate_that_stands_where_it_began_is_none():
    (reason,), _ = judged(c0=(C0, 0.0))
    assert "where it began" in reason
    (reason,), _ = judged(a0=(VEHICLE.motor.a0, 0.1))
    assert "did not move" in reason


def predicted(roll, pitch, **others):
    """Held-out figures from the per cent of fit of roll and pitch 20 ms ahead."""
    tilt = {"gyro_roll_fit_percent_20ms": roll, "gyro_pitch_fit_percent_20ms": pitch}
    return judged(validation=tilt | others)


def test_a_prediction_worse_than_the_mean_is_said_and_one_of_twice_its_error_is_none():
    assert [len(one) for one in predicted(70.0, 60.0, accelerometer_z_fit_percent=-3.0)] == [0, 1]
    (reason,), (doubt,) = predicted(-37.0, -250.0)
    assert "gyro pitch 20ms on unseen data is predicted worse than by its mean" in reason
    assert "gyro roll 20ms" in doubt
    rotors = [{"recording": "a", "rotor_fit_percent": -120.0, "rotor_rms_rev_s": 9.0}]
    (reason,), _ = judged(validation=rotors)
    assert "rotor speed of a" in reason


@pytest.mark.parametrize("channel", ["accelerometer_z", "gyro_yaw"])
def test_a_channel_that_hardly_moves_does_not_refute_a_model_of_roll_and_pitch(channel):
    reasons, (doubt,) = predicted(70.0, 70.0, **{f"{channel}_fit_percent": -244.0})
    assert not reasons
    assert "on unseen data is predicted worse than by its mean" in doubt


def test_a_flight_that_turns_about_pitch_alone_does_not_refute_a_model_by_its_roll():
    reasons, (doubt,) = predicted(-407.0, 78.0)
    assert not reasons
    assert "gyro roll 20ms on unseen data" in doubt
