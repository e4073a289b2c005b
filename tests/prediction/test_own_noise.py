"""Noise that a flight tells of its own: angles that wander, a gyro that rotors shake."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.prediction.observer import Noise
from groundstation.prediction.prediction import (
    NONE,
    observe_as_it_is,
    observe_run,
    own_noise,
    predict_observed,
    vibration_of,
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


def test_a_clean_flight_and_a_biased_gyro_have_none(clean):
    assert walk(clean) == (0.0, 0.0, 0.0)
    assert walk(replace(clean, gyro=clean.gyro + 0.03)) == (0.0, 0.0, 0.0)


def test_its_size_is_told_to_a_factor_of_two_on_the_axis_that_wanders(clean):
    roll, pitch, yaw = walk(wandering(clean, 0.02))
    assert max(roll, pitch) <= 0.002  # yaw turns a tilted craft's other axes a little
    assert 0.01 <= yaw <= 0.04


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


def test_angles_that_the_model_explains_do_not_wander(clean):
    assert not follows(BASE, clean)
    run, _ = flown(40.0, 3, "gyro_low_pass")
    assert any(walk(run))
    assert follows(BASE, run)
    assert not follows(affected("gyro_low_pass"), run)


STRENGTH = 0.02
PERIOD_S = 0.002


def shaken(run, rms_rad_s=STRENGTH, hz=(70.0, 90.0)):
    """The run with the gyro shaken in a narrow band, and still on the ground."""
    from scipy.signal import butter, sosfiltfilt

    rough = np.random.default_rng(7).standard_normal((len(run), 3))
    band = butter(2, np.multiply(2.0 * run.period_s, hz), "band", output="sos")
    made = sosfiltfilt(band, rough, axis=0)
    made *= rms_rad_s / made.std(axis=0) * (run.duty > 0.1).all(axis=1)[:, None]
    return replace(run, gyro=run.gyro + made)


def told_noise(run):
    return own_noise(run, observe_run(BASE, run).flying)


def test_what_is_faster_than_motors_turn_a_craft_is_told_by_its_size():
    time = PERIOD_S * np.arange(5000)[:, None]
    slow, fast = np.sin(2 * np.pi * 5.0 * time), np.sin(2 * np.pi * 80.0 * time)
    gyro = slow + np.array([0.01, 0.02, 0.03]) * fast
    found = vibration_of(gyro, np.ones(5000, bool), PERIOD_S)
    assert found == pytest.approx(np.array([0.01, 0.02, 0.03]) / 2**0.5, rel=0.1)


def test_a_shock_rows_on_the_ground_and_lost_rows_do_not_count():
    gyro = 0.01 * np.random.default_rng(3).standard_normal((5000, 3))
    usual, holed = vibration_of(gyro, np.ones(5000, bool), PERIOD_S), gyro.copy()
    gyro[4000:4100] *= 1000.0
    used = np.arange(5000) > 1000
    gyro[:1000] = 0.0
    assert vibration_of(gyro, used, PERIOD_S) == pytest.approx(usual, rel=0.05)
    holed[::50] = np.nan
    assert vibration_of(holed, np.ones(5000, bool), PERIOD_S) == pytest.approx(usual, rel=0.1)


def test_slow_rows_and_short_flights_tell_none():
    gyro, used = np.ones((5000, 3)), np.ones(5000, bool)
    assert vibration_of(gyro, used, 0.01) == (0.0, 0.0, 0.0)
    assert vibration_of(gyro, np.arange(5000) < 1000, PERIOD_S) == (0.0, 0.0, 0.0)


def test_a_shaken_gyro_is_noisier_than_usual(clean):
    found, usual = told_noise(shaken(clean)).gyro, Noise().gyro
    assert all(0.8 * STRENGTH < one < 1.3 * STRENGTH for one in found)
    assert max(usual) < STRENGTH / 5


def rate_error(run, seen):
    return predict_observed(run, seen, (10, 25)).errors(run)[..., :3].std()


@pytest.mark.parametrize(("angles", "share"), [(1.0, 0.85), (np.nan, 0.9)])
def test_an_observer_that_knows_it_foretells_rates_better_also_without_angles(clean, angles, share):
    run = shaken(replace(clean, attitude=angles * clean.attitude))
    still, known = observe_run(BASE, run), observe_as_it_is(BASE, run, told_noise(run))[0]
    # 0.64 of the error is the shaking itself
    assert rate_error(run, known) < share * rate_error(run, still)


def test_rough_air_that_looks_alike_is_observed_as_before():
    run, _ = flown(40.0, 2, torque_noise=6.0)
    assert told_noise(run).gyro > Noise().gyro
    still, known = observe_run(BASE, run), observe_as_it_is(BASE, run, told_noise(run))[0]
    np.testing.assert_array_equal(known.gains.fresh, still.gains.fresh)


def test_a_model_without_an_effect_that_is_there_is_observed_as_it_is_foretold_best():
    run, _ = flown(40.0, 3, "dead_time")
    run = shaken(run)
    for model in (BASE, affected("dead_time")):
        still, known = observe_run(model, run), observe_as_it_is(model, run, told_noise(run))[0]
        assert rate_error(run, known) <= 1.01 * rate_error(run, still)
