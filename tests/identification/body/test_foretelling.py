"""What past errors foretell, and knocks that no fit uses are named."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.body import foretold, knocks, learnt
from groundstation.identification.flight import stretches_of
from groundstation.identification.runs import runs_of
from groundstation.recording.formats import open_recording

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


RECORDINGS = Path(__file__).parents[3] / "recordings"


def of(name):
    runs = runs_of(open_recording(RECORDINGS / f"nanobench_{name}.mcap").samples, name)
    return stretches_of(runs, BUILT_IN["crazyflie21"].motor)


def test_the_landing_of_a_real_flight_is_named_and_not_fitted():
    assert knocks(of("figure8")) == [
        "figure8: a knock of 7.2 g at 23.0 s, a landing or a collision, is not fitted"
    ]


def test_a_soft_landing_is_no_knock():
    assert knocks(of("trefoil")) == []
