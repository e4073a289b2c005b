"""Polynomials of a decimated fit, as those of the loop's shorter period."""

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.arx import simulate_arx
from groundstation.dynamics.arx_period import at_period
from groundstation.dynamics.model import THESIS, ArxAxis
from groundstation.errors import BadInputError

EVERY, TS = 4, 0.002


def model_of(a, b, nk, channel="attitude", ts=EVERY * TS):
    one = ArxAxis(len(a), len(b), nk, tuple(a), tuple(b), ts)
    fit = {"arx": {"channel": channel}}
    return msgspec.structs.replace(THESIS, arx={"roll": one}, fit=fit)


@pytest.mark.parametrize(
    "poles",
    [[], [0.7], [1.0, 1.0], [0.9 + 0.3j, 0.9 - 0.3j], [1.1, 0.95], [0.98, -0.4, 0.0], [-0.5]],
    ids=str,
)
def test_an_input_held_over_each_step_gives_the_polynomials_own_outputs(poles):
    model = model_of(np.real(np.atleast_1d(np.poly(poles)))[1:], (0.3, -0.1), 3)
    held = np.random.default_rng(0).standard_normal(50)
    slow = simulate_arx(model.arx["roll"], held)
    fast = at_period(model, TS).arx["roll"]
    assert (fast.ts, fast.nk) == (TS, 3 * EVERY)
    found = simulate_arx(fast, np.repeat(held, EVERY))[EVERY - 1 :: EVERY]
    np.testing.assert_allclose(found, slow, atol=1e-9 * np.abs(slow).max())


def test_rates_are_as_late_as_the_model_between_the_means_says():
    """Both sides were averaged: at low frequencies 1/A itself, and not late by half a step."""
    model = model_of((-0.9,), (0.5,), 2, "gyro")
    fast = at_period(model, TS).arx["roll"]
    for hz in (0.5, 2.0, 8.0):
        z = np.exp(2j * np.pi * hz * TS)
        own = 0.5 * z ** (-2 * EVERY) / (1 - 0.9 * z**-EVERY)
        lags = np.arange(fast.nb)
        found = np.sum(fast.b * z ** -(lags + fast.nk)) / (1 + fast.a[0] / z)
        # a held input is half a row sooner than its rows say, and blunter towards half the rate
        assert np.angle(found / own) == pytest.approx(0.0, abs=0.02)
        assert abs(found / own) == pytest.approx(1.0, abs=0.03)


def test_a_period_that_fits_is_left_alone():
    model = model_of((-0.9,), (0.5,), 2, ts=TS)
    assert at_period(model, TS) is model


@pytest.mark.parametrize("ts", [0.003, 0.001])
def test_steps_of_no_whole_rows_are_refused(ts):
    with pytest.raises(BadInputError, match=r"every [13] ms, the craft's loop every 2 ms, which"):
        at_period(model_of((-0.9,), (0.5,), 2, ts=ts), TS)
