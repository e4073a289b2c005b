"""How a joint fit steps where residuals are bent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.identification.estimate import TRUSTED, as_met


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
