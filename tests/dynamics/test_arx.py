"""ARX polynomials as simulators, against the difference equation written out."""

import numpy as np
import pytest

from groundstation.dynamics.model import THESIS, ArxAxis, arx_ahead, poles, simulate_arx


def written_out(axis, inputs, past):
    """Eq. 7.9 term by term."""
    outputs = list(past)
    for t in range(len(inputs)):
        value = 0.0
        for i, a in enumerate(axis.a, 1):
            if len(outputs) - i >= 0:
                value -= a * outputs[-i]
        for j, b in enumerate(axis.b):
            if t - axis.nk - j >= 0:
                value += b * inputs[t - axis.nk - j]
        outputs.append(value)
    return np.array(outputs[len(past) :])


@pytest.mark.parametrize(
    "axis",
    [
        ArxAxis(2, 1, 8, (-1.9, 0.91), (0.3,), 0.002),
        ArxAxis(1, 3, 0, (-0.5,), (1.0, 0.2, -0.1), 0.002),
        ArxAxis(3, 2, 1, (-1.2, 0.3, 0.05), (0.1, 0.4), 0.002),
    ],
)
def test_a_free_run_is_the_difference_equation(axis):
    inputs = np.random.default_rng(0).normal(size=60)
    past = np.array([0.3, -0.2, 0.5])[: axis.na]
    np.testing.assert_allclose(
        simulate_arx(axis, inputs, past), written_out(axis, inputs, past), atol=1e-12
    )


def test_the_roll_model_of_the_thesis_is_unstable():
    """Eq. 7.27: z = 1.0317 and 0.9273, so an impulse grows with 15.6 rad/s."""
    roll = poles(THESIS.arx["roll"])
    np.testing.assert_allclose(roll, [1.0317, 0.9273], atol=5e-5)
    assert np.log(roll[0].real) / 0.002 == pytest.approx(15.6, abs=0.1)


@pytest.mark.parametrize("every", [1, 4])
def test_a_run_ahead_is_the_difference_equation_from_what_was_measured(every):
    axis = ArxAxis(2, 2, 3, (-1.7, 0.72), (0.3, -0.1), 0.002 * every)
    inputs, outputs = np.random.default_rng(1).normal(size=(2, 200))
    (flown,) = arx_ahead(axis, inputs, outputs, np.array([101]), 8 * every, every)
    steps = inputs[101 % every :: every]
    at = 101 // every
    past = outputs[101 - every], outputs[101]
    full = [past[0], past[1]]
    for t in range(at + 1, at + 9):
        driven = 0.3 * steps[t - 3] - 0.1 * steps[t - 4]
        full.append(1.7 * full[-1] - 0.72 * full[-2] + driven)
    np.testing.assert_allclose(flown[::every], full[1:], atol=1e-9)
