"""Rows are told apart by what the craft does in them."""

import numpy as np
import pytest

from groundstation.comparison.gap import NEAR_GROUND_S, WHOLE, motion_of, regimes_of
from groundstation.identification.flight import velocity_of
from groundstation.identification.runs import flights_of
from support.flights import BASE, CARRYING_GAINS, judged, recorded, truth_of
from support.flights import compared as flights


@pytest.fixture(scope="module")
def run_and_truth():
    samples, truth = recorded(40.0, seed=5, plant="reduced", gains=CARRYING_GAINS)
    (run,) = flights_of(samples)
    return run, truth_of(samples, truth)


def test_only_rows_in_the_air_belong_to_a_regime(run_and_truth):
    run, truth = run_and_truth
    motion = motion_of(run, BASE)
    for name, mask in regimes_of(run, motion).items():
        assert not (mask & ~motion.flown).any(), name
    height = truth["position_m"][:, 2]
    assert (height[motion.flown] > 0.0).all()
    assert motion.flown[height > 0.1].mean() > 0.97


def test_near_ground_is_the_time_after_the_take_off(run_and_truth):
    run, truth = run_and_truth
    mask = regimes_of(run, motion_of(run, BASE))["near ground"]
    assert mask.sum() * run.period_s == pytest.approx(NEAR_GROUND_S, abs=0.05)
    assert truth["position_m"][mask, 2].max() < 1.0


def test_the_leaky_velocity_follows_the_true_one_while_it_changes(run_and_truth):
    run, truth = run_and_truth
    flown = motion_of(run, BASE).flown
    speed = np.linalg.norm(velocity_of(run)[:, :2], axis=1)[flown]
    true = np.linalg.norm(truth["velocity_m_s"][:, :2], axis=1)[flown]
    assert np.corrcoef(speed, true)[0, 1] > 0.6


def test_climb_and_descent_have_the_sign_of_the_true_vertical_speed(run_and_truth):
    run, truth = run_and_truth
    regimes = regimes_of(run, motion_of(run, BASE))
    upward = truth["velocity_m_s"][:, 2]
    assert upward[regimes["climb"]].mean() > 0.1
    assert upward[regimes["descent"]].mean() < -0.1


def test_a_fast_turn_counts_as_such_and_not_as_hover(run_and_truth):
    run, _ = run_and_truth
    regimes = regimes_of(run, motion_of(run, BASE))
    fast = np.abs(run.gyro[:, 2])
    turning = regimes["high yaw rate"]
    assert fast[turning].min() > np.median(fast[regimes[WHOLE]])
    assert not (turning & regimes["hover"]).any()


def test_saturation_and_low_battery_are_absent_from_an_easy_flight_and_seen_in_a_hard_one():
    easy = regimes_of(judged().errors[0].run, judged().errors[0].motion)
    assert not easy["saturation"].any()
    assert not easy["low battery"].any()
    (tired,) = flights(7, charge=0.05, land_when_low=False, seconds=20.0)
    regimes = regimes_of(tired, motion_of(tired, BASE))
    assert regimes["low battery"].any()
    assert (tired.supply_v[regimes["low battery"]] < 3.3).all()
