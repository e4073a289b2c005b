"""A gyro that rotors shake is not to be taken for motion."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.prediction.observer import Noise
from groundstation.prediction.prediction import (
    observe_as_it_is,
    observe_run,
    own_noise,
    predict_observed,
    vibration_of,
)
from support.flights import BASE, affected, flown

STRENGTH = 0.02
PERIOD_S = 0.002


@pytest.fixture(scope="module")
def clean():
    run, _ = flown(40.0, 1)
    return run


def shaken(run, rms_rad_s=STRENGTH, hz=(70.0, 90.0)):
    """The run with the gyro shaken in a narrow band, and still on the ground."""
    from scipy.signal import butter, sosfiltfilt

    rough = np.random.default_rng(7).standard_normal((len(run), 3))
    band = butter(2, np.multiply(2.0 * run.period_s, hz), "band", output="sos")
    made = sosfiltfilt(band, rough, axis=0)
    made *= rms_rad_s / made.std(axis=0) * (run.duty > 0.1).all(axis=1)[:, None]
    return replace(run, gyro=run.gyro + made)


def noise(run):
    return own_noise(run, observe_run(BASE, run).flying)


def test_what_is_faster_than_motors_turn_a_craft_is_told_by_its_size():
    time = PERIOD_S * np.arange(5000)[:, None]
    slow, fast = np.sin(2 * np.pi * 5.0 * time), np.sin(2 * np.pi * 80.0 * time)
    gyro = slow + np.array([0.01, 0.02, 0.03]) * fast
    found = vibration_of(gyro, np.ones(5000, bool), PERIOD_S)
    assert found == pytest.approx(np.array([0.01, 0.02, 0.03]) / 2**0.5, rel=0.1)


def test_a_shock_and_rows_on_the_ground_do_not_count():
    gyro = 0.01 * np.random.default_rng(3).standard_normal((5000, 3))
    usual = vibration_of(gyro, np.ones(5000, bool), PERIOD_S)
    gyro[4000:4100] *= 1000.0
    used = np.arange(5000) > 1000
    gyro[:1000] = 0.0
    assert vibration_of(gyro, used, PERIOD_S) == pytest.approx(usual, rel=0.05)


def test_lost_rows_are_passed_over():
    gyro = 0.01 * np.random.default_rng(3).standard_normal((5000, 3))
    usual = vibration_of(gyro, np.ones(5000, bool), PERIOD_S)
    gyro[::50] = np.nan
    assert vibration_of(gyro, np.ones(5000, bool), PERIOD_S) == pytest.approx(usual, rel=0.1)


def test_slow_rows_and_short_flights_tell_none():
    gyro, used = np.ones((5000, 3)), np.ones(5000, bool)
    assert vibration_of(gyro, used, 0.01) == (0.0, 0.0, 0.0)
    assert vibration_of(gyro, np.arange(5000) < 1000, PERIOD_S) == (0.0, 0.0, 0.0)


def test_a_shaken_gyro_is_noisier_than_usual(clean):
    found, usual = noise(shaken(clean)).gyro, Noise().gyro
    assert all(0.8 * STRENGTH < one < 1.3 * STRENGTH for one in found)
    assert max(usual) < STRENGTH / 5


def rate_error(run, seen):
    return predict_observed(run, seen, (10, 25)).errors(run)[..., :3].std()


def test_an_observer_that_knows_it_foretells_rates_better(clean):
    run = shaken(clean)
    still, known = observe_run(BASE, run), observe_as_it_is(BASE, run, noise(run))[0]
    # 0.64 of the error is the shaking itself
    assert rate_error(run, known) < 0.85 * rate_error(run, still)


def test_so_does_one_without_angles(clean):
    run = shaken(replace(clean, attitude=np.full_like(clean.attitude, np.nan)))
    still, known = observe_run(BASE, run), observe_as_it_is(BASE, run, noise(run))[0]
    assert rate_error(run, known) < 0.9 * rate_error(run, still)


def test_rough_air_that_looks_alike_is_observed_as_before():
    run, _ = flown(40.0, 2, torque_noise=6.0)
    assert noise(run).gyro > Noise().gyro
    still, known = observe_run(BASE, run), observe_as_it_is(BASE, run, noise(run))[0]
    np.testing.assert_array_equal(known.gains.fresh, still.gains.fresh)


def test_a_model_without_an_effect_that_is_there_is_observed_as_it_is_foretold_best():
    run, _ = flown(40.0, 3, "dead_time")
    run = shaken(run)
    for model in (BASE, affected("dead_time")):
        still, known = observe_run(model, run), observe_as_it_is(model, run, noise(run))[0]
        assert rate_error(run, known) <= 1.01 * rate_error(run, still)
