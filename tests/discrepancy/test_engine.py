"""Hidden effects are found under their names, with their values, and nothing else is."""

import dataclasses
import functools

import msgspec
import numpy as np
import pytest
from scipy.signal import lfilter

from groundstation.discrepancy.acceptance import unconfirmed
from groundstation.discrepancy.engine import find_effects
from groundstation.discrepancy.proof import Verdict
from groundstation.discrepancy.screening import screen
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import point_of
from groundstation.identification.likelihood.problem import Fit, Problem
from groundstation.identification.runs import flights_of
from support.flights import BASE, base_model, flown
from support.flights import searched as flights
from support.flights import searched_samples as samples

HIDDEN = {
    "centre_of_gravity_offset": {"x_m": -0.0006, "y_m": 0.0004},
    "rotor_mismatch": {"rotor": 3.0, "excess": -0.04},
}
"""Others, one at a time: ``test_sealed.py``, ``test_commands.py``."""


def search(seed, effects, **more):
    runs, _ = flights(seed, effects, **more)
    return find_effects(runs, base_model())


@functools.cache
def searched_alone(name):
    """What is found where one of ``HIDDEN`` is."""
    return search(1, {name: HIDDEN[name]})


def values_of(effect):
    return {name: (one.value, one.stderr) for name, one in effect.parameters.items()}


def assert_found(findings, hidden):
    assert {effect.name for effect in findings.effects} == set(hidden)
    for effect in findings.effects:
        for name, (value, error) in values_of(effect).items():
            true = hidden[effect.name][name]
            if error is None:
                assert value == true
            else:
                assert value == pytest.approx(true, abs=max(4.0 * error, 1e-3 * abs(true)))


def test_a_delay_that_only_one_of_three_flights_has_is_not_named():
    def late(seed, ms):
        return flown(20.0, seed, effects={"dead_time": {"delay_s": 1e-3 * ms}})[0]

    found = find_effects([late(1, 4.0), late(2, 2.2), late(3, 3.0)], BASE)
    assert [effect.name for effect in found.effects] == ["dead_time"]
    found = find_effects([late(1, 4.0), late(2, 0.0), late(3, 0.0)], BASE)
    assert found.effects == ()


@pytest.mark.parametrize("name", HIDDEN)
def test_a_hidden_effect_is_named_and_nothing_else(name):
    hidden = {name: HIDDEN[name]}
    findings = searched_alone(name)
    assert findings.verdict == Verdict.EFFECTS_FOUND
    assert_found(findings, hidden)
    assert [term.name for term in findings.model.effects] == [name]
    assert findings.base.effects == ()
    assert findings.residual.verdict == "white"


def test_a_lasting_moment_without_a_name_bends_no_gain():
    """Once c0 and c1 went to a tenth: a craft that answers to no torque is in balance."""
    name = "centre_of_gravity_offset"
    runs, _ = flights(1, {name: HIDDEN[name]})
    model = base_model()
    problem = Problem(prepare(runs), model, point_of(model))
    screen(problem, problem.start)
    fit = problem.fit(problem.start, problem.base_keys)
    for constant in ("c0", "c1", "c2"):
        assert fit.point[constant] == pytest.approx(problem.start[constant], rel=0.02)


def test_flights_that_agree_tell_a_centre_of_gravity_to_a_few_micrometres():
    (effect,) = searched_alone("centre_of_gravity_offset").effects
    for estimate in effect.parameters.values():
        assert estimate.stderr < 5e-6


def test_a_change_of_a_constant_stands_only_where_its_own_axis_confirms_it():
    runs, _ = flights(3, {}, torque_noise=6.0, sensor_noise=2.0)
    model = base_model()
    problem = Problem(prepare(runs), model, point_of(model))
    c0, c1 = problem.start["c0"], problem.start["c1"]
    problem.start["c0"] = 0.8 * c0  # a given model that is wrong about roll
    point = {**problem.start, "c0": c0, "c1": 0.25 * c1}
    moved = Fit(point, ("c0", "c1"), 0.0, np.eye(2))
    assert unconfirmed(problem, moved) == ("c1",)
    assert unconfirmed(problem, dataclasses.replace(moved, point={**point, "c1": c1})) is None


