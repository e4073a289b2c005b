"""The estimate that judges fits on real flights is itself right where the truth is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.real.reference import MIXER_X, Flight, explained, reference_gain

PERIOD_S, GAIN, LATE_ROWS = 0.002, 2.0e-3, 4


@pytest.fixture(scope="module")
def flight():
    """10 s in closed loop: torque answers the rate, a slow moment of ten times its power."""
    rng = np.random.default_rng(7)
    count = 5_000
    slow = 40 * lfilter([0.02], [1, -0.998], rng.standard_normal(count))
    shaking = rng.standard_normal(count)
    wanted = 3 * lfilter([0.1], [1, -0.9], rng.standard_normal(count))
    rate, torque = np.zeros(count), np.zeros(count)
    for row in range(1, count):
        acting = torque[row - LATE_ROWS] if row >= LATE_ROWS else 0.0
        rate[row] = rate[row - 1] + PERIOD_S * (GAIN * acting + slow[row] + shaking[row])
        torque[row] = 15 * (wanted[row] - rate[row]) / GAIN
    square = 250.0**2 + torque[:, None] * MIXER_X["roll"] / 4
    gyro = np.column_stack([rate, 0 * rate, 0 * rate])
    return Flight("made", PERIOD_S, gyro, square, 0 * square, measured=True)


def test_slow_moments_in_closed_loop_do_not_bend_the_reference(flight):
    found = reference_gain([flight], "roll")
    assert found.gain == pytest.approx(GAIN, rel=0.03)
    assert found.explained > 0.9
    direct = float(np.gradient(flight.gyro[:, 0], PERIOD_S) @ (flight.square @ MIXER_X["roll"]))
    direct /= float(np.sum((flight.square @ MIXER_X["roll"]) ** 2))
    assert abs(direct) < 0.7 * GAIN  # what least squares over everything would say


def test_a_gain_that_is_far_off_explains_nothing(flight):
    found = reference_gain([flight], "roll")
    share = explained([flight], "roll", GAIN / 50, found.delay_s, found.shape_s)
    assert share < 0.1
