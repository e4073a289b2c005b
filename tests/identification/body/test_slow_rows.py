"""Rows that come slower than the controller sets the motors hold one of several settings."""

from dataclasses import replace

import numpy as np
import pytest
from stand_in_flights import recorded

from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.body.certainty import settings_a_row, unseen_delay_s
from groundstation.identification.body.fit import fit_body
from groundstation.identification.runs import CHANNELS, runs_of
from groundstation.identification.stretches import stretches_of

WITH = ("dead_time", "rotor_acceleration_torque")
VEHICLE = BUILT_IN["crazyflie21"]


@pytest.fixture(scope="module")
def run():
    """A faithful flight of today's craft, with every setting of its motors."""
    samples, _ = recorded(40.0, craft="crazyflie21", plant="faithful", seed=11)
    (whole,) = runs_of(samples, "flight")
    return whole


def fitted(run, every, first):
    """One row in ``every`` fitted with a known motor; c0, c1 and their errors over the truth."""
    rows = {name: getattr(run, name)[first::every] for name in CHANNELS}
    slow = replace(run, period_s=every * run.period_s, **rows)
    fit = fit_body(stretches_of([slow], VEHICLE.motor), VEHICLE, WITH)
    truth = np.array(VEHICLE.body_constants[:2])
    found, error = fit.estimates.values[:2], fit.estimates.stderr[:2]
    return fit, found / truth - 1.0, error / truth


@pytest.mark.parametrize(("every", "first"), [(2, 0), (2, 1), (5, 0), (5, 1)])
def test_constants_lie_in_their_stated_intervals_whichever_setting_the_rows_hold(run, every, first):
    fit, off, error = fitted(run, every, first)
    assert (np.abs(off) < 1.96 * error).all()
    assert error.max() < 0.05 * every
    (warning,) = (line for line in fit.warnings if f"one in {every} of" in line)
    assert warning.startswith(f"{500 / every:.0f} rows a second")


def test_rows_with_every_setting_cost_nothing(run):
    fit, off, error = fitted(run, 1, 0)
    assert np.abs(off).max() < 0.03
    assert error.max() < 0.01
    assert not any("one in" in line for line in fit.warnings)


@pytest.mark.parametrize("told", [True, False])
def test_rows_that_tell_both_settings_hold_all_there_are_at_whatever_voltage(run, told):
    """Two settings at one voltage make a mean that lies anywhere between the steps of a PWM."""
    first, second = run.duty[1:-1:2], run.duty[2::2]
    step = second - first if told else np.full_like(first, np.nan)
    rows = {name: getattr(run, name)[2::2] for name in CHANNELS}
    rows |= {"duty": first * 1.0003 + 0.5 * (second - first), "duty_step": step}
    slow = replace(run, period_s=2 * run.period_s, **rows)
    assert settings_a_row(slow) == pytest.approx(1.0 if told else 2.0, rel=1e-3)
    assert unseen_delay_s(slow) == pytest.approx(0.0 if told else 2e-3, abs=1e-5)
