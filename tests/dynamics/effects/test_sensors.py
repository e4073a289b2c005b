"""What sensors and the battery report do to the truth."""

import msgspec
import numpy as np
import pytest
from affected_flights import BASE, affected

from groundstation.dynamics.effects.sensors import (
    reading_lag_s,
    reported_supply,
    sensors_of_model,
    supply_behind,
)
from groundstation.errors import BadInputError


def test_a_model_without_effects_has_ideal_sensors():
    sensor = sensors_of_model(BASE)[0]
    assert sensor["delay"] == sensor["gyro_lag"] == sensor["lean"] == 0.0
    np.testing.assert_array_equal(sensor["mounting"], np.eye(3))
    assert reading_lag_s(BASE) == 0.0


def test_the_lag_of_a_report_is_undone_exactly():
    volts = 3700 + 100 * np.sign(np.sin(np.arange(2000) / 50))
    reported = reported_supply(volts, 0.155, 0.002)
    assert np.abs(reported - volts).max() > 50
    np.testing.assert_allclose(supply_behind(reported, 0.155, 0.002), volts, atol=1e-6)


def test_a_reports_resolution_does_not_blow_up_what_the_motors_feel():
    """1 mV steps give noise row by row, which a motor's 0.1 s average away."""
    volts = 3700 + 60 * np.sin(np.arange(5000) / 200)
    reported = np.round(reported_supply(volts, 0.4, 0.002))
    error = supply_behind(reported, 0.4, 0.002) - volts
    felt = np.convolve(error, np.full(50, 0.02), "valid")
    assert error.std() > 20
    assert felt[200:].std() < 3


def test_what_is_reckoned_back_stays_near_the_report():
    reported = np.r_[np.full(100, 3700.0), np.full(100, 3000.0)]
    behind = supply_behind(reported, 1.0, 0.002)
    assert behind.min() >= 0.75 * 3000
    assert behind.max() <= 1.25 * 3700


def test_without_a_lag_the_report_is_the_voltage():
    volts = np.array([3.7, 3.6])
    np.testing.assert_array_equal(supply_behind(volts, 0.0, 0.002), volts)


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
