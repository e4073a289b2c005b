"""Mixer, power distribution and torque: signs, levers, limits."""

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.vehicle import BUILT_IN, MIXERS, rotor_positions_m
from support.equations import distribute, mix, output_stage, thrust_and_torque

PLUS = BUILT_IN["crazyflie1"]
X = BUILT_IN["crazyflie21"]


def test_the_mixer_is_equation_7_19():
    m1, m2, m3, m4 = speeds = np.array([201.0, 250.0, 233.0, 277.0])
    expected = [
        m4**2 - m2**2,
        m3**2 - m1**2,
        -(m1**2) + m2**2 - m3**2 + m4**2,
    ]
    np.testing.assert_allclose(mix(speeds), expected)


@pytest.mark.parametrize("vehicle", [PLUS, X], ids=["plus", "x"])
def test_a_rotor_lifts_the_side_on_which_it_is_and_its_drag_turns_the_craft_against_its_spin(
    vehicle,
):
    forward, left = np.sign(np.round(rotor_positions_m(vehicle), 9)).T
    counter_clockwise = [1, -1, 1, -1]
    rows = [left, -forward, np.negative(counter_clockwise)]
    np.testing.assert_array_equal(MIXERS[vehicle.configuration], rows)


@pytest.mark.parametrize("vehicle", [PLUS, X], ids=["plus", "x"])
def test_torque_is_force_crossed_with_the_place_of_each_rotor(vehicle):
    speeds = np.array([210.0, 260.0, 240.0, 290.0])
    thrust, torque = thrust_and_torque(speeds, vehicle)
    moments = np.zeros(3)
    for (x, y), spin, speed in zip(rotor_positions_m(vehicle), (1, -1, 1, -1), speeds, strict=True):
        moments += np.cross([x, y, 0], [0, 0, vehicle.thrust_n * speed**2])
        moments[2] -= spin * vehicle.drag_n_m * speed**2  # the air turns the body back
    np.testing.assert_allclose(torque, moments, rtol=1e-12)
    assert thrust == pytest.approx(vehicle.thrust_n * (speeds**2).sum())


@pytest.mark.parametrize("vehicle", [PLUS, X], ids=["plus", "x"])
def test_body_constants_times_the_mixer_are_the_angular_accelerations(vehicle):
    speeds = np.array([210.0, 260.0, 240.0, 290.0])
    _, torque = thrust_and_torque(speeds, vehicle)
    accelerations = np.array(vehicle.body_constants) * mix(speeds, vehicle.configuration)
    np.testing.assert_allclose(accelerations, torque / vehicle.inertia_kg_m2, rtol=1e-12)


@pytest.mark.parametrize("configuration", ["plus", "x"])
def test_a_control_acts_on_its_own_axis_with_its_own_sign(configuration):
    for axis in range(3):
        control = np.zeros(3)
        control[axis] = 100.0
        pwm = distribute(2000.0, control, configuration)
        torques = MIXERS[configuration] @ pwm
        assert torques[axis] > 0
        np.testing.assert_allclose(np.delete(torques, axis), 0, atol=1e-9)
        assert pwm.sum() == pytest.approx(8000.0)


def test_power_distribution_is_equation_8_3():
    thrust, roll, pitch, yaw = 2000.0, 100.0, 30.0, 7.0
    expected = [
        thrust - pitch - yaw,
        thrust - roll + yaw,
        thrust + pitch - yaw,
        thrust + roll + yaw,
    ]
    np.testing.assert_allclose(distribute(thrust, [roll, pitch, yaw]), expected)


def test_pwm_is_limited_to_full_duty_and_none():
    pwm = distribute(np.array([4000.0, 50.0]), np.array([[500.0, 0, 0], [500.0, 0, 0]]))
    np.testing.assert_allclose(pwm, [[4000, 3500, 4000, 4096], [50, 0, 50, 550]])


def test_the_output_stage_scales_the_supply_with_duty():
    voltage = output_stage([[4096, 2048, 0, 1024]], [3700.0])
    np.testing.assert_allclose(voltage, [[3700, 1850, 0, 925]])


def test_profiles_in_the_x_configuration_use_the_shorter_lever():
    as_plus = msgspec.structs.replace(X, configuration="plus")
    _, torque_x = thrust_and_torque([0, 0, 300.0, 300.0], X)
    _, torque_plus = thrust_and_torque([0, 0, 0, 300.0], as_plus)
    assert torque_x[0] == pytest.approx(2 * torque_plus[0] / np.sqrt(2))
