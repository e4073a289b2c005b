"""Measured rotor speeds drive predictions where PWM does not tell them, and that is said."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.comparison import consistency as rotor_drive
from groundstation.comparison.comparison import Judged, compare
from groundstation.comparison.gap import motion_of
from groundstation.dynamics.model import EffectTerm, Estimate
from groundstation.identification.flight import flights_in
from groundstation.identification.runs import without_gaps
from support.flights import BASE, flown

BEAT_HZ = 3.0


@pytest.fixture(scope="module")
def measured():
    """A flight, each motor of which is moved by itself, with rotor speeds: the motors' law, stepped
    a hundred times a row."""
    run = flown(15.0, 4)[0]
    turns = np.sin(2.0 * np.pi * run.time_s[:, None] * np.array([2.1, 3.7, 5.3, 7.1]))
    run = replace(run, duty=run.duty + 0.01 * turns)
    motor, steps = BASE.motor, 100
    speed = np.empty_like(run.duty)
    now = np.array([motor.steady_rev_s(1000.0 * run.supply_v[0] * duty) for duty in run.duty[0]])
    for i, (duty, supply_v) in enumerate(zip(run.duty, run.supply_v, strict=True)):
        for _ in range(steps):
            slope = motor.a0 * 1000.0 * supply_v * duty - motor.a1 * now - motor.a2 * now**2
            now = now + run.period_s / steps * slope
        speed[i] = now
    return replace(run, rotor_rev_s=speed + np.random.default_rng(1).normal(0.0, 0.2, speed.shape))


def driven_by_speeds(run, model):
    return rotor_drive.driven_by_speeds(run, model, motion_of(without_gaps(run), model))


def beating(run, size, signs=(-1.0, 1.0, -1.0, 1.0)):
    """PWM that shows a slow beat which the rotors do not follow."""
    beat = size * np.sin(2.0 * np.pi * BEAT_HZ * run.time_s)
    return replace(run, name="beaten", duty=run.duty + beat[:, None] * np.array(signs))


def test_a_flight_whose_pwm_tells_the_speeds_is_left_as_it_is(measured):
    for run in (measured, beating(measured, 0.001)):
        same, why = driven_by_speeds(run, BASE)
        assert same is run
        assert not why


def test_a_beat_that_no_rotor_follows_is_told_and_the_true_settings_come_back(measured):
    beaten = beating(measured, 0.012)
    run, why = driven_by_speeds(beaten, BASE)
    assert "beaten: PWM and battery voltage do not tell how its rotors turned" in why
    assert "what drives yaw is off" in why
    (air,) = flights_in(measured)
    flying = slice(air.first, air.last)
    slow = np.ones(25) / 25.0  # the speeds' noise is in the settings, as fast as it comes
    for rotor in range(4):
        off = np.convolve((run.duty - measured.duty)[flying, rotor], slow, "valid")
        beat = np.convolve((beaten.duty - measured.duty)[flying, rotor], slow, "valid")
        assert off[50:-50].std() < 0.15 * beat[50:-50].std()


def test_speeds_of_other_motors_are_no_reason_to_doubt_the_pwm(measured):
    crossed = replace(measured, rotor_rev_s=measured.rotor_rev_s[:, [1, 2, 3, 0]])
    assert driven_by_speeds(crossed, BASE)[0] is crossed


def test_speeds_that_never_change_are_no_reason_either(measured):
    for speeds in (np.full_like(measured.duty, 200.0), measured.duty[:, :1] * np.ones(4)):
        stuck = replace(beating(measured, 0.012), rotor_rev_s=speeds)
        assert driven_by_speeds(stuck, BASE)[0] is stuck


def test_behind_a_known_effect_of_the_supply_settings_are_not_made(measured):
    term = EffectTerm("supply_sag", {"resistance_ohm": Estimate(0.1)})
    model = msgspec.structs.replace(BASE, effects=(term,))
    beaten = beating(measured, 0.012)
    assert driven_by_speeds(beaten, model)[0] is beaten


def test_the_flight_stays_one(measured):
    beaten = beating(measured, 0.012)
    run, _ = driven_by_speeds(beaten, BASE)
    flights = [[(one.first, one.last) for one in flights_in(each)] for each in (beaten, run)]
    assert flights[0] == flights[1]


def test_lost_rows_stay_lost(measured):
    duty, gyro = measured.duty.copy(), measured.gyro.copy()
    speed = measured.rotor_rev_s.copy()
    duty[3000:3004] = gyro[3000:3004] = speed[3000:3004] = np.nan
    torn = replace(beating(measured, 0.012), rotor_rev_s=speed, gyro=gyro)
    torn = replace(torn, duty=np.where(np.isfinite(duty), torn.duty, np.nan))
    run, why = driven_by_speeds(torn, BASE)
    assert why
    assert np.isnan(run.duty[3000:3004]).all()
    assert np.isfinite(run.duty[:3000]).all()


def test_a_comparison_says_it_once_and_predicts_by_the_speeds(measured):
    beaten = beating(measured, 0.012)
    untouched = compare([measured], BASE)
    assert not untouched.warnings
    parts = [Judged(beaten, 0, 4000), Judged(beaten, 4000, len(beaten))]
    found = compare(parts, BASE, untouched.black_box)
    assert list(found.warnings) == ["beaten"]
    assert found.gap < 1.1 * untouched.gap
    deaf = replace(beaten, rotor_rev_s=np.full_like(beaten.duty, np.nan))
    assert compare([deaf], BASE, untouched.black_box).gap > 1.5 * untouched.gap
    assert found.with_model(BASE).warnings == found.warnings
