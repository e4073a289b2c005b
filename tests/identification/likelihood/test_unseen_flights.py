"""What rotors' inertia promises on flights that no fit saw; and two torques share one inertia."""

from dataclasses import replace
from functools import cache

import pytest

from groundstation.discrepancy.screening import settle, started
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem, quadratic
from groundstation.identification.runs import flights_of
from support.flights import CARRYING_GAINS, recorded

MODEL = vehicle_model(BUILT_IN["crazyflie1"])
SPIN_UP = next(one for one in VARIANTS if one.effect == "rotor_acceleration_torque")
INERTIA = 6e-8
YAW, TILT = (f"rotor_{of}_torque.rotor_inertia_kg_m2" for of in ("acceleration", "gyroscopic"))
EARLY = slice(2500, 5000)
"""Rows before the yaw steps."""


@cache
def flown():
    effects = {"rotor_inertia": {"rotor_inertia_kg_m2": INERTIA}}
    samples, _ = recorded(30.0, seed=5, plant="reduced", gains=CARRYING_GAINS, effects=effects)
    (run,) = flights_of(samples, "flight")
    return run


@cache
def begun():
    """A problem on a craft whose rotors have an inertia, and its fit without effects."""
    problem = Problem(prepare([flown()]), MODEL, point_of(MODEL))
    problem.settle_filters()
    return problem, settle(problem).without_effects(problem.base_keys)


@cache
def searched():
    """That problem, and points without and with the inertia."""
    problem, plain = begun()
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


def test_the_torques_of_accelerating_and_of_tilting_rotors_have_one_inertia():
    problem, plain = begun()
    point = dict(plain.point)
    torques = [one for one in VARIANTS if one.keys[0] in (YAW, TILT)]
    for one in plain.scores(problem.base_keys, torques):
        point = started(point, one)
    both = problem.fit(point, (*problem.base_keys, YAW, TILT))
    assert both.point[YAW] == pytest.approx(both.point[TILT], rel=0.01)
    assert abs(both.point[YAW] - INERTIA) < 4.0 * both.stderr()[YAW] < 0.2 * INERTIA
