"""Prediction errors are judged in the rows that were measured, in flight."""

from types import SimpleNamespace

import numpy as np
import pytest

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import (
    ATTITUDE,
    FURTHER_EVERY_S,
    HORIZONS_S,
    ahead_errors,
    overall,
    pooled_rms,
)
from groundstation.prediction.drive import fresh_rows
from support.flights import BASE, MEDIUM, hidden, judged
from support.flights import compared as flights


def test_attitude_that_is_sent_twice_is_judged_in_every_second_row():
    (run,) = flights(1)
    fresh = fresh_rows(run.attitude)
    assert (np.diff(np.flatnonzero(fresh)) == 2).all()
    errors = ahead_errors(run, BASE)
    for horizon in errors.horizons:
        assert not np.isfinite(horizon[~fresh, ATTITUDE]).any()


def test_predictions_that_start_less_often_are_the_same_and_meet_fresh_angles():
    (run,) = flights(1)
    every, some = ahead_errors(run, BASE), ahead_errors(run, BASE, every_s=0.006)
    for one, other in zip(every.horizons, some.horizons, strict=True):
        judged = np.isfinite(other)
        share = judged.sum(axis=0) / np.isfinite(one).sum(axis=0)
        assert share == pytest.approx(np.full(9, 1 / 3), rel=0.01)
        np.testing.assert_array_equal(other[judged], one[judged])


def test_a_row_that_was_lost_is_neither_judged_nor_a_start():
    (run,) = flights(1, loss=0.02)
    lost = np.flatnonzero(~np.isfinite(run.gyro[:, 0]))
    errors = ahead_errors(run, BASE)
    for horizon, rows in zip(errors.horizons, errors.rows, strict=True):
        assert not np.isfinite(horizon[lost, 0]).any()
        after = lost + rows[0]
        assert not np.isfinite(horizon[after[after < len(run)], 0]).any()


def test_the_further_ahead_the_larger_the_error_of_a_rate():
    one = judged()
    near, far = (one.at_horizon(k)[0][:3] for k in range(len(HORIZONS_S)))
    assert (far > near).all()


def test_nothing_is_judged_on_the_ground():
    (run,) = flights(1)
    errors = ahead_errors(run, BASE)
    still = (run.duty < 0.05).all(axis=1)
    assert still.any()
    for horizon in errors.horizons:
        assert not np.isfinite(horizon[still]).any()


def test_all_channels_in_one_number_leave_out_what_is_not_there():
    floor = np.array([1.0, 1.0, np.nan])
    assert overall(np.array([2.0, 2.0, 5.0]), floor) == pytest.approx(2.0)
    assert overall(np.array([1.0, 7.0, 5.0]), floor) == pytest.approx(5.0)
    assert np.isnan(overall(np.full(3, np.nan), floor))


def test_predictions_that_grow_without_end_are_no_small_gap():
    errors = np.full((10, 9), 1.0)
    errors[:, 0] = 1e200
    rms = pooled_rms([errors])
    assert np.isinf(rms[0])
    assert rms[1:] == pytest.approx(1.0)
    assert np.isinf(overall(rms, np.ones(9)))


def test_rms_is_pooled_over_rows_not_over_runs():
    long, short = np.full((30, 9), 1.0), np.full((10, 9), 3.0)
    assert pooled_rms([long, short])[0] == pytest.approx(np.sqrt((30 + 90) / 40))


def test_200_and_500_ms_ahead_a_right_model_is_at_noise_and_a_wrong_one_shows_more():
    right, wrong = judged(), judged(effects=hidden("velocity_moment", MEDIUM["velocity_moment"]))
    near, far = (overall(*right.further().at_horizon(number)) for number in (0, 1))
    assert (near, far) == pytest.approx((1.0, 1.0), abs=0.1)
    ahead = wrong.further()
    assert wrong.gap < overall(*ahead.at_horizon(0)) < overall(*ahead.at_horizon(1))


def test_of_a_model_that_was_predicted_from_every_row_fewer_starts_are_known(monkeypatch):
    one = judged()
    (afresh,) = (
        ahead_errors(e.recorded, one.model, like=e, every_s=FURTHER_EVERY_S) for e in one.errors
    )
    monkeypatch.setattr("groundstation.comparison.comparison.ahead_errors", None)
    (found,) = one.with_model(one.model, FURTHER_EVERY_S).errors
    np.testing.assert_array_equal(found.begun, afresh.begun)
    for known, made in zip(
        (found.step, *found.horizons), (afresh.step, *afresh.horizons), strict=True
    ):
        np.testing.assert_array_equal(known, made)


def test_a_model_that_hardly_differs_may_be_observed_as_the_other_one_was():
    one = judged()
    (own,), (again,) = one.errors, one.with_model(one.model, same_observer=True).errors
    assert again.chosen == own.chosen
    np.testing.assert_array_equal(again.horizons[-1], own.horizons[-1])


def test_a_model_that_leaves_what_noise_leaves_has_a_gap_of_one():
    values = np.random.default_rng(6).normal(size=(2, 50, 9)) * np.array([[[1.0]], [[2.0]]])
    left = SimpleNamespace(horizons=tuple(values))
    same = Comparison(BASE, (left,), (left,), None)
    assert same.gap == pytest.approx(1.0)
    assert same.noise_floor == pytest.approx(np.sqrt(np.mean(values**2, axis=(0, 1))))
