"""The autoregressive noise model: its order, its coefficients, what whitening leaves."""

import numpy as np
import pytest
from scipy.signal import lfilter

from groundstation.comparison.noise_floor import estimate_noise
from groundstation.identification.estimate import whiteness_test


def coloured(a, rows=20000, seed=0, spread=0.3):
    return lfilter([1.0], a, np.random.default_rng(seed).normal(0, spread, rows))


def test_an_autoregression_is_found_again():
    a = [1.0, -1.2, 0.5]
    noise = estimate_noise([coloured(a), coloured(a, seed=1)], 30)
    np.testing.assert_allclose(noise.whitener[:3], a, atol=0.02)
    assert np.abs(noise.whitener[3:]).max(initial=0) < 0.03
    assert noise.variance == pytest.approx(0.09, rel=0.02)


def test_white_noise_needs_no_model():
    noise = estimate_noise([np.random.default_rng(2).normal(size=50000)], 40)
    assert len(noise.whitener) <= 4
    assert np.abs(noise.whitener[1:]).max(initial=0) < 0.02


def test_what_is_whitened_is_white_also_for_a_moving_average():
    """A differenced sensor noise, which no autoregression of finite order is exactly."""
    raw = np.random.default_rng(3).normal(size=20001)
    signal = raw[1:] - 0.8 * raw[:-1]
    noise = estimate_noise([signal], 60)
    white = lfilter(noise.whitener, [1.0], signal)[len(noise.whitener) - 1 :]
    assert whiteness_test(white).passes
    assert noise.variance == pytest.approx(1.0, rel=0.05)
