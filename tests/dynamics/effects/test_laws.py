"""The laws of turning bodies, as plain numbers: beside the vectors that they come from.

Rotors 1 and 3 turn counter-clockwise seen from above, so that their angular momentum points up.
"""

import numpy as np
import pytest

from groundstation.dynamics.effect import FAR_M, Body, Craft, Reading, rotor_wrench
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.vehicle import BUILT_IN, rotor_positions_m

INERTIA = (1.7e-5, 1.5e-5, 2.9e-5)
RATE, ROTOR, SLOPE = (0.7, -1.3, 2.1), (210.0, 260.0, 240.0, 305.0), (30.0, -20.0, 10.0, 50.0)
ROTOR_INERTIA = 5e-8
COUNTER_CLOCKWISE = np.array([1.0, -1.0, 1.0, -1.0])


def craft(profile="crazyflie1"):
    vehicle = BUILT_IN[profile]
    (x, y), four = zip(*rotor_positions_m(vehicle), strict=True), (0.0,) * 4
    return Craft(0.03, 9.81, INERTIA, vehicle.thrust_n, vehicle.drag_n_m, x, y, four, four, four,
                 2.3, four)  # fmt: skip


def torque(name, *values):
    """What an effect adds about x, y, z, N m, on a craft that turns."""
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, RATE, ROTOR, SLOPE, 0.3, (0.0,) * 3,
                (0.0,) * 3)  # fmt: skip
    angular, force = EFFECTS[name].law(values, craft(), body)
    assert force == (0.0, 0.0, 0.0)
    return np.multiply(angular, INERTIA)


def momentum(rotor):
    """Of rotors at these speeds (4,), rev/s: kg m^2/s about x, y, z."""
    return np.array([0.0, 0.0, ROTOR_INERTIA * 2 * np.pi * COUNTER_CLOCKWISE @ rotor])


def test_spinning_rotors_turn_the_craft_by_the_change_of_their_angular_momentum():
    expected = -np.cross(RATE, momentum(ROTOR))
    np.testing.assert_allclose(torque("rotor_gyroscopic_torque", ROTOR_INERTIA), expected)


def test_rotors_that_speed_up_turn_the_craft_the_other_way():
    expected = -momentum(SLOPE)
    np.testing.assert_allclose(torque("rotor_acceleration_torque", ROTOR_INERTIA), expected)


def test_a_body_of_unequal_inertias_turns_by_eulers_equations():
    expected = -np.cross(RATE, np.multiply(INERTIA, RATE))
    np.testing.assert_allclose(torque("inertia_coupling", 1.0), expected)


@pytest.mark.parametrize("profile", ["crazyflie1", "crazyflie21"])
def test_rotors_lift_where_they_are_and_their_drag_turns_the_other_way(profile):
    one = craft(profile)
    for rotor in range(4):
        alone = np.zeros(4)
        alone[rotor] = 300.0
        lift, *moments = rotor_wrench(one, alone)
        arm = np.array([one.rotor_x[rotor], one.rotor_y[rotor], 0.0])
        expected = np.cross(arm, [0.0, 0.0, lift])
        expected[2] = -COUNTER_CLOCKWISE[rotor] * one.drag * 300.0**2
        np.testing.assert_allclose(moments, expected, atol=1e-15)


@pytest.mark.parametrize(
    "name", [one.name for one in EFFECTS.values() if one.stage == "sensor" and one.states]
)
def test_what_a_listed_sensor_remembers_is_linear_so_that_rows_follow_it_exactly(name):
    effect, random = EFFECTS[name], np.random.default_rng(0)
    values = [one.default for one in effect.parameters]
    body = Body(FAR_M, (1.0, 0.0, 0.0, 0.0), (0.4, -0.2, 0.1), RATE, ROTOR, SLOPE, 0.3,
                (3.0, -2.0, 5.0), (0.3, 0.2, 9.6))  # fmt: skip

    def told(state):
        reading = Reading(RATE, (0.3, 0.2, 9.6), ROTOR)
        shown, slopes = effect.law(values, craft(), body, reading, tuple(state))
        return np.array([*shown.gyro, *shown.accelerometer, *slopes])

    one, other = random.normal(size=(2, len(effect.states)))
    none = told(np.zeros(len(effect.states)))
    assert np.abs(told(one) - none).max() > 0.1
    summed = told(one) - none + 2.0 * (told(other) - none)
    np.testing.assert_allclose(told(one + 2.0 * other) - none, summed, atol=1e-6)
