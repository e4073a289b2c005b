"""A fault of a recording is told as what it is: measured, expected, the two likeliest causes."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.comparison.comparison import compare
from groundstation.comparison.consistency import broken_rotor_sensors, require_consistent
from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.identification.runs import without_gaps
from support.flights import BASE
from support.flights import compared as flights


@pytest.fixture(scope="module")
def flight():
    return flights(1)[0]


def said_of(run, model=BASE):
    with pytest.raises(BadInputError) as refused:
        require_consistent([run], model)
    assert "likeliest" in str(refused.value)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def exchanged(values, one, other):
    out = values.copy()
    out[:, [one, other]] = out[:, [other, one]]
    return out


def test_a_good_recording_passes(flight):
    require_consistent([flight], BASE)


@pytest.mark.parametrize(("one", "other"), [(0, 1), (1, 3), (0, 2)])
def test_exchanged_motors_are_named(flight, one, other):
    said = said_of(replace(flight, duty=exchanged(flight.duty, one, other)))
    assert f"with M{one + 1} and M{other + 1} exchanged" in said


def test_another_configuration_is_said_where_it_explains_clearly_more(flight):
    said = said_of(flight, vehicle_model(load_vehicle("crazyflie21")))
    assert "in configuration 'plus'" in said
    assert "in the model's 'x'" in said
    assert "--vehicle" in said


def test_a_gyro_in_degrees_is_told_by_its_unit(flight):
    said = said_of(replace(flight, gyro=np.degrees(flight.gyro)))
    assert "0.0175 times as fast as the gyro says, where 1 is expected" in said
    assert "the gyro is in deg/s where rad/s are meant" in said


def test_a_gyro_in_degrees_is_told_without_attitude_by_the_answer_to_torque(flight):
    blind = replace(flight, attitude=np.full_like(flight.attitude, np.nan))
    said = said_of(replace(blind, gyro=np.degrees(flight.gyro)))
    assert "answers to torque by" in said
    assert "the gyro's unit" in said


def test_a_pitch_of_the_other_sign_is_told_as_that(flight):
    said = said_of(replace(flight, attitude=flight.attitude * [1.0, -1.0, 1.0]))
    assert "pitch -1 times as fast" in said
    assert "pitch has the other sign in the recording" in said


def test_a_pitch_of_the_other_sign_is_told_at_hover():
    (still,) = flights(1, program="hover", torque_noise=3.0)
    require_consistent([still], BASE)
    said = said_of(replace(still, attitude=still.attitude * [1.0, -1.0, 1.0]))
    assert "pitch -1 times as fast" in said


def test_a_gyro_axis_of_the_other_sign_is_told_by_the_rotors(flight):
    said = said_of(replace(flight, gyro=flight.gyro * [1.0, -1.0, 1.0]))
    assert "with M1 and M3 exchanged" in said  # in plus configuration it is the same
    assert "the axis of the gyro between them has the other sign" in said


def test_an_accelerometer_in_g_is_told_by_its_unit(flight):
    said = said_of(replace(flight, accelerometer=flight.accelerometer / 9.80665))
    assert "in g where m/s^2 are meant" in said


def test_another_crafts_thrust_is_told_with_its_ratio(flight):
    body = msgspec.structs.replace(BASE.body, thrust_per_mass=3.0 * BASE.body.thrust_per_mass)
    said = said_of(flight, msgspec.structs.replace(BASE, body=body))
    assert "0.33 times the thrust" in said


def test_a_heavier_craft_is_no_other_craft(flight):
    body = msgspec.structs.replace(BASE.body, thrust_per_mass=1.25 * BASE.body.thrust_per_mass)
    require_consistent([flight], msgspec.structs.replace(BASE, body=body))


def test_a_gain_that_a_lasting_torque_made_small_is_no_other_craft(flight):
    body = msgspec.structs.replace(BASE.body, c0=BASE.body.c0 / 30.0)
    require_consistent([flight], msgspec.structs.replace(BASE, body=body))


def test_a_rotor_sensor_that_does_not_follow_is_named(flight):
    from groundstation.identification.runs import rotor_squares

    speeds = np.sqrt(rotor_squares(without_gaps(flight), BASE.motor).end)
    assert broken_rotor_sensors(flight, BASE) == []
    assert broken_rotor_sensors(replace(flight, rotor_rev_s=speeds), BASE) == []
    dead = speeds.copy()
    dead[:, 2] = 0.0
    assert broken_rotor_sensors(replace(flight, rotor_rev_s=dead), BASE) == [2]


@pytest.mark.parametrize("plant", ["reduced", "faithful"])
def test_a_motor_bench_is_no_flight(plant):
    (recorded,) = flights(1, plant=plant, program="motor_bench")
    assert "shows 0%" in said_of(recorded)


def test_a_craft_that_hardly_moves_is_not_taken_for_one_that_is_held(flight):
    still = np.full_like(flight.accelerometer, [0.0, 0.0, 9.81])
    assert "was held" in said_of(replace(flight, accelerometer=still))
    require_consistent(
        [replace(flight, accelerometer=still + 0.2 * (flight.accelerometer - still))], BASE
    )


def test_a_model_that_grows_without_end_is_refused():
    endless = EffectTerm(
        "quadratic_rate_damping", {"damping_n_m_s2": Estimate(-1.0, None, "N m s^2")}
    )
    model = msgspec.structs.replace(BASE, effects=(endless,))
    with pytest.raises(BadInputError, match=r"predicts no number there.*motor constants"):
        compare(flights(1), model)
