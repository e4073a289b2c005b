"""Runs: a gap, a restart or another rate is never read as motion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.errors import BadInputError
from groundstation.identification.flight import turning
from groundstation.identification.runs import (
    TooShortError,
    flights_of,
    flights_of_each,
    runs_of,
    without_gaps,
)
from groundstation.telemetry.samples import empty_samples
from groundstation.twin.signals import Rows
from support.flights import recorded


def samples_at(ticks, segment=0):
    samples = empty_samples(len(ticks), tick_s=1e-6)
    return replace(
        samples,
        ticks=np.asarray(ticks, np.int64),
        segment=np.broadcast_to(np.int32(segment), len(ticks)).copy(),
        duty=np.full((len(ticks), 4), 0.5, np.float32),
    )


def even(rows, period_us=2000, start=0):
    return start + period_us * np.arange(rows)


def test_an_uninterrupted_recording_is_one_run():
    (run,) = runs_of(samples_at(even(1000, start=5_000_000)))
    assert len(run) == 1000
    assert run.start_s == 5.0
    assert run.period_s == pytest.approx(0.002)
    np.testing.assert_allclose(run.time_s, 5 + 0.002 * np.arange(1000))


def test_lost_rows_and_restarts_end_a_run():
    ticks = np.concatenate([even(800), even(900, start=2_000_000), even(700, start=4_000_000)])
    segment = np.concatenate([np.zeros(1100), np.ones(1300)]).astype(np.int32)
    runs = runs_of(replace(samples_at(ticks), segment=segment))
    assert [len(run) for run in runs] == [800, 600, 700]  # 300 rows before the restart: too short
    assert runs[1].start_s == pytest.approx(2.6)


def test_one_lost_row_ends_a_run():
    ticks = np.delete(even(2001), 1000)
    assert [len(run) for run in runs_of(samples_at(ticks))] == [1000, 1000]


@given(st.lists(st.integers(1, 400), min_size=1, max_size=6))
def test_no_row_is_in_two_runs_and_no_run_spans_a_gap(lengths):
    start, pieces = 0, []
    for length in lengths:
        pieces.append(even(length, start=start))
        start += 2000 * length + 50_000
    samples = samples_at(np.concatenate(pieces))
    if len(samples) < 3:
        return
    expected = [length for length in lengths if length * 0.002 >= 0.2]
    if not expected:
        with pytest.raises(BadInputError):
            runs_of(samples, least_s=0.2)
        return
    if sum(lengths) - len(lengths) > 2 * len(lengths):  # the usual step is the small one
        assert [len(run) for run in runs_of(samples, least_s=0.2)] == expected


def test_jitter_of_the_clock_is_not_a_gap():
    generator = np.random.default_rng(0)
    ticks = even(1000) + generator.integers(-300, 300, 1000)
    assert len(runs_of(samples_at(ticks))) == 1


@pytest.mark.parametrize(("period_us", "text"), [(100_000, "samples a second"), (100, "second")])
def test_a_rate_that_is_no_telemetry_is_refused(period_us, text):
    with pytest.raises(BadInputError, match=text):
        runs_of(samples_at(even(3000, period_us)))


def test_a_recording_of_crumbs_is_refused_with_its_longest_stretch():
    ticks = np.concatenate([even(100, start=k * 1_000_000) for k in range(5)])
    with pytest.raises(BadInputError, match=r"0\.20 s"):
        runs_of(samples_at(ticks))


def test_flying_stretches_leave_the_ground_out():
    samples = samples_at(even(5000))
    duty = samples.duty.copy()
    duty[:1000] = 0
    duty[3000:3010, 2] = 0.05
    duty[4000:] = 0
    (run,) = runs_of(replace(samples, duty=duty))
    assert [len(part) for part in run.parts(turning(run), 2.0)] == [2000]
    assert [len(part) for part in run.parts(turning(run), 1.0)] == [2000, 990]


def test_a_part_keeps_its_time():
    (run,) = runs_of(samples_at(even(1000)))
    part = run[200:300]
    assert (len(part), part.start_s) == (100, pytest.approx(0.4))
    with pytest.raises(ValueError, match="consecutive"):
        run[::2]


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


@pytest.fixture(scope="module")
def fast():
    """Every setting of a Brushless's motors, each with the voltage under it."""
    return recorded(20.0, seed=5, plant="reduced", craft="brushless")[0]


@pytest.fixture(scope="module")
def slow(fast):
    """The same, two settings a row."""
    first, second = fast.duty[1:-1:2].astype(float), fast.duty[2::2].astype(float)
    return replace(fast[2::2], duty=0.5 * (first + second), duty_step=second - first)


def firsts(flown):
    return flown.duty - 0.5 * flown.duty_step


@pytest.mark.parametrize("read", [flights_of, runs_of])
def test_the_first_of_a_rows_two_settings_is_taken_at_the_voltage_that_it_had(fast, slow, read):
    """The cell gives way under each setting at once, and a row's voltage is that of the second."""
    (run,) = read(slow)
    first, second = fast.duty[1:-1:2].astype(float), fast.duty[2::2].astype(float)
    got = first * fast.battery_v[1:-1:2, None]

    def off(volts):
        return np.sqrt(np.mean((volts - got) ** 2))

    assert off(firsts(run) * run.supply_v[:, None]) < 0.5 * off(first * run.supply_v[:, None])
    np.testing.assert_allclose(run.duty + 0.5 * run.duty_step, second, atol=1e-6)


def test_a_reading_that_does_not_answer_to_a_setting_leaves_both_as_they_were(slow):
    (run,) = flights_of(replace(slow, battery_v=np.full(len(slow), 3.7, np.float32)))
    np.testing.assert_array_equal(run.duty_step, slow.duty_step)


def test_rows_that_do_not_tell_two_settings_stay_as_they_were(fast):
    (run,) = flights_of(fast)
    np.testing.assert_array_equal(run.duty, fast.duty)


def streamed(samples, count):
    rows = Rows(0.004, samples.tick_s)
    for first in range(0, len(samples), count):
        rows.append(samples[first : first + count])
    return rows.piece(0, rows.count)


def test_a_stream_learns_it_as_it_comes_however_it_is_cut(slow):
    (run,) = flights_of(slow)
    whole = streamed(slow, len(slow))
    learnt = slice(2000, None)  # of 4900
    moved = np.abs(firsts(run) - slow.duty + 0.5 * slow.duty_step)[learnt].max()
    assert np.abs(firsts(whole) - firsts(run))[learnt].max() < 0.1 * moved
    for count in (1, 7, 250):
        np.testing.assert_array_equal(streamed(slow, count).duty, whole.duty)


def test_a_lost_row_shows_nothing_of_the_supply(slow):
    kept = np.ones(len(slow), bool)
    kept[2000:2400:4] = False
    (run,), (holed,) = flights_of(slow), flights_of(slow[kept])
    there = np.isfinite(holed.duty[:, 0])
    assert (~there).sum() == 100
    np.testing.assert_allclose(holed.duty[there], run.duty[there], atol=2e-5)
