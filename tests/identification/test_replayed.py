"""A model on recorded inputs: where it must agree with the craft, and what it refuses."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from groundstation.identification.report import angle_rms, simulate_run
from groundstation.identification.runs import runs_of
from support.flights import recorded, truth_of

MODEL = vehicle_model(BUILT_IN["crazyflie1"])


@pytest.fixture(scope="module")
def quiet():
    """A flight of the base model without disturbances, and its truth."""
    samples, truth = recorded(20.0, plant="reduced", seed=61, torque_noise=0.0, sensor_noise=0.0)
    (run,) = runs_of(samples)
    rows = slice(3500, len(run))
    return run[rows], truth_of(samples, truth)[rows]


def test_without_disturbances_the_model_follows_the_flight(quiet):
    run, truth = quiet
    done = simulate_run(MODEL, run, window_s=0.5)
    settled = slice(500, None)
    np.testing.assert_allclose(done.rotor_rev_s[settled], truth["rotor_rev_s"][settled], atol=0.1)
    assert np.degrees(np.abs(done.gyro - run.gyro)[settled].max()) < 0.5
    # The reported angle is held for two rows: up to 0.2 deg old at 100 deg/s.
    assert np.degrees(np.abs(done.attitude - run.attitude)[settled].max()) < 0.4
    assert np.abs(done.accelerometer[:, 2] - run.accelerometer[:, 2])[settled].max() < 0.05


def test_rotor_speeds_are_those_that_a_sensor_which_lags_would_show(quiet):
    """What is shown moves by what it is behind, over the lag."""
    run, _ = quiet
    sensor = EffectTerm("rotor_speed_sensor", {"lag_s": Estimate(0.008)})
    lagging = msgspec.structs.replace(MODEL, effects=(sensor,))
    done, other = simulate_run(MODEL, run), simulate_run(lagging, run)
    np.testing.assert_array_equal(other.gyro, done.gyro)
    shown, behind = other.rotor_rev_s[500:], (done.rotor_rev_s - other.rotor_rev_s)[500:]
    assert np.abs(behind).max() > 1.0
    moved = 0.008 * np.diff(shown, axis=0) / run.period_s
    np.testing.assert_allclose(moved, 0.5 * (behind[1:] + behind[:-1]), atol=0.03)


def test_longer_windows_drift_further(quiet):
    run, _ = quiet
    far = with_c0(1.1)

    def error(window_s):
        gap = simulate_run(far, run, window_s).attitude - run.attitude
        return np.sqrt(np.mean(gap[500:, 0] ** 2))

    assert error(0.1) < error(0.5) < error(2.0)


def test_the_errors_of_angles_are_those_of_runs_whose_start_is_known(quiet):
    run, _ = quiet
    true, wrong = (angle_rms(model, [run], 0.5) for model in (MODEL, with_c0(1.1)))
    assert np.degrees(true.max()) < 0.4
    assert wrong[0] > 2.0 * true[0]
    with pytest.raises(BadInputError, match="never leaves the ground"):
        angle_rms(MODEL, [run[:200]], 0.5)


def with_c0(factor):
    body = msgspec.structs.replace(MODEL.body, c0=factor * MODEL.body.c0)
    return msgspec.structs.replace(MODEL, body=body)


def test_a_run_without_battery_voltage_is_refused(quiet):
    run, _ = quiet
    dark = replace(run, supply_v=np.full(len(run), np.nan))
    with pytest.raises(BadInputError, match="battery's voltage is nowhere in it"):
        simulate_run(MODEL, dark)


def test_a_window_shorter_than_a_row_is_refused(quiet):
    run, _ = quiet
    with pytest.raises(BadInputError, match="shorter than a row"):
        simulate_run(MODEL, run, window_s=0.001)
