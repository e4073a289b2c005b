"""Rows that come slower than the controller sets the motors hold one of several settings."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.body import fit_body
from groundstation.identification.body_setup import folds, settings_a_row, unseen_delay_s
from groundstation.identification.flight import quicker, stretches_of
from groundstation.identification.runs import CHANNELS, runs_of
from support.flights import recorded

WITH = ("dead_time", "rotor_acceleration_torque")
VEHICLE = BUILT_IN["crazyflie21"]


@pytest.fixture(scope="module")
def run():
    """A faithful flight of today's craft, with every setting of its motors."""
    samples, _ = recorded(40.0, craft="crazyflie21", plant="faithful", seed=11)
    (whole,) = runs_of(samples, "flight")
    return whole


def fitted(run, every, first, motor=VEHICLE.motor, motor_known=True):
    """One row in ``every`` fitted; c0, c1 and their errors over the truth."""
    rows = {name: getattr(run, name)[first::every] for name in CHANNELS}
    slow = replace(run, period_s=every * run.period_s, **rows)
    fit = fit_body(stretches_of([slow], motor), VEHICLE, WITH, motor_known=motor_known)
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


@pytest.mark.parametrize(("every", "first"), [(2, 0), (2, 1), (4, 0), (10, 1)])
def test_yaw_is_not_told_where_each_row_holds_the_same_of_two_alternating_settings(
    run, every, first
):
    """What alternates folds onto the command: c2 seems 60 % smaller or 30 % larger."""
    fit, _, _ = fitted(run, every, first)
    truth, place = VEHICLE.body_constants[2], fit.estimates.names.index("c2")
    found, error = fit.estimates.values[place], fit.estimates.stderr[place]
    assert abs(found - truth) < 1.96 * error
    assert "alternates" in fit.not_identified["c2"]
    assert fit.body.c2 == truth


@pytest.mark.parametrize("every", [1, 3, 5])
def test_yaw_is_told_where_rows_hold_either_of_two_alternating_settings_in_turn(run, every):
    fit, _, _ = fitted(run, every, 0)
    assert not fit.not_identified
    assert fit.body.c2 == pytest.approx(VEHICLE.body_constants[2], rel=0.03)


@pytest.mark.parametrize(
    ("rows_hz", "does"), [(250.1, True), (252, False), (100, False), (62.5, True)]
)
def test_only_rows_in_step_with_the_settings_fold(run, rows_hz, does):
    assert folds(replace(run, period_s=1.0 / rows_hz)) == does


def test_rows_with_every_setting_cost_nothing(run):
    fit, off, error = fitted(run, 1, 0)
    assert np.abs(off).max() < 0.03
    assert error.max() < 0.01
    assert not any("one in" in line for line in fit.warnings)


@pytest.mark.parametrize("first", [0, 1])
def test_motors_are_believed_to_be_the_profiles_where_no_row_shows_how_fast_they_answer(run, first):
    """The likelihood alone makes them 0.7 and 1.4 times as fast, sure to 3 %, and c0 wrong by 42
    and -28 %: each phase of the settings has a bias of its own."""
    fit, off, error = fitted(run, 5, first, motor_known=False)
    assert np.abs(off).max() < 0.25
    assert (np.abs(off) < 1.96 * error).all()
    assert np.abs(np.log(fit.pace[0])) < 1.96 * fit.pace[1]
    (said,) = (line for line in fit.warnings if "2 to 20 Hz" in line)
    assert "rows do not show every setting" in said


@pytest.mark.parametrize(("every", "least"), [(1, 1.36), (2, 1.25)])
def test_motors_that_differ_are_found_where_rows_show_how_fast_they_answer(run, every, least):
    fit, off, error = fitted(run, every, 0, quicker(VEHICLE.motor, 1 / 1.4), motor_known=False)
    assert least < fit.pace[0] < 1.5
    assert (np.abs(off) < 1.96 * error).all()


def of_both_settings(run, scale=1.0, told=True):
    """250 rows a second, the motors' settings in each as mean and step."""
    first, second = run.duty[1:-1:2], run.duty[2::2]
    step = second - first if told else np.full_like(first, np.nan)
    rows = {name: getattr(run, name)[2::2] for name in CHANNELS}
    rows |= {"duty": first * scale + 0.5 * (second - first), "duty_step": step}
    return replace(run, period_s=2 * run.period_s, **rows)


@pytest.mark.parametrize(("slower", "least", "most"), [(1.0, 1.0, 1.0), (1.4, 1.3, 1.5)])
def test_a_delay_that_rows_of_both_settings_leave_open_is_not_taken_for_other_motors(
    run, slower, least, most
):
    motor = quicker(VEHICLE.motor, 1 / slower)
    stretches = stretches_of([of_both_settings(run)], motor)
    fit = fit_body(stretches, VEHICLE, WITH, motor_known=False)
    assert least <= fit.pace[0] <= most
    assert abs(np.log(fit.pace[0] / slower)) < 1.96 * fit.pace[1] < 0.1
    assert fit.pace[1] > 0.02  # a millisecond of delay is worth a motor 3 % slower


@pytest.mark.parametrize("told", [True, False])
def test_rows_that_tell_both_settings_hold_all_there_are_at_whatever_voltage(run, told):
    """Two settings at one voltage make a mean that lies anywhere between the steps of a PWM."""
    slow = of_both_settings(run, 1.0003, told)
    assert settings_a_row(slow) == pytest.approx(1.0 if told else 2.0, rel=1e-3)
    assert unseen_delay_s(slow) == pytest.approx(0.0 if told else 2e-3, abs=1e-5)
