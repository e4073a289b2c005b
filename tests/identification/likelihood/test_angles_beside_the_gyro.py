"""Reported angles beside the gyro's: lost rows, a flight's own offset, what was read between."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from groundstation.discrepancy.screening import screen
from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.evaluation import ATTITUDE
from groundstation.identification.likelihood.linear import linearise
from groundstation.identification.likelihood.motion import TIMING, point_of
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.runs import flights_of
from support.flights import recorded

SLOW_HZ = 2.0
LATE = 4000
"""A row in flight."""
STRENGTH = "attitude_filter_lean.strength"
COUNT_RAD_S = np.radians(2000.0 / 32768.0)


@cache
def run():
    """A flight whose angles come from the gyro by a Mahony filter, with vibration in the gyro."""
    return flown("faithful")


@cache
def flown(plant):
    leaning = {"attitude_filter_lean": {"strength": 1.0}}
    (one,) = flights_of(recorded(14.0, seed=5, plant=plant, effects=leaning)[0], "flight")
    return one


def problem_of(*runs):
    lean = EffectTerm("attitude_filter_lean", {"strength": Estimate(1.0)})
    model = msgspec.structs.replace(vehicle_model(load_vehicle("crazyflie1")), effects=(lean,))
    return Problem(prepare(runs), model, point_of(model) | {"attitude_timing": 1.0})


def slow_power(runs):
    """Of the angles' residuals, by axis."""
    problem = problem_of(*runs)
    linear = linearise(problem.flights, problem.frame, problem.start, ())
    return {
        s.channel: float((s.weight * s.residual**2)[s.hz < SLOW_HZ].sum())
        for s in linear.spectra
        if s.channel >= ATTITUDE
    }


def without_rows(rows):
    gyro, attitude, force = (
        getattr(run(), name).copy() for name in ("gyro", "attitude", "accelerometer")
    )
    for channel in (gyro, attitude, force):
        channel[rows] = np.nan
    return replace(run(), gyro=gyro, attitude=attitude, accelerometer=force)


@pytest.mark.parametrize("lost", [1, 2, 5])
def test_lost_rows_leave_no_jump_between_gyro_and_angles(lost):
    whole, holed = slow_power([run()]), slow_power([without_rows(slice(LATE, LATE + lost))])
    for axis, power in holed.items():
        assert power < 3.0 * whole[axis]


def test_an_offset_of_one_count_that_a_flight_has_is_no_surprise_and_a_large_one_is():
    problem = problem_of(run())
    screen(problem, problem.start)

    def cost(flights):
        return problem.with_prior(problem.linear(problem.start, (), flights)).value

    def surprise(offset):
        other = prepare([replace(run(), gyro=run().gyro + offset)])
        return cost(other) - cost(problem.flights)

    assert surprise(COUNT_RAD_S * np.array([1.0, -1.0, 1.0])) < 20.0
    assert surprise(np.radians([1.5, -1.0, 2.0])) > 500.0


def between_rows():
    """Every second row of such a flight, without vibration: with the angles that were read half a
    row before and half a row after."""
    run = flown("reduced")
    turned = np.flatnonzero((run.attitude[1:] != run.attitude[:-1]).any(axis=1)) + 1
    rows = np.arange(1 + turned[-1] % 2, len(run) - 1, 2)
    slow = {
        name: getattr(run, name)[rows]
        for name in ("duty", "supply_v", "gyro", "accelerometer", "rotor_rev_s", "debug_s")
    }
    angles = 0.5 * (run.attitude[rows - 1] + run.attitude[rows + 1])
    return replace(run, period_s=2.0 * run.period_s, attitude=angles, **slow)


def fitted(problem, **start):
    keys = (TIMING, STRENGTH)
    point = problem.start | {TIMING: start["timing"], STRENGTH: start["strength"]}
    return problem.fit(point, keys)


def test_angles_read_between_rows_tell_the_filter_that_made_them():
    problem = problem_of(between_rows())
    screen(problem, problem.start)
    found = fitted(problem, timing=0.0, strength=0.1)
    assert found.point[TIMING] == pytest.approx(1.0, abs=0.03)
    assert found.point[STRENGTH] == pytest.approx(1.0, abs=0.03)


def test_a_fit_that_meets_a_bound_ends_at_the_best_there_is_along_it(monkeypatch):
    problem = problem_of(run())
    screen(problem, problem.start)
    monkeypatch.setattr("groundstation.identification.likelihood.problem.TIMING_BOUNDS", (0.0, 0.2))
    found = fitted(problem, timing=0.1, strength=0.1)
    assert found.point[TIMING] == 0.2
    beside = [
        problem.fit(found.point | {STRENGTH: found.point[STRENGTH] + step}, (), steps=0).cost
        for step in (-0.03, 0.03)
    ]
    assert found.cost < min(beside)


@pytest.mark.parametrize(("timing", "strength"), [(0.0, 0.0), (1.9, -1.0), (-0.9, 1.4)])
def test_a_fit_is_never_worse_than_its_start(timing, strength):
    problem = problem_of(run())
    screen(problem, problem.start)
    start = problem.start | {TIMING: timing, STRENGTH: strength}
    begun = problem.fit(start, (TIMING, STRENGTH), steps=0)
    assert begun.point == start
    assert problem.fit(start, (TIMING, STRENGTH)).cost <= begun.cost
