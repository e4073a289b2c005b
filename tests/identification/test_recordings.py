"""What a recording becomes for the search: even rows, what does not read as NaN."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.errors import BadInputError
from groundstation.identification.runs import (
    TooShortError,
    flights_of,
    flights_of_each,
    runs_of,
    without_gaps,
)
from support.flights import recorded


@pytest.fixture(scope="module")
def samples():
    return recorded(20.0, seed=5, plant="reduced")[0]


def changed(samples, column, rows, value):
    values = getattr(samples, column).copy()
    values[rows] = value
    return replace(samples, **{column: values})


def test_a_whole_flight_is_one_run_as_it_was_recorded(samples):
    (run,) = flights_of(samples)
    assert len(run) == len(samples)
    np.testing.assert_array_equal(run.gyro, samples.gyro)
    assert run.recording_start_s == run.start_s == samples.time_s[0]


def test_a_recording_in_which_nothing_lasts_is_left_out_where_another_does(samples):
    (found, none), left_out = flights_of_each([(samples, "long"), (samples[:1000], "short")])
    assert [len(run) for run in found] == [len(samples)]
    assert none == []
    (why,) = left_out
    assert why.startswith("left out: short: the longest uninterrupted stretch lasts")
    with pytest.raises(TooShortError, match="short"):
        flights_of_each([(samples[:1000], "short")])


def test_a_row_whose_gyro_does_not_read_is_lost_and_bridged(samples):
    (run,) = flights_of(changed(samples, "gyro", slice(4000, 9000, 50), np.nan))
    assert np.flatnonzero(np.isnan(run.duty[:, 0])).tolist() == list(range(4000, 9000, 50))
    assert np.isfinite(without_gaps(run).gyro).all()


def test_a_gyro_that_is_gone_for_long_ends_the_run(samples):
    one, other = flights_of(changed(samples, "gyro", slice(4000, 4100), np.nan))
    assert (len(one), len(other)) == (4000, len(samples) - 4100)
    assert other.recording_start_s == one.start_s < other.start_s


def test_rows_with_a_motor_beyond_full_duty_are_lost(samples):
    beyond = samples.duty[:, 1] + np.linspace(0.0, 1000.0, len(samples)).clip(500.0) - 500.0
    wrong = changed(samples, "duty", (slice(None), 1), beyond)
    (run,) = flights_of(wrong)
    (strict,) = runs_of(wrong)
    assert len(run) == len(strict) == np.argmax(wrong.overdriven)
    assert run.duty.max() <= 1.001


def test_a_run_counts_its_seconds_from_the_recordings_first_row_though_that_be_lost(samples):
    wrong = changed(samples, "duty", (slice(0, 500), 0), 3.0)
    for (run,) in (runs_of(wrong), flights_of(wrong)):
        assert run.recording_start_s == samples.time_s[0]
        assert run.start_s == samples.time_s[500]


@pytest.mark.parametrize("read", [runs_of, flights_of])
def test_a_duty_in_another_unit_is_told(samples, read):
    with pytest.raises(BadInputError, match="where 1 is all a motor can be given"):
        read(replace(samples, duty=100.0 * samples.duty))


def test_what_is_not_finite_does_not_read(samples):
    (run,) = flights_of(changed(samples, "accelerometer", (6000, 2), np.inf))
    assert np.isnan(run.accelerometer[6000, 2])
    assert np.isfinite(np.delete(run.accelerometer[:, 2], 6000)).all()


def test_angles_do_not_jump_by_a_turn_where_some_rows_do_not_read(samples):
    turning = samples.attitude.copy()
    ramp = 0.002 * np.arange(len(samples)) + 0.5
    turning[:, 2] = np.mod(ramp + np.pi, 2 * np.pi) - np.pi
    turned = changed(replace(samples, attitude=turning), "attitude", slice(3000, 3010), np.nan)
    (run,) = flights_of(turned)
    shown = np.isfinite(run.attitude[:, 2])
    assert shown.sum() == len(samples) - 10
    np.testing.assert_allclose(run.attitude[shown, 2], ramp[shown], atol=1e-6)


def test_a_recording_of_another_kind_of_rate_is_refused(samples):
    with pytest.raises(BadInputError, match="50 to 2000 samples a second are needed"):
        flights_of(samples[::20])
