"""Rows of two settings hold both at the row's voltage, in a recording and while they come."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.identification.runs import flights_of, runs_of
from groundstation.twin.signals import Rows
from support.flights import recorded


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
