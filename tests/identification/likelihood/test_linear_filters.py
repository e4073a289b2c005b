"""Filters of rows beside ones that run finely and know nothing of rows."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, lfilter

from groundstation.identification.likelihood.sensing import (
    FORCES,
    RATES,
    NearRest,
    behind_firmware,
    behind_sensor,
)

ROWS = 40
PACE = 2.0 * np.pi * 30.0
ONE, NONE = np.eye(3), np.zeros((3, 3))
APART = np.diag([1.0, 1.4, 0.7])
"""Another pace on each axis: no filter that is the same on all three."""
TURNED = np.roll(ONE, 1, axis=0)
"""Each axis shows what the one before it was given."""


@pytest.fixture
def values():
    return np.random.default_rng(4).normal(size=(ROWS, 3))


def low_pass(order, pace, turn=ONE):
    """A low-pass of all three axes of rates and forces at once, near rest."""
    out = np.hstack([turn, NONE])[:, : 3 * order]
    if order == 1:
        a, b = -PACE * pace, PACE * pace
    else:
        stiff, damped = (PACE * pace) ** 2, np.sqrt(2.0) * PACE * pace
        a = np.block([[NONE, ONE], [-stiff, -damped]])
        b = np.vstack([NONE, stiff])
    return NearRest(a, np.hstack([b, b]), np.vstack([out, out]), np.zeros((6, 6)), np.zeros(6))


def integrated(near, part, given, first, period):
    """States along rows by a solver; given: the input at a time after row ``first``."""
    start = np.linalg.solve(near.a, -near.b[:, part] @ given(0.0))
    found, state = [], start
    for row in range(ROWS - first):
        begun = (row - 1) * period
        if row > 0:
            span = (begun, begun + period)

            def slope(t, s):
                return near.a @ s + near.b[:, part] @ given(t)

            state = solve_ivp(slope, span, state, rtol=1e-9, atol=1e-11).y[:, -1]
        found.append(state)
    return np.array(found)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("pace", [ONE, APART], ids=["alike", "apart"])
@pytest.mark.parametrize("turn", [ONE, TURNED], ids=["straight", "turned"])
def test_forces_behind_a_sensor_are_what_a_solver_makes_of_straight_lines(
    values, order, pace, turn
):
    near, first, period = low_pass(order, pace, turn), 3, 0.004

    def given(t):
        rows = first + np.arange(ROWS - first)
        return np.array([np.interp(t, (rows - first) * period, one) for one in values[first:].T])

    states = integrated(near, FORCES, given, first, period)
    found = behind_sensor(near, FORCES, values, first, period)
    assert (found[:first] == values[:first]).all()
    assert found[first:] == pytest.approx(states @ near.c[FORCES].T, abs=1e-6)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("pace", [ONE, APART], ids=["alike", "apart"])
def test_rates_behind_a_sensor_change_by_what_their_slopes_say(values, order, pace):
    """Slopes are held over each period: what is shown is the mean slope of the shown rate."""
    near, period = low_pass(order, pace), 0.004
    finer = np.repeat(values, 400, axis=0)
    fine = behind_sensor(near, RATES, finer, 0, period / 400).reshape(ROWS, 400, 3).mean(axis=1)
    assert behind_sensor(near, RATES, values, 0, period) == pytest.approx(fine, abs=2e-3)


@pytest.mark.parametrize("period", [0.001, 0.002, 0.004, 0.01])
def test_the_firmwares_filter_runs_a_thousand_times_a_second(values, period):
    steps = round(1000 * period)
    b, a = butter(2, 80.0, fs=1000.0)
    settled = np.repeat(values[:1], 4000, axis=0)
    held = lfilter(b, a, np.vstack([settled, np.repeat(values, steps, axis=0)]), axis=0)[4000:]
    means = held.reshape(ROWS, steps, 3).mean(axis=1)
    assert behind_firmware(values, 80.0, period, mean=True) == pytest.approx(means, abs=1e-9)
    at = np.arange(1, ROWS * steps + 1) / steps
    lines = np.column_stack(
        [np.interp(at, np.arange(ROWS + 1), [one[0], *one]) for one in values.T]
    )
    shown = lfilter(b, a, np.vstack([settled, lines]), axis=0)[4000:][steps - 1 :: steps]
    assert behind_firmware(values, 80.0, period, mean=False) == pytest.approx(shown, abs=1e-9)


def test_a_second_half_that_is_more_than_the_first_is_filtered_as_that(values):
    b, a = butter(2, 80.0, fs=1000.0)
    within = values[::-1]
    halves = np.stack([values - 0.5 * within, values + 0.5 * within], axis=1).reshape(-1, 3)
    settled = np.repeat(values[:1], 4000, axis=0)
    held = lfilter(b, a, np.vstack([settled, np.repeat(halves, 2, axis=0)]), axis=0)[4000:]
    found = behind_firmware(values, 80.0, 0.004, True, within)
    assert found == pytest.approx(held.reshape(ROWS, 4, 3).mean(axis=1), abs=1e-9)
