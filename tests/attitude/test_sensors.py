"""Angles from the accelerometer and from the gyro, each by itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from groundstation.attitude.fusion import accelerometer_attitude, integrate_gyroscope, rest_bias


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_gravity_shows_roll_and_pitch_whatever_the_yaw(roll, pitch, yaw):
    force = Rotation.from_euler("ZYX", [yaw, pitch, roll]).inv().apply([0, 0, 9.80665])
    np.testing.assert_allclose(accelerometer_attitude(force), [roll, pitch], atol=1e-9)


def turning(seconds, rate_hz=500):
    """Times, body rates and exact attitudes of a smooth tumbling motion."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    angles = np.column_stack(
        [0.8 * np.sin(2 * time), 0.5 * np.sin(3 * time + 1) - 0.42, np.sin(1.3 * time)]
    )
    fine = Rotation.from_euler("ZYX", angles[:, ::-1])
    steps = (fine[:-1].inv() * fine[1:]).as_rotvec() * rate_hz
    return time, np.vstack([steps[:1], steps]), angles


def test_integrated_rates_follow_the_motion():
    time, rates, angles = turning(10)
    found = integrate_gyroscope(time, rates, angles[0])
    assert np.degrees(np.abs(found - angles).max()) < 0.02


def test_doubling_the_rate_divides_the_error_of_integration_by_four():
    errors = []
    for rate_hz in (125, 250, 500):
        time, rates, angles = turning(4, rate_hz)
        errors.append(np.abs(integrate_gyroscope(time, rates, angles[0]) - angles).max())
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 4, rtol=0.3)


def test_a_lost_row_is_bridged_by_time():
    time = np.array([0, 0.002, 0.004, 0.010, 0.012])
    rates = np.tile([0.0, 0.0, 1.0], (5, 1))
    np.testing.assert_allclose(integrate_gyroscope(time, rates)[:, 2], time)


def test_the_bias_is_the_mean_of_what_lies_still_at_the_start():
    generator = np.random.default_rng(0)
    time = np.arange(3000) * 0.002
    gyro = generator.normal([0.02, -0.01, 0.03], 0.002, (3000, 3))
    gyro[1500:] += 2 * np.sin(6 * time[1500:, None])
    np.testing.assert_allclose(rest_bias(time, gyro), [0.02, -0.01, 0.03], atol=3e-4)


def test_a_craft_that_never_lies_still_has_no_rest_bias():
    time, rates, _ = turning(4)
    assert rest_bias(time, rates) is None


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="need"):
        integrate_gyroscope(np.arange(5.0), np.zeros((4, 3)))
