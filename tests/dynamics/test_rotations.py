"""Rotations and rate transforms, against scipy and against finite differences."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from groundstation.dynamics.rotations import (
    attitude_of_matrix,
    attitude_of_quaternion,
    body_rates,
    euler_rates,
    matrix_of_quaternion,
    quaternion_of_attitude,
    rates_matrix,
    rotation_matrix,
)

angle = st.floats(-3.1, 3.1)
pitch = st.floats(-1.5, 1.5)
attitudes = st.tuples(angle, pitch, angle)
rates = st.tuples(*[st.floats(-20, 20)] * 3)


def reference(attitude):
    roll, pitch, yaw = attitude
    return Rotation.from_euler("ZYX", [yaw, pitch, roll])


@given(attitudes)
def test_the_rotation_is_intrinsic_zyx(attitude):
    np.testing.assert_allclose(
        rotation_matrix(attitude), reference(attitude).as_matrix(), atol=1e-14
    )


@given(attitudes)
def test_quaternion_and_matrix_are_the_same_rotation(attitude):
    quaternion = quaternion_of_attitude(attitude)
    np.testing.assert_allclose(
        matrix_of_quaternion(quaternion), rotation_matrix(attitude), atol=1e-14
    )


@given(attitudes)
def test_angles_survive_the_way_through_matrix_and_quaternion(attitude):
    np.testing.assert_allclose(attitude_of_matrix(rotation_matrix(attitude)), attitude, atol=1e-9)
    np.testing.assert_allclose(
        attitude_of_quaternion(quaternion_of_attitude(attitude)), attitude, atol=1e-9
    )


@example((0.5, 0.4, 0.3), (1.0, 2.0, 3.0))
@given(attitudes, rates)
def test_euler_rates_invert_body_rates(attitude, rate):
    back = body_rates(attitude, euler_rates(attitude, rate))
    np.testing.assert_allclose(back, rate, atol=1e-9)


@given(attitudes, rates)
def test_body_rates_are_those_that_turn_the_matrix(attitude, rate):
    """R' = R [Omega x]: the definition of the body rates, by central differences."""
    speeds = euler_rates(attitude, rate)
    step = 1e-6 / (1.0 + np.abs(speeds).max())
    ahead = rotation_matrix(np.add(attitude, step * speeds))
    behind = rotation_matrix(np.subtract(attitude, step * speeds))
    skew = rotation_matrix(attitude).T @ (ahead - behind) / (2 * step)
    found = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    np.testing.assert_allclose(found, rate, atol=1e-5 * (1.0 + np.abs(speeds).max()))


def test_nose_down_is_a_positive_pitch_and_left_up_a_positive_roll():
    forward, left = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    assert (rotation_matrix([0, 0.3, 0]) @ forward)[2] < 0
    assert (rotation_matrix([0.3, 0, 0]) @ left)[2] > 0
    assert (rotation_matrix([0, 0, 0.3]) @ forward)[1] > 0


def test_many_attitudes_at_once_give_what_each_gives_alone():
    generator = np.random.default_rng(1)
    many = generator.uniform(-1, 1, (4, 5, 3))
    for function in (rotation_matrix, rates_matrix, quaternion_of_attitude):
        together = function(many)
        np.testing.assert_array_equal(together[2, 3], function(many[2, 3]))
