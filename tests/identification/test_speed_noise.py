"""How far recorded rotor speeds tell motion from the noise of their sensor."""

import math

import numpy as np
import pytest

from groundstation.identification.flight import prepare
from groundstation.identification.recordings import flights_of
from groundstation.identification.speed_noise import speed_spectrum, tells_up_to_hz
from support.flights import recorded, truth_of


def flight_with(noise_rev_s, rows_apart=1, held_rows=1):
    """A flight whose true speeds are recorded, with white noise, every few rows, or held."""
    samples, truth = recorded(30.0, plant="reduced", seed=31)
    speeds = truth_of(samples, truth)["rotor_rev_s"].astype(np.float64)[::rows_apart]
    samples = samples[::rows_apart]
    speeds += np.random.default_rng(31).normal(0.0, noise_rev_s, speeds.shape)
    samples.rotor_rev_s[:] = speeds[held_rows * (np.arange(len(speeds)) // held_rows)]
    return prepare(flights_of(samples, "flight"))[0]


# half of a held reading's power is left at half its rate, and it has twice as much at first
@pytest.mark.parametrize(("held_rows", "share"), [(1, 1.0), (2, 1.3)])
def test_the_noise_is_that_of_the_sensor(held_rows, share):
    seen = speed_spectrum(flight_with(0.5, held_rows=held_rows))
    rows = 2 * (len(seen.hz) - 1)
    assert seen.top_hz == pytest.approx(250.0 / held_rows, rel=0.02)
    # of four rotors, beside the mean square of a Hann window
    assert seen.noise == pytest.approx(share * 4.0 * 0.5**2 * rows * 0.375, rel=0.15)


def test_the_more_noise_the_less_they_tell():
    limits = [tells_up_to_hz(flight_with(noise)) for noise in (0.1, 0.3, 1.0)]
    assert limits == sorted(limits, reverse=True)
    assert 8.0 < limits[-1] < 0.7 * limits[0]


def test_where_half_of_the_power_is_motion_the_limit_is():
    clear, noisy = (speed_spectrum(flight_with(noise)) for noise in (0.0, 0.5))
    limit = tells_up_to_hz(flight_with(0.5))
    near = np.abs(clear.hz - limit) < 1.5
    assert clear.power[near].mean() == pytest.approx(noisy.noise, rel=0.5)


def test_readings_too_rare_to_tell_noise_from_motion_tell_what_they_can():
    flight = flight_with(0.5, rows_apart=5)
    assert speed_spectrum(flight).noise is None
    assert tells_up_to_hz(flight) == pytest.approx(50.0, rel=0.02)


def test_modelled_speeds_have_no_noise():
    samples, _ = recorded(30.0, plant="reduced", seed=31)
    assert tells_up_to_hz(prepare(flights_of(samples, "flight"))[0]) == math.inf
