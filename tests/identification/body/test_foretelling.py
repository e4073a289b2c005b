"""What past errors foretell: a torque that lasts, noise of the starting row, and nothing else."""

import numpy as np
import pytest

from groundstation.identification.body.workflow import foretold, learnt

PERIOD_S, ROWS, SECONDS = 0.002, 25, 30.0
SIZE = round(SECONDS / PERIOD_S)


def white(seed):
    return np.random.default_rng(seed).normal(size=SIZE)


def truth(errors):
    total = np.concatenate([[0.0], np.cumsum(errors)])
    return total[ROWS:] - total[:-ROWS]


def left(errors, fitted):
    """Share of the sums' RMS that is not foretold, after the first seconds."""
    made = foretold(errors, ROWS, PERIOD_S, learnt([fitted], ROWS, PERIOD_S))
    late = slice(round(5.0 / PERIOD_S), None)
    sums = truth(errors)
    return np.std((sums - made)[late]) / np.sqrt(np.mean(sums[late] ** 2))


def test_of_white_errors_nothing_is_foretold_nor_made_worse():
    assert left(white(1), white(2)) == pytest.approx(1.0, abs=0.03)


def test_a_torque_that_lasts_goes_on_though_no_fitted_flight_had_it():
    assert left(white(1) + 2.0, white(2)) < 0.25


def test_noise_of_the_gyro_at_the_start_is_seen_in_the_step_that_it_made():
    shaken = np.diff(white(3), prepend=0.0)
    assert left(shaken, np.diff(white(4), prepend=0.0)) < 0.85


def test_another_flights_rhythm_is_unlearnt():
    slow = np.convolve(white(5), np.ones(200) / 200, "same")
    assert left(white(6) + 20 * slow, np.diff(white(4), prepend=0.0)) < 0.6


def test_no_row_of_the_future_counts():
    errors = white(7) + 1.0
    changed = errors.copy()
    row = 9000
    changed[row:] = -5.0 * errors[row:]
    before = learnt([white(2)], ROWS, PERIOD_S)
    one, other = (foretold(series, ROWS, PERIOD_S, before) for series in (errors, changed))
    np.testing.assert_array_equal(one[: row + 1], other[: row + 1])
    assert np.abs(one[row + 50 :] - other[row + 50 :]).max() > 1.0
