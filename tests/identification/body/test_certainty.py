"""Constants that all frequencies together do not agree on."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR
from groundstation.identification.body import fit_body
from groundstation.identification.body_setup import blurred, certain, set_up
from groundstation.identification.flight import stretches_of
from groundstation.identification.likelihood.problem import fit_free
from groundstation.identification.runs import runs_of
from support.flights import recorded, truth_of

VEHICLE = BUILT_IN["crazyflie1"]
NOT_USED = "--measured-rotors"
TRUE = dict(zip(("c0", "c1"), VEHICLE.body_constants[:2], strict=True))


def recorded_speeds(rows_apart=1):
    """Samples of a flight, every so many rows, and the true rotor speeds beside them."""
    samples, truth = recorded(30.0, plant="reduced", seed=31)
    speeds = truth_of(samples, truth)["rotor_rev_s"].astype(np.float64)
    return samples[::rows_apart], speeds[::rows_apart]


def are_blurred(samples, speeds):
    samples.rotor_rev_s[:] = speeds
    stretches = stretches_of(runs_of(samples, "flight"), THESIS_MOTOR, measured=True)
    return blurred(set_up(stretches, VEHICLE, VEHICLE.thrust_per_mass, ()).problem.flights)


def test_no_error_is_smaller_than_the_likelihood_s_own():
    """Blocks of time and bands of frequency may add to it, never take from it."""
    samples, speeds = recorded_speeds()
    samples.rotor_rev_s[:] = speeds
    stretches = stretches_of(runs_of(samples, "flight"), THESIS_MOTOR, measured=True)
    setup = set_up(stretches, VEHICLE, VEHICLE.thrust_per_mass, ())
    free = fit_free(setup.linearise, setup.start, setup.limits(), white=False)
    found = certain(setup, free, noisy=False)
    likelihood = np.diag(np.linalg.inv(free.normal))
    assert (np.diag(found.covariance) > 0.999 * likelihood).all()
    assert found.alone == pytest.approx(likelihood)


def noise_like(speeds, held_rows=1):
    noise = np.random.default_rng(31).normal(0.0, 1.0, speeds.shape)
    return noise[np.arange(len(noise)) // held_rows]


def test_true_speeds_tell_at_all_frequencies():
    assert not are_blurred(*recorded_speeds())


@pytest.mark.parametrize("held_rows", [1, 2, 4])
def test_noise_is_noticed_though_a_sensor_holds_each_reading(held_rows):
    samples, speeds = recorded_speeds()
    held = speeds[held_rows * (np.arange(len(speeds)) // held_rows)]
    assert are_blurred(samples, held + noise_like(speeds, held_rows))


def test_readings_too_slow_to_tell_noise_from_motion_are_not_relied_on():
    assert are_blurred(*recorded_speeds(rows_apart=5))


def fitted(noise_rev_s, averaged_rows=1, held_rows=1, measured=True):
    """The fit to a flight whose rotor speeds are averaged, held and noisy."""
    samples, truth = recorded(66.0, plant="reduced", seed=31)
    speeds = truth_of(samples, truth)["rotor_rev_s"].astype(np.float64)
    mean = uniform_filter1d(speeds, averaged_rows, axis=0, origin=(averaged_rows - 1) // 2)
    row = np.arange(len(mean))
    noise = np.random.default_rng(31).normal(0.0, noise_rev_s, mean.shape)
    samples.rotor_rev_s[:] = mean[row - row % held_rows] + noise
    stretches = stretches_of(runs_of(samples, "flight"), THESIS_MOTOR, measured)
    return fit_body(stretches, VEHICLE)


def test_noisy_rotor_speeds_leave_the_constants_right_and_a_word():
    """A noise of 1 rev/s hides what rotors do at high frequency: all frequencies together make
    the constants four to five times too small, with standard errors of per cents."""
    fit = fitted(1.0, averaged_rows=4, held_rows=2)
    for name in TRUE:
        low, high = fit.estimates.interval(0.95)[fit.estimates.names.index(name)]
        assert fit.estimates[name] == pytest.approx(TRUE[name], rel=0.06)
        assert low < TRUE[name] < high
    assert fit.body.c1 == pytest.approx(TRUE["c1"], rel=0.06)
    (said,) = [line for line in fit.warnings if "2 to 20 Hz" in line]
    assert "measured rotor speeds are too noisy" in said


def test_speeds_that_are_known_well_tell_by_all_frequencies_and_nothing_is_said():
    fit = fitted(0.02)
    for name, true in TRUE.items():
        assert fit.estimates[name] == pytest.approx(true, rel=0.02)
    assert not [line for line in fit.warnings if "2 to 20 Hz" in line or NOT_USED in line]


def test_speeds_that_were_recorded_and_not_used_are_worth_a_word():
    assert [line for line in fitted(0.02, measured=False).warnings if NOT_USED in line]
