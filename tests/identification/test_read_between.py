"""Channels whose rows are means of two readings, half a row before and after (a radio's log)."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from groundstation.identification.flight import (
    angles_read_between,
    force_read_between,
    half_a_row_later,
    mean_between,
)

ROWS_HZ = 250.0
COUNT = 20_000


@pytest.fixture(scope="module")
def motion():
    """(2 n, 3): what is there, twice a row, behind the firmware's low-pass of 80 Hz."""
    draw = np.random.default_rng(3).standard_normal((2 * COUNT, 3))
    return lfilter(*butter(2, 80.0, fs=2.0 * ROWS_HZ), draw, axis=0)


def readings(values, seed=4, noise=0.1):
    """The same with noise that each reading has anew."""
    return values + noise * np.random.default_rng(seed).standard_normal(values.shape)


def at_rows(values):
    return values[2::2]


def between(values):
    """At the same rows, from the readings half a row before and half a row after."""
    return 0.5 * (values[1:-1:2] + values[3::2])


def test_a_model_is_averaged_as_readings_between_rows_are(motion):
    modelled = mean_between(at_rows(motion))
    wrong, plain = (between(motion) - one for one in (modelled, at_rows(motion)))
    assert np.std(wrong) < 0.5 * np.std(plain)


def test_between_two_rows_a_smooth_motion_is_known():
    turns = 20.0 / ROWS_HZ * np.linspace(np.arange(200), np.arange(200) + 0.6, 3, axis=1)
    later = np.sin(2.0 * np.pi * (turns + 10.0 / ROWS_HZ))
    assert half_a_row_later(np.sin(2.0 * np.pi * turns))[2:-2] == pytest.approx(
        later[2:-2], abs=0.01
    )


def test_forces_read_between_rows_are_seen_to_be(motion):
    assert force_read_between(between(readings(motion)))
    assert not force_read_between(at_rows(readings(motion)))


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_angles_read_between_rows_are_seen_to_be_with_noise_of_their_own_and_without(motion, noise):
    angles = readings(np.cumsum(motion, axis=0), noise=noise)
    gyro = at_rows(motion)[1:]
    assert angles_read_between(np.diff(between(angles), axis=0), gyro)
    assert not angles_read_between(np.diff(at_rows(angles), axis=0), gyro)


def test_a_channel_that_never_changes_tells_nothing():
    assert not force_read_between(np.ones((COUNT, 3)))


@pytest.mark.filterwarnings("error")
def test_few_rows_are_judged_without_a_warning_of_scipy(motion):
    few = at_rows(motion)[:100]
    assert not angles_read_between(few, few)