def test_half_of_a_gain_that_was_given_wrong_is_found_all_the_same():
    """What is known of it is information, and flights tell more."""
    runs, _ = flights(1, {})
    right = base_model()
    body = msgspec.structs.replace(right.body, c0=0.5 * right.body.c0)
    found = find_effects(runs, msgspec.structs.replace(right, body=body))
    assert found.effects == ()
    assert found.model.body.c0 == pytest.approx(right.body.c0, rel=0.01)


def test_a_lag_of_the_gyro_is_told_though_the_attitude_is_made_of_that_gyro():
    """The rotors' acceleration behind a lag looks like yaw torque, and no attitude tells."""
    hidden = {
        "attitude_filter_lean": {"strength": 1.0},
        "gyro_low_pass": {"bandwidth_hz": 30.0},
        "rotor_acceleration_torque": {"rotor_inertia_kg_m2": 6e-8},
    }
    assert_found(search(6, hidden), hidden)


def test_nothing_is_found_in_a_craft_that_is_as_modelled():
    findings = search(3, {}, torque_noise=6.0, sensor_noise=2.0)
    assert findings.verdict == Verdict.NO_DISCREPANCY
    assert findings.effects == ()
    assert findings.residual.verdict == "white"


def test_a_push_that_no_effect_describes_stays_unexplained():
    findings = search(4, {"side_gust": {"frequency_hz": 0.7, "force_n": 0.01}})
    assert findings.verdict == Verdict.UNEXPLAINED
    assert findings.residual.channel in ("accelerometer_y", "gyro_x")
    assert any(abs(hz - 0.7) < 0.3 for hz in findings.residual.frequencies_hz)


def test_effects_that_the_model_has_already_are_not_found_again():
    hidden = {"rotor_mismatch": HIDDEN["rotor_mismatch"]}
    model = searched_alone("rotor_mismatch").model
    runs, _ = flights(1, hidden)
    findings = find_effects(runs, model)
    assert findings.verdict == Verdict.NO_DISCREPANCY
    assert [term.name for term in findings.model.effects] == ["rotor_mismatch"]


def test_a_motor_of_first_order_stays_one():
    import msgspec

    whole = base_model()
    slope = whole.motor.a1 + whole.motor.a2 * 250.0  # hover at about 250 rev/s
    motor = msgspec.structs.replace(whole.motor, a1=slope, a2=0.0)
    runs, _ = flights(3, {}, torque_noise=6.0, sensor_noise=2.0)
    found = find_effects(runs[:1], msgspec.structs.replace(whole, motor=motor))
    assert found.model.motor.a2 == 0.0
    assert found.model.motor.a0 > 0.0


def test_lost_rows_change_nothing_but_the_interval():
    hidden = {"rotor_acceleration_torque": {"rotor_inertia_kg_m2": 6e-8}}
    generator = np.random.default_rng(5)
    runs = []
    for number in range(3):
        whole = samples(60 + number, hidden)
        kept = generator.random(len(whole)) > 0.02
        runs += flights_of(whole[kept], f"lossy{number}")
    assert all(np.isnan(run.gyro).any() for run in runs)
    assert_found(find_effects(runs[:2], base_model()), hidden)


def test_without_attitude_the_names_that_need_it_are_listed_as_lost():
    hidden = {"centre_of_gravity_offset": HIDDEN["centre_of_gravity_offset"]}
    runs, _ = flights(1, hidden)
    blind = [dataclasses.replace(run, attitude=np.full_like(run.attitude, np.nan)) for run in runs]
    findings = find_effects(blind, base_model())
    assert_found(findings, hidden)
    assert findings.lost["gyro_bias"] == "attitude"


