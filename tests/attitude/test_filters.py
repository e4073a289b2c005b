"""Complementary and Kalman filter on the stand-in turned by hand (thesis 6.2)."""

import numpy as np
import pytest

from groundstation.attitude.fusion import (
    KalmanNoise,
    accelerometer_attitude,
    complementary,
    integrate_gyroscope,
    kalman,
    rest_bias,
)
from groundstation.dynamics.rotations import attitude_of_quaternion
from groundstation.telemetry.samples import empty_samples
from support.flights import recorded, truth_of

BIAS_DPS = (1.5, -1.2, 0.8)


@pytest.fixture(scope="module")
def by_hand():
    """Picked up, turned about every axis, put back; a gyro with an offset."""
    samples, truth = recorded(
        30.0, program="hand_rotation", seed=4, sensor={"gyro_bias_dps": BIAS_DPS}
    )
    return samples, attitude_of_quaternion(truth_of(samples, truth)["quaternion"])


def ends_apart(attitude):
    """Degrees between the first and the last second."""
    return np.degrees(np.abs(attitude[-500:].mean(axis=0) - attitude[:500].mean(axis=0)))


def rms_deg(attitude, truth):
    return np.degrees(np.sqrt(np.square(attitude - truth).mean(axis=0)))


def test_the_kalman_filter_ends_where_it_started_while_integration_drifts(by_hand):
    samples, _ = by_hand
    fused = kalman(samples.time_s, samples.gyro, samples.accelerometer).attitude
    integrated = integrate_gyroscope(samples.time_s, samples.gyro)
    assert ends_apart(fused)[:2].max() < 1.0
    assert ends_apart(integrated)[:2].min() > 20.0


def test_the_kalman_filter_follows_the_true_attitude(by_hand):
    samples, truth = by_hand
    fused = kalman(samples.time_s, samples.gyro, samples.accelerometer).attitude
    assert rms_deg(fused, truth)[:2].max() < 0.3


def test_the_kalman_filter_finds_the_offset_of_the_gyro_but_never_that_of_yaw(by_hand):
    samples, _ = by_hand
    bias = np.degrees(kalman(samples.time_s, samples.gyro, samples.accelerometer).bias)
    np.testing.assert_allclose(bias[-1, :2], BIAS_DPS[:2], atol=0.1)
    assert np.all(bias[:, 2] == 0)


def test_yaw_stays_too_once_the_offset_at_rest_is_subtracted(by_hand):
    samples, truth = by_hand
    gyro = samples.gyro - rest_bias(samples.time_s, samples.gyro)
    fused = kalman(samples.time_s, gyro, samples.accelerometer).attitude
    raw = kalman(samples.time_s, samples.gyro, samples.accelerometer).attitude
    assert ends_apart(fused)[2] < 1.0 < 10.0 < ends_apart(raw)[2]
    assert rms_deg(fused, truth).max() < 0.5


def test_the_complementary_filter_bounds_the_drift_but_keeps_an_offset(by_hand):
    """Its stationary error is bias x time constant: W dt / (1 - W) = 1 s here."""
    samples, truth = by_hand
    fused = complementary(samples.time_s, samples.gyro, samples.accelerometer)
    standing = np.degrees((fused - truth)[-500:, :2].mean(axis=0))
    np.testing.assert_allclose(standing, np.array(BIAS_DPS[:2]) * 0.998 * 0.002 / 0.002, rtol=0.1)


def test_a_weight_of_one_is_plain_integration_and_of_zero_the_accelerometer(by_hand):
    samples, _ = by_hand
    inputs = samples.time_s, samples.gyro, samples.accelerometer
    start = complementary(*inputs)[0]
    gyro_only = complementary(*inputs, weight=1.0)
    reference = integrate_gyroscope(samples.time_s, samples.gyro, start)
    assert np.degrees(np.abs(gyro_only - reference)).max() < 0.5
    accelerometer_only = complementary(*inputs, weight=0.0)[1:, :2]
    np.testing.assert_allclose(
        accelerometer_only, accelerometer_attitude(samples.accelerometer)[1:], atol=1e-6
    )


def textbook_kalman(time, rate, angle, noise):
    """Eq. 6.11-6.20 for one axis with matrices, as printed."""
    state = np.array([angle[0], 0.0])
    covariance = np.array([[noise.accelerometer, 0.0], [0.0, 0.0]])
    q = np.diag([noise.angle, noise.bias])
    output = np.array([[1.0, 0.0]])
    found = [state.copy()]
    for k in range(1, len(time)):
        period = time[k] - time[k - 1]
        a, b = np.array([[1, -period], [0, 1]]), np.array([period, 0])
        state = a @ state + b * rate[k]
        covariance = a @ covariance @ a.T + q
        gain = covariance @ output.T / (output @ covariance @ output.T + noise.accelerometer)
        state = state + gain[:, 0] * (angle[k] - state[0])
        covariance = (np.eye(2) - gain @ output) @ covariance
        found.append(state.copy())
    return np.array(found)


def test_one_axis_is_the_printed_filter_whatever_the_unit():
    """About roll alone Euler and body rates agree: degrees in the textbook, radians inside."""
    generator = np.random.default_rng(2)
    time = np.cumsum(generator.uniform(0.001, 0.003, 2000))
    roll = 0.6 * np.sin(2 * time)
    rate = 1.2 * np.cos(2 * time) + 0.05
    force = np.column_stack([np.zeros(2000), np.sin(roll), np.cos(roll)])
    force[:, 1] += generator.normal(0, 0.1, 2000)
    force[:25] = force[0]  # the first angle is then the first row's, as in the textbook
    gyro = np.column_stack([rate, np.zeros(2000), np.zeros(2000)])
    noise = KalmanNoise(angle=0.002, bias=0.0005, accelerometer=3.0)
    found = kalman(time, gyro, force, noise)
    angle_deg = np.degrees(accelerometer_attitude(force)[:, 0])
    expected = textbook_kalman(time, np.degrees(rate), angle_deg, noise)
    np.testing.assert_allclose(np.degrees(found.attitude[:, 0]), expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(np.degrees(found.bias[:, 0]), expected[:, 1], atol=1e-9)


def test_a_craft_on_its_back_does_not_turn_round_at_the_wrap_of_roll():
    generator = np.random.default_rng(5)
    time = np.arange(1000) * 0.002
    force = np.tile([0.0, 0.0, -1.0], (1000, 1)) + generator.normal(0, 0.05, (1000, 3))
    fused = kalman(time, np.zeros((1000, 3)), force).attitude
    away = np.abs(np.abs(fused[:, 0]) - np.pi)
    assert np.degrees(away.max()) < 5


@pytest.mark.parametrize("weight", [-0.1, 1.1])
def test_a_weight_outside_zero_to_one_is_refused(weight):
    with pytest.raises(ValueError, match="outside"):
        complementary(np.arange(5.0), np.zeros((5, 3)), np.ones((5, 3)), weight)


def test_shapes_that_do_not_fit_are_refused():
    one = empty_samples(1)
    with pytest.raises(ValueError, match="two rows"):
        kalman(one.time_s, one.gyro, one.accelerometer)
    with pytest.raises(ValueError, match="need"):
        kalman(np.arange(4.0), np.zeros((4, 3)), np.ones((3, 3)))
