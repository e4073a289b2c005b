"""Reported angles beside the gyro's: rows that were lost, and an offset that each flight has."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from stand_in_flights import recorded

from groundstation.discrepancy.screening import screen
from groundstation.dynamics.model import EffectTerm, Estimate, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.parameters import point_of
from groundstation.identification.likelihood.problem import Problem, linearise
from groundstation.identification.likelihood.residuals import ATTITUDE
from groundstation.identification.recordings import flights_of

SLOW_HZ = 2.0
LATE = 4000
"""A row in flight."""
COUNT_RAD_S = np.radians(2000.0 / 32768.0)


@cache
def run():
    """A flight whose angles come from the gyro by a Mahony filter, with vibration in the gyro."""
    (one,) = flights_of(recorded(14.0, seed=5, plant="faithful")[0], "flight")
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

    def surprise(offset):
        other = prepare([replace(run(), gyro=run().gyro + offset)])
        return (
            problem.cost(problem.start, other)[0] - problem.cost(problem.start, problem.flights)[0]
        )

    assert surprise(COUNT_RAD_S * np.array([1.0, -1.0, 1.0])) < 20.0
    assert surprise(np.radians([1.5, -1.0, 2.0])) > 500.0
