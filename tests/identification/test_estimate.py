"""Standard errors and intervals are those that many repetitions have."""

import numpy as np
import pytest

from groundstation.identification.estimate import Estimates, inverse, sandwich

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
