"""What sensors and the battery report do to the truth."""

import msgspec
import numpy as np
import pytest
from scipy import signal

from groundstation.dynamics.craft import craft_of_vehicle
from groundstation.dynamics.effect import Supply
from groundstation.dynamics.registry import EFFECTS
from groundstation.dynamics.rotations import rotation_matrix
from groundstation.dynamics.sensing import gyro_step
from groundstation.dynamics.sensors import sensors_of_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from support.flights import BASE, affected


def reported(volts, lag_s, period_s=0.002):
    """What a first-order lag shows of a supply voltage, settled at the first row."""
    keep = np.exp(-period_s / lag_s)
    shown, value = [], volts[0]
    for volt in volts:
        value = keep * value + (1.0 - keep) * volt
        shown.append(value)
    return np.array(shown)


def behind(report, lag_s, period_s=0.002):
    """The supply that the law finds behind a report, row by row."""
    law, still = EFFECTS["battery_reading_lag"].law, (0.0,) * 4
    pairs = zip(report, np.concatenate([report[:1], report[:-1]]), strict=True)
    rows = (Supply(now, before, period_s, still, still) for now, before in pairs)
    return np.array([law((lag_s,), None, row, row.reported) for row in rows])


def test_a_model_without_effects_has_ideal_sensors():
    sensor = sensors_of_model(BASE)[0]
    assert sensor["delay"] == 0.0
    assert not sensor["gains"].any()
    assert not sensor["zero"].any()
    np.testing.assert_array_equal(sensor["mounting"], np.eye(3))


def test_a_turned_sensor_is_undone_and_biases_are_what_it_shows_of_nothing():
    turned = affected("imu_misalignment", {"roll_deg": 3.0, "pitch_deg": -5.0, "yaw_deg": 40.0})
    biased = affected("gyro_bias", {"x_dps": 1.0, "y_dps": 2.0, "z_dps": -3.0})
    both = msgspec.structs.replace(BASE, effects=turned.effects + biased.effects)
    sensor = sensors_of_model(both)[0]
    expected = rotation_matrix(np.radians([3.0, -5.0, 40.0]))
    np.testing.assert_allclose(sensor["mounting"], expected, atol=1e-12)
    np.testing.assert_allclose(sensor["zero"][:3], np.radians([1.0, 2.0, -3.0]))


def test_the_lag_of_a_report_is_undone_exactly():
    volts = 3700 + 100 * np.sign(np.sin(np.arange(2000) / 50))
    report = reported(volts, 0.155)
    assert np.abs(report - volts).max() > 50
    np.testing.assert_allclose(behind(report, 0.155), volts, atol=1e-6)


def test_a_reports_resolution_does_not_blow_up_what_the_motors_feel():
    """1 mV steps give noise row by row, which a motor's 0.1 s average away."""
    volts = 3700 + 60 * np.sin(np.arange(5000) / 200)
    error = behind(np.round(reported(volts, 0.4)), 0.4) - volts
    felt = np.convolve(error, np.full(50, 0.02), "valid")
    assert error.std() > 20
    assert felt[200:].std() < 3


def test_what_is_reckoned_back_stays_near_the_report():
    found = behind(np.r_[np.full(100, 3700.0), np.full(100, 3000.0)], 1.0)
    assert found.min() >= 0.75 * 3000
    assert found.max() <= 1.25 * 3700


@pytest.mark.parametrize("name", ["dead_time", "gyro_low_pass"])
def test_a_negative_delay_or_bandwidth_is_refused(name):
    (term,) = affected(name).effects
    (key,) = term.parameters
    model = affected(name, {key: -1.0})
    with pytest.raises(BadInputError, match="must not be negative"):
        sensors_of_model(model)


def test_dead_times_add_up():
    one = affected("dead_time", {"delay_s": 0.002}).effects
    both = msgspec.structs.replace(BASE, effects=one + one)
    assert sensors_of_model(both)[0]["delay"] == pytest.approx(0.004)


def test_a_lag_of_the_gyro_is_followed_through_a_jump_as_its_exponential_says():
    period_s, bandwidth_hz = 0.002, 172.0
    craft = craft_of_vehicle(
        load_vehicle("crazyflie1"), {"gyro_low_pass": {"bandwidth_hz": bandwidth_hz}}
    )
    shown = np.empty(10)
    gyro_step(craft[0], period_s, shown)
    time_s = period_s * np.arange(1, len(shown) + 1)
    np.testing.assert_allclose(
        shown, 1.0 - np.exp(-2.0 * np.pi * bandwidth_hz * time_s), atol=1e-12
    )


def test_a_filter_that_is_far_faster_than_a_row_hides_nothing():
    for effect, size in (
        ("gyro_low_pass", {"bandwidth_hz": 6e4}),
        ("gyro_filter", {"corner_hz": 9e4}),
    ):
        craft, shown = craft_of_vehicle(load_vehicle("crazyflie21"), {effect: size}), np.empty(3)
        gyro_step(craft[0], 0.002, shown)
        np.testing.assert_allclose(shown, 1.0, atol=1e-6)


def test_filters_behind_one_another_answer_a_jump_as_transfer_functions_in_series_do():
    period_s, bandwidth_hz, corner_hz = 0.004, 60.0, 80.0
    effects = {
        "gyro_low_pass": {"bandwidth_hz": bandwidth_hz},
        "gyro_filter": {"corner_hz": corner_hz},
        "accelerometer_filter": {"corner_hz": 30.0},
        "position_aided_lean": {"strength": 1.0, "time_s": 0.4},
    }
    craft = craft_of_vehicle(load_vehicle("crazyflie21"), effects)
    shown = np.empty(12)
    gyro_step(craft[0], period_s, shown)
    one, two = 2.0 * np.pi * bandwidth_hz, 2.0 * np.pi * corner_hz
    below = np.polymul([1.0, one], [1.0, np.sqrt(2.0) * two, two**2])
    time_s = period_s * np.arange(len(shown) + 1)
    _, expected = signal.step(([one * two**2], below), T=time_s)
    np.testing.assert_allclose(shown, expected[1:], atol=1e-9)
