"""Angles that an estimator corrects by positions wander off the gyro's integral."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.prediction.prediction import (
    NONE,
    observe_as_it_is,
    observe_run,
    own_noise,
    predict_observed,
)
from support.flights import BASE, affected, flown

HORIZONS = (10, 25)


@pytest.fixture(scope="module")
def clean():
    run, _ = flown(40.0, 1)
    return run


def wandering(run, size, seed=5):
    """The run with reported yaw on a random walk: size rad in a second."""
    steps = np.random.default_rng(seed).normal(0.0, size * run.period_s**0.5, len(run))
    attitude = run.attitude.copy()
    held = np.repeat(np.cumsum(steps)[::2], 2)[: len(run)]
    attitude[:, 2] += held
    return replace(run, attitude=attitude)


def noise(run, model=BASE):
    seen = observe_run(model, run)
    shown = np.where(seen.fresh[:, None], run.attitude, np.nan)
    return own_noise(replace(run, attitude=shown), seen.flying)


def walk(run, model=BASE):
    return noise(run, model).walk


def test_a_clean_flight_has_none(clean):
    assert walk(clean) == (0.0, 0.0, 0.0)


def test_its_size_is_told_to_a_factor_of_two_on_the_axis_that_wanders(clean):
    roll, pitch, yaw = walk(wandering(clean, 0.02))
    assert (
        max(roll, pitch) <= 0.002
    )  # a yaw that wanders turns a tilted craft's other axes a little
    assert 0.01 <= yaw <= 0.04


def test_a_biased_gyro_is_none(clean):
    assert walk(replace(clean, gyro=clean.gyro + 0.03)) == (0.0, 0.0, 0.0)


def test_lost_rows_are_none(clean):
    gyro, attitude = clean.gyro.copy(), clean.attitude.copy()
    lost = np.random.default_rng(1).random(len(clean)) < 0.02
    gyro[lost], attitude[lost] = np.nan, np.nan
    assert walk(replace(clean, gyro=gyro, attitude=attitude)) == (0.0, 0.0, 0.0)


def test_wandering_angles_are_foretold_better_by_an_observer_that_knows_it(clean):
    run = wandering(clean, 0.02)

    def yaw_error(seen):
        return predict_observed(run, seen, HORIZONS).errors(run)[..., 8].std()

    still = observe_run(BASE, run)
    walking = observe_as_it_is(BASE, run, noise(run))[0]
    assert yaw_error(walking) < 0.7 * yaw_error(still)


def follows(model, run):
    """Whether a model's observer expects the angles to wander."""
    own = noise(run, model)
    still = observe_as_it_is(model, run, replace(own, walk=NONE))[0]
    seen = observe_as_it_is(model, run, own)[0]
    return not np.array_equal(seen.gains.fresh, still.gains.fresh)


def test_a_clean_flight_is_observed_as_in_still_air(clean):
    assert not follows(BASE, clean)


def test_angles_that_the_model_explains_do_not_wander():
    run, _ = flown(40.0, 3, "gyro_low_pass")
    assert any(walk(run))
    assert follows(BASE, run)
    assert not follows(affected("gyro_low_pass"), run)