def test_a_hover_shows_which_effects_it_cannot_show():
    runs, _ = flights(7, {}, count=1, program="hover", span_s=60.0)
    findings = find_effects(runs, base_model())
    assert findings.effects == ()
    unseen = {one.name for one in findings.not_shown}
    assert {"inertia_coupling", "ground_effect"} <= unseen
    assert all(one.manoeuvre for one in findings.not_shown)


def test_a_model_of_another_craft_is_refused():
    other = vehicle_model(load_vehicle("crazyflie21"))  # its rotors stand between the axes
    runs, _ = flights(1, {})
    with pytest.raises(BadInputError, match="in configuration 'plus'"):
        find_effects(runs, other)


def test_a_flight_without_gyro_is_refused():
    runs, _ = flights(1, {})
    blind = [dataclasses.replace(runs[0], gyro=np.full_like(runs[0].gyro, np.nan))]
    with pytest.raises(BadInputError, match="gyro is missing"):
        find_effects(blind, base_model())


def test_a_recording_shorter_than_five_seconds_is_refused():
    with pytest.raises(BadInputError, match="at least 5 s"):
        flights_of(samples(10, {})[:2400], "short")


def test_a_payload_and_a_sensor_that_is_off_beside_it_are_both_told():
    """A bias of the accelerometer could stand for a mass; this one leaves the thrust alone."""
    hidden = {
        "mass_change": {"percent": 17.0},
        "accelerometer_bias": {"x_g": 0.0, "y_g": 0.03, "z_g": 0.0},
    }
    findings = search(3, hidden)
    assert {effect.name for effect in findings.effects} == set(hidden)
    told = next(effect for effect in findings.effects if effect.name == "mass_change")
    assert told.parameters["percent"].value == pytest.approx(17.0, abs=0.5)
    assert findings.model.body.thrust_per_mass == base_model().body.thrust_per_mass


def test_a_thrust_that_moved_to_make_room_for_a_bias_is_no_payload():
    """The model was fitted to flights whose accelerometer reads 0.06 g too much."""
    runs, _ = flights(1, {"accelerometer_bias": {"x_g": 0.0, "y_g": 0.0, "z_g": 0.06}})
    base = base_model()
    given = base.body.thrust_per_mass * 1.06
    bent = msgspec.structs.replace(
        base, body=msgspec.structs.replace(base.body, thrust_per_mass=given)
    )
    findings = find_effects(runs, bent)
    assert {effect.name for effect in findings.effects} == {"accelerometer_bias"}


def test_measured_rotor_speeds_that_lag_are_told_and_leave_the_rotors_inertia_as_it_is():
    """The sensor follows each speed in 5 ms, first order. A sampled lag is inverted to half a
    millisecond, and no better: so much may be told as a delay."""
    true_inertia, shown = 8e-8, []
    for number in range(3):
        run, truth = flown(30.0, 40 + number, "rotor_acceleration_torque")
        speeds = truth["rotor_rev_s"].astype(np.float64)
        rows = run.period_s / 0.005
        keep = np.exp(-rows)
        now = 1.0 - (1.0 - keep) / rows
        lagged = lfilter([now, 1.0 - keep - now], [1.0, -keep], speeds - speeds[0], axis=0)
        shown.append(dataclasses.replace(run, rotor_rev_s=speeds[0] + lagged))
    findings = find_effects(shown[:2], base_model())
    found = {effect.name: effect.parameters for effect in findings.effects}
    told = found.pop("rotor_acceleration_torque")["rotor_inertia_kg_m2"].value
    assert told == pytest.approx(true_inertia, rel=0.02)
    assert found.pop("rotor_speed_sensor")["lag_s"].value == pytest.approx(5e-3, abs=1e-3)
    assert set(found) <= {"dead_time"}
    for delay in found.values():
        assert abs(delay["delay_s"].value) < 1e-3
    (candidate,) = [one for one in findings.candidates if one.name == "rotor_speed_sensor"]
    assert candidate.accepted
