"""Residual tests: right about white, coloured and correlated signals."""

import numpy as np
import pytest
from scipy.signal import lfilter

from groundstation.identification.estimate import cross_correlation_test, whiteness_test


def test_white_noise_passes_nearly_always():
    generator = np.random.default_rng(0)
    passed = [whiteness_test(generator.normal(size=2000)).passes for _ in range(300)]
    assert np.mean(passed) > 0.97


@pytest.mark.parametrize("coefficient", [0.15, -0.15])
def test_slightly_coloured_noise_does_not(coefficient):
    noise = lfilter([1.0], [1.0, -coefficient], np.random.default_rng(1).normal(size=4000))
    test = whiteness_test(noise)
    assert test.values[0] == pytest.approx(coefficient, abs=0.05)
    assert whiteness_test(np.convolve(noise, np.ones(5))).passes is False


def test_independent_coloured_signals_are_not_called_correlated():
    generator = np.random.default_rng(2)
    for pole in (0.0, 0.9, 0.98):
        passed = []
        for _ in range(100):
            white = generator.normal(size=3000)
            one, other = lfilter([1.0], [1.0, -pole], generator.normal(size=(2, 3000)), axis=1)
            passed.append(cross_correlation_test(white, one).passes)
            passed.append(cross_correlation_test(one, other).passes)
        assert np.mean(passed) > 0.97, pole


@pytest.mark.parametrize("pole", [0.0, 0.9, 0.98])
def test_an_input_that_explains_a_hundredth_of_the_residual_is_seen(pole):
    generator = np.random.default_rng(5)
    for _ in range(20):
        inputs = lfilter([1.0], [1.0, -pole], generator.normal(size=4000))
        residual = generator.normal(size=4000) + 0.1 * np.roll(inputs, 2) / inputs.std()
        assert not cross_correlation_test(residual, inputs).passes


def test_an_input_that_acts_late_shows_at_its_lag():
    generator = np.random.default_rng(3)
    inputs = generator.normal(size=3000)
    residual = generator.normal(size=3000) + 0.3 * np.roll(inputs, 7)
    test = cross_correlation_test(residual, inputs)
    assert int(np.abs(test.values).argmax()) == 7
    assert np.abs(test.values[7]) > 3 * test.bound


def test_signals_of_different_length_are_refused():
    with pytest.raises(ValueError, match="length"):
        cross_correlation_test(np.zeros(10), np.zeros(11))


def test_on_held_out_data_the_bound_allows_for_what_the_fit_could_not_know():
    """y = b u + e, b fitted on half as many rows: plain bounds reject far too often."""
    generator = np.random.default_rng(4)
    passed = {None: 0, 400: 0}
    for _ in range(300):
        u, e = generator.normal(size=(2, 1200))
        y = 0.5 * u + e
        gain = (u[:400] @ y[:400]) / (u[:400] @ u[:400])
        left, inputs = y[400:] - gain * u[400:], u[400:]
        for rows in passed:
            test = cross_correlation_test(left, inputs, lags=0, fitted_rows=rows)
            passed[rows] += bool(abs(test.values[0]) < test.bound)
    assert passed[None] < 0.93 * 300
    assert passed[400] > 0.97 * 300
