"""Standard errors, intervals, steps and tests of residuals are what repetitions say they are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from groundstation.identification.estimate import (
    TRUSTED,
    Estimates,
    as_met,
    cross_correlation_test,
    inverse,
    sandwich,
    whiteness_test,
)

TRUE = np.array([2.0, -30.0])
ROWS, BLOCK, REPETITIONS = 600, 10, 400


def repeated(correlated):
    """Least squares on many draws of one experiment: estimates of each, white or constant over
    stretches of rows."""
    rng = np.random.default_rng(1)
    design = rng.normal(size=(ROWS, 2)) * [1.0, 0.1]
    design = np.repeat(design[::BLOCK], BLOCK, axis=0) if correlated else design
    normal = design.T @ design
    alone, found = inverse(normal), []
    for _ in range(REPETITIONS):
        noise = rng.normal(size=ROWS)
        noise = np.repeat(noise[::BLOCK], BLOCK) if correlated else noise
        measured = design @ TRUE + noise
        values = alone @ design.T @ measured
        left = measured - design @ values
        if correlated:
            scores = (design * left[:, None]).reshape(-1, BLOCK, 2).sum(axis=1)
            covariance = sandwich(normal, scores)
        else:
            covariance = alone * (left @ left) / (ROWS - 2)
        found.append(Estimates(("a", "b"), values, covariance, ROWS - 2))
    return found


@pytest.fixture(scope="module", params=[False, True], ids=["white", "correlated"])
def estimates(request):
    return repeated(request.param)


def test_the_standard_error_is_the_scatter_of_many_experiments(estimates):
    scatter = np.std([one.values for one in estimates], axis=0)
    stated = np.sqrt(np.mean([one.stderr**2 for one in estimates], axis=0))
    np.testing.assert_allclose(stated, scatter, rtol=0.1)


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_an_interval_holds_the_truth_as_often_as_it_says(estimates, probability):
    intervals = np.array([one.interval(probability) for one in estimates])
    held = ((intervals[..., 0] <= TRUE) & (intervals[..., 1] >= TRUE)).mean(axis=0)
    np.testing.assert_allclose(held, probability, atol=0.06)


def test_the_standard_error_is_the_root_of_the_covariances_diagonal():
    one = Estimates(("a", "b"), TRUE, np.array([[4.0, 0.6], [0.6, 0.09]]), 100.0)
    np.testing.assert_allclose(one.stderr, [2.0, 0.3])
    np.testing.assert_allclose(one.correlation, [[1.0, 1.0], [1.0, 1.0]])
    assert one.as_dict()["stderr"] == pytest.approx([2.0, 0.3])
    low, high = one.interval(0.95)[0]
    assert (high - low) / 2 == pytest.approx(1.984 * 2.0, rel=1e-3)  # Student, 100 degrees


def test_blocks_of_which_some_were_fitted_away_count_for_as_many_as_are_left():
    scores = np.array([[3.0], [-1.0], [2.0], [-4.0]])
    assert sandwich(np.array([[10.0]]), scores)[0, 0] == pytest.approx(30.0 / 100.0 * 4 / 3)


def drawn(seed, ratio):
    """A normal matrix, a step, and a fall of the gradient that tells ``ratio`` of its curvature."""
    random = np.random.default_rng(seed)
    root = random.standard_normal((6, 4))
    normal, step = root.T @ root, random.standard_normal(4)
    return normal, step, ratio * normal @ step


@given(seed=st.integers(0, 10**6), ratio=st.floats(*TRUSTED))
def test_the_curvature_along_the_last_step_is_what_its_ends_tell(seed, ratio):
    normal, step, fall = drawn(seed, ratio)
    met = as_met(normal, step, fall)
    assert step @ met @ step == pytest.approx(fall @ step)
    np.testing.assert_allclose(met, met.T)
    assert np.linalg.eigvalsh(met).min() > 0.0


@given(seed=st.integers(0, 10**6), ratio=st.floats(*TRUSTED))
def test_a_direction_that_the_step_did_not_take_keeps_its_curvature(seed, ratio):
    normal, step, fall = drawn(seed, ratio)
    other = np.random.default_rng(seed + 1).standard_normal(4)
    other -= (other @ normal @ step) / (step @ normal @ step) * step
    np.testing.assert_allclose(as_met(normal, step, fall) @ other, normal @ other, atol=1e-9)


@pytest.mark.parametrize("ratio", [-3.0, 0.01, 100.0])
def test_beyond_what_is_trusted_the_curvature_is_that_of_the_limit(ratio):
    normal, step, fall = drawn(3, ratio)
    met = step @ as_met(normal, step, fall) @ step
    assert met == pytest.approx(np.clip(ratio, *TRUSTED) * step @ normal @ step)


def test_a_step_of_nothing_tells_nothing():
    normal, _, _ = drawn(3, 1.0)
    assert as_met(normal, np.zeros(4), np.ones(4)) is normal


def test_steps_that_went_to_and_fro_end_in_the_middle():
    # One unknown whose true curvature is 1.8 of Gauss-Newton's: plain steps leave 0.8 each time.
    def off_after(steps, met):
        x, normal, last = 1.0, np.eye(1), None
        for _ in range(steps):
            gradient = np.array([-1.8 * x])
            if met and last is not None:
                normal = as_met(np.eye(1), last[0], last[1] - gradient)
            step = np.linalg.solve(normal, gradient)
            x, last = x + float(step[0]), (step, gradient)
        return abs(x)

    assert off_after(6, met=False) == pytest.approx(0.8**6)
    assert off_after(2, met=True) == pytest.approx(0.0, abs=1e-12)


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
