"""The lean of an estimator, found in what it reports and what the gyro says."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from bench.real.lean import Turned, find_lean

PERIOD_S = 0.002


def flight(strength, time_s, seed, noise=0.02):
    """A minute of slow pushes, and angles that lean into them."""
    generator = np.random.default_rng(seed)
    count = round(60.0 / PERIOD_S)
    keep = np.exp(-PERIOD_S / 0.5)
    white = np.sqrt(1 - keep**2) * generator.normal(size=(count, 2))
    across = 0.05 * lfilter([1.0], [1, -keep], white, axis=0)
    num, den, _ = cont2discrete(([1.0], [time_s**2, 2 * time_s, 1.0]), PERIOD_S, "zoh")
    angle = strength * lfilter(num.ravel(), den, across, axis=0)
    off = np.gradient(angle, PERIOD_S, axis=0) + noise * generator.normal(size=(count, 2))
    return Turned(PERIOD_S, off, across, slice(500, count - 500))


def test_strength_and_time_constant_are_found():
    found = find_lean([flight(0.9, 0.4, 1), flight(0.9, 0.4, 2)])
    assert found.time_s == pytest.approx(0.4, rel=0.12)
    assert found.strength == pytest.approx([0.9, 0.9], rel=0.1)
    assert (found.share > 0.8).all()


def test_angles_that_do_not_lean_show_none():
    found = find_lean([flight(0.0, 0.4, 1), flight(0.0, 0.4, 2)])
    assert np.abs(found.strength).max() < 0.2
    assert (found.share < 0.05).all()
