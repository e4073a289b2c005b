"""Each rotor's motor from flights, against motors that are known."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import load_model, save_model, vehicle_model
from groundstation.dynamics.sensors import lagged
from groundstation.dynamics.simulation import armature_mv, simulate_motor
from groundstation.dynamics.vehicle import BUILT_IN, MotorConstants, mean_motor
from groundstation.errors import BadInputError
from groundstation.identification.motor.rotors import (
    constants_of,
    fit_rotors,
    rotor_runs,
    shape_of,
    towards_mean,
)
from groundstation.identification.motor.workflow import identify_motor
from groundstation.identification.runs import Run

VEHICLE = BUILT_IN["crazyflie21"]
BEFORE = vehicle_model(VEHICLE)
LAG_S = 0.004
SPEED = 320.0
HOLDING_MV = (2600.0, 2500.0, 2550.0, 2450.0)
SLOW_S = 0.07
FOUR = tuple(constants_of(np.array([np.log(mv), np.log(SLOW_S), 0.2]), SPEED) for mv in HOLDING_MV)


def flight(name, seed, motors=FOUR, seconds=10.0, motion=0.03, band_s=0.2, chatter=0.0, share=0.0):
    """A flight whose motors drift, with sensors that lag, hold one row in five and are noisy.

    chatter: by how much every second and fifth row's duty swings, more and less within a second.
    share: of a braking current that does not flow.
    """
    generator = np.random.default_rng(seed)
    rows = round(seconds / 0.002)
    # Commands as a controller gives them: little below 1 / (2 pi band_s), by default 0.8 Hz.
    command = np.cumsum(generator.normal(0, 1.0, (rows, 4)), axis=0)
    command -= lagged(command, band_s, 0.002)
    duty = 0.7 + motion * command / command.std()
    row = np.arange(rows)
    swing = chatter * (1.0 + 0.5 * np.sin(2.0 * np.pi * 0.002 * row * 0.9 + seed))
    kick = np.where(row % 5 == 0, -0.8, 0.2) + np.where(row % 2 == 0, 0.2, -0.2)
    duty += swing[:, None] * kick[:, None] * [1, -1, 1, -1]
    supply = 3.6 - 0.02 * np.arange(rows) * 0.002 / 10
    walk = np.cumsum(generator.normal(0, 1.0, (rows, 4)), axis=0)
    loss = 1.0 + 0.01 * (0.3 * walk / np.abs(walk).max() + generator.normal())
    volts = (armature_mv(duty, supply) * loss)[1:]
    effects = {"motor_coasting": {"share": share}}
    true, _ = simulate_motor(motors, volts, 0.002, effects=effects)
    shown = lagged(true, LAG_S, 0.002) + generator.normal(0, 0.3, (rows, 4))
    held = generator.random((rows, 4)) < 0.2
    for row in range(1, rows):
        shown[row, held[row]] = shown[row - 1, held[row]]
    empty = np.full((rows, 3), np.nan)
    one = np.full((rows, 4), np.nan)
    return Run(name, 0.0, 0.002, duty, supply, empty, empty, empty, shown, np.zeros(rows), one)


@pytest.fixture(scope="module")
def flights():
    return [flight(f"flight{seed}", seed) for seed in range(4)]


def with_sensors(run, change):
    shown = run.rotor_rev_s.copy()
    change(shown)
    return replace(run, rotor_rev_s=shown)


def test_each_rotor_is_found_within_its_uncertainty(flights):
    runs, left_out = rotor_runs(flights)
    fit = fit_rotors(runs, VEHICLE.motor)
    assert left_out == []
    assert fit.lag_s == pytest.approx(LAG_S, abs=3 * fit.estimates.stderr[3])
    true = np.array([shape_of(motor, fit.speed_rev_s) for motor in FOUR])
    assert np.abs((fit.shape - true) / fit.stderr).max() < 4.0
    assert fit.stderr[:, 1].max() < 0.05
    order = np.argsort([motor.a0 for motor in fit.motors])
    assert order.tolist() == np.argsort([motor.a0 for motor in FOUR]).tolist()
    assert fit.spread[0] > 0.015
    mean = mean_motor(fit.motors)
    np.testing.assert_allclose(fit.estimates.values[:3], [mean.a0, mean.a1, mean.a2], rtol=1e-9)


def test_what_does_not_differ_is_shared(flights):
    """The time constants and the load's shape are one; what holds the speed is each rotor's."""
    fit = fit_rotors(rotor_runs(flights)[0], VEHICLE.motor)
    slow = np.exp(fit.shape[:, 1])
    assert np.ptp(slow) < 0.02 * SLOW_S
    alike = [flight(f"flight{seed}", 10 + seed, (FOUR[0],) * 4) for seed in range(3)]
    same = fit_rotors(rotor_runs(alike)[0], VEHICLE.motor)
    assert np.ptp(same.shape[:, 0]) < 3 * same.stderr[:, 0].max()
    assert np.ptp(same.shape[:, 0]) < 0.01


def test_a_mean_of_rotors_has_no_negative_share_of_quadratic_load():
    """Where T and s go together and one rotor knows them far better, the mean lies beyond both."""
    values = np.array([[7.8, -2.39, 0.01], [7.8, -2.4, 0.0], [7.8, -2.39, 0.0], [7.8, -2.4, 0.0]])
    tied = np.diag([1e-4, 1e-4, 1e-3])
    tied[1, 2] = tied[2, 1] = 0.99 * np.sqrt(tied[1, 1] * tied[2, 2])
    loose = np.diag([1e-4, 1e-5, 1e-3])
    drawn, left, _ = towards_mean(values, np.array([tied, loose, tied, loose]))
    assert drawn[:, 2] == pytest.approx(0.0, abs=1e-12)
    assert (drawn[:, 2] >= 0.0).all()
    assert all(constants_of(row, SPEED).a2 >= 0.0 for row in drawn)
    assert (np.linalg.eigvalsh(left) > 0.0).all()


def test_the_model_file_has_four_motors_and_the_account_their_spread(flights, tmp_path):
    found = identify_motor(flights, [], BEFORE, VEHICLE)
    model = found.documented()
    save_model(model, tmp_path / "motor.json")
    assert load_model(tmp_path / "motor.json").motors == model.motors
    assert mean_motor(model.motors) == model.motor
    (sensor,) = model.effects
    assert sensor.name == "rotor_speed_sensor"
    lag = sensor.parameters["lag_s"]
    assert lag.value == pytest.approx(LAG_S, abs=3 * lag.stderr)
    assert [one["rotor"] for one in found.account["rotors"]] == [1, 2, 3, 4]
    assert any("they differ by 6." in line for line in found.account["findings"])
    assert found.account["warnings"] == []
    assert max(one["rotor_rms_rev_s"] for one in found.account["validation"]) < 0.03 * SPEED


def test_a_dead_sensor_is_left_out_by_name(flights):
    def dead(shown):
        shown[:, 0] = 0.0

    found = identify_motor([with_sensors(one, dead) for one in flights], [], BEFORE, VEHICLE)
    assert (
        "rotor 1: its sensor shows a rotor that stands in 100 % of the rows of flight0: left out"
        in found.account["warnings"]
    )
    first, *others = found.model.motors
    assert first.a0 == pytest.approx(np.mean([one.a0 for one in others]), rel=0.01)
    assert "M1 is taken as the mean of the others" in found.account["findings"]


@pytest.mark.parametrize(
    ("rotor", "shows", "text"),
    [
        (2, lambda speed: np.full_like(speed, np.nan), "rotor 3: its sensor shows nothing"),
        (1, lambda speed: np.full_like(speed, 317.5), "rotor 2: its sensor repeats"),
        (3, lambda speed: 0.5 * speed, r"rotor 4: its sensor shows 0.5\d of what the others show"),
    ],
    ids=["nothing", "stuck", "every second blade"],
)
def test_a_sensor_that_fails_in_one_flight_counts_in_the_others(flights, rotor, shows, text):
    def change(speeds):
        speeds[:, rotor] = shows(speeds[:, rotor])

    runs, left_out = rotor_runs([with_sensors(flights[0], change), *flights[1:]])
    assert len(left_out) == 1
    assert re.search(text, left_out[0])
    assert [run is None for run in runs[0]].index(True) == rotor
    fit = fit_rotors(runs, VEHICLE.motor)
    assert fit.told.all()


def test_glitches_of_a_sensor_do_not_count(flights):
    def glitch(shown):
        shown[::50] *= 2.0

    clean = fit_rotors(rotor_runs(flights)[0], VEHICLE.motor)
    noisy = fit_rotors(rotor_runs([with_sensors(one, glitch) for one in flights])[0], VEHICLE.motor)
    assert np.abs((noisy.shape - clean.shape) / clean.stderr).max() < 1.5


COASTING = "motor_coasting.share"


def test_motors_that_coast_are_found_with_their_constants():
    flights = [flight(f"flight{seed}", seed, chatter=0.35, share=0.7) for seed in range(4)]
    found = identify_motor(flights, [], BEFORE, VEHICLE)
    estimates = found.account["estimates"]
    place = estimates["names"].index(COASTING)
    assert abs(estimates["values"][place] - 0.7) < 4 * estimates["stderr"][place]
    assert estimates["stderr"][place] < 0.1
    held = [one["rotor_rms_rev_s"] for one in found.account["validation"]]
    assert max(held) < 0.03 * SPEED
    np.testing.assert_allclose(
        [one.a0 for one in found.model.motors], [one.a0 for one in FOUR], rtol=0.06
    )
    term = found.model.effects[0]
    assert term.name == "motor_coasting"
    again = identify_motor(flights, [], found.model, VEHICLE)
    assert again.account["estimates"]["values"] == pytest.approx(estimates["values"], rel=1e-3)
    calm = identify_motor([flight("calm", 9)], [], found.model, VEHICLE)
    assert term in calm.model.effects


@pytest.mark.parametrize(
    ("chatter", "said"),
    [(0.0, "not identified, because only 0 % of the voltages"), (0.35, "none is told")],
    ids=["never below the back EMF", "braked"],
)
def test_motors_that_do_not_coast_are_told_so(chatter, said):
    flights = [flight(f"flight{seed}", seed, chatter=chatter) for seed in range(3)]
    found = identify_motor(flights, [], BEFORE, VEHICLE)
    assert said in found.account["findings"][-1]
    assert COASTING not in found.account["estimates"]["names"]
    assert [term.name for term in found.model.effects] == ["rotor_speed_sensor"]


def test_swapped_sensors_are_told_as_that(flights):
    def swap(shown):
        shown[:, [1, 2]] = shown[:, [2, 1]]

    swapped = [with_sensors(one, swap) for one in flights]
    with pytest.raises(BadInputError, match="rotor 2 with motor 3's, rotor 3 with motor 2's PWM"):
        identify_motor(swapped, [], BEFORE, VEHICLE)


def test_a_load_s_shape_that_the_flight_does_not_tell_stays_near_the_given_one():
    calm = flight("calm", 3, motion=0.0003, band_s=0.002, seconds=3.0)
    fit = fit_rotors(rotor_runs([calm])[0], VEHICLE.motor)
    assert not fit.s_from_data
    given = shape_of(VEHICLE.motor, fit.speed_rev_s)[2]
    assert np.abs(fit.shape[:, 2] - given).max() < 0.15
    assert all(motor.a1 > 0 and motor.a2 >= 0 for motor in fit.motors)


def test_a_hover_tells_no_time_constant():
    calm = [flight("hover", 1, motion=1e-5)]
    with pytest.raises(BadInputError, match="time constant is not identified, because the thrust"):
        identify_motor(calm, [], BEFORE, VEHICLE)


def test_a_motor_of_first_order_is_a_motor():
    first = tuple(msgspec.structs.replace(one, a2=0.0) for one in FOUR)
    found = identify_motor([flight(f"f{i}", i, first) for i in range(2)], [], BEFORE, VEHICLE)
    share = found.account["rotors"][0]
    assert share["quadratic_share"] < 4 * share["quadratic_share_stderr"]
    assert all(motor.a2 >= 0 for motor in found.model.motors)


@pytest.mark.parametrize("motor", [FOUR[0], MotorConstants(2.0, 9.0, 0.0)])
def test_constants_and_what_flights_tell_of_them_are_the_same_motor(motor):
    again = constants_of(shape_of(motor, SPEED), SPEED)
    assert again.steady_rev_s(2500.0) == pytest.approx(motor.steady_rev_s(2500.0))
    assert (again.a0, again.a1, again.a2) == pytest.approx((motor.a0, motor.a1, motor.a2))
