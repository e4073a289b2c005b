"""The noise of recorded rotor speeds beside their motion."""

import numpy as np
import pytest

from groundstation.identification.flight import prepare, speed_spectrum
from groundstation.identification.runs import flights_of
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
    # of four rotors, beside the mean square of a Hann window
    assert seen.noise == pytest.approx(share * 4.0 * 0.5**2 * rows * 0.375, rel=0.15)


def test_readings_too_rare_do_not_tell_noise_from_motion():
    assert speed_spectrum(flight_with(0.5, rows_apart=5)).noise is None
