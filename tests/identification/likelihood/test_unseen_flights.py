"""Flights that no fit saw: what an effect promises there is what it does there."""

from dataclasses import replace
from functools import cache

import pytest

from groundstation.discrepancy.screening import settle, started
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem
from groundstation.identification.likelihood.spectra import quadratic
from groundstation.identification.runs import flights_of
from support.flights import CARRYING_GAINS, recorded

MODEL = vehicle_model(BUILT_IN["crazyflie1"])
SPIN_UP = next(one for one in VARIANTS if one.effect == "rotor_acceleration_torque")
EARLY = slice(2500, 5000)
"""Rows before the yaw steps."""


@cache
def flown():
    effects = {"rotor_inertia": {"rotor_inertia_kg_m2": 6e-8}}
    samples, _ = recorded(30.0, seed=5, plant="reduced", gains=CARRYING_GAINS, effects=effects)
    (run,) = flights_of(samples, "flight")
    return run


@cache
def searched():
    """A problem on a craft whose rotors have an inertia, and points without and with it."""
    problem = Problem(prepare([flown()]), MODEL, point_of(MODEL))
    problem.settle_filters()
    plain = settle(problem).without_effects(problem.base_keys)
    (one,) = plain.scores(problem.base_keys, [SPIN_UP])
    before = problem.fit(plain.point, problem.base_keys)
    after = problem.fit(started(plain.point, one), (*problem.base_keys, *SPIN_UP.keys))
    return problem, [before.point, after.point]


def gained_and_promised(flights):
    problem, points = searched()
    away, near = (problem.linear(point, (), flights) for point in points)
    pairs = zip(away.spectra, near.spectra, strict=True)
    changes = [replace(s, residual=s.residual - t.residual) for s, t in pairs]
    gained, rest, promised = (
        quadratic(spectra, problem.noise, verticals, 0).value
        for spectra, verticals in (
            (away.spectra, away.verticals),
            (near.spectra, near.verticals),
            (changes, ()),
        )
    )
    return gained - rest, promised


def test_a_fit_keeps_its_promise_on_its_own_rows():
    problem, _ = searched()
    gained, promised = gained_and_promised(problem.flights)
    assert gained == pytest.approx(promised, rel=0.1)


def test_rows_without_yaw_steps_promise_less_than_their_number_and_keep_it():
    problem, _ = searched()
    _, whole = gained_and_promised(problem.flights)
    early = prepare([flown()[EARLY]])
    gained, promised = gained_and_promised(early)
    rows = (early[0].last - early[0].first) / (problem.flights[0].last - problem.flights[0].first)
    assert promised < 0.2 * rows * whole
    assert gained == pytest.approx(promised, rel=0.1)
