"""Which changes of the given model's constants stand, and what they are said to mean."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from groundstation.discrepancy.acceptance import (
    EVERY_HZ,
    KEEP,
    base_changes,
    confirmation,
    unconfirmed,
)
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import BODY_KEYS, MOTOR_KEYS, point_of
from groundstation.identification.likelihood.problem import Fit, Problem
from groundstation.identification.runs import flights_of
from groundstation.recording.formats import open_recording
from support.flights import BASE, flown

RECORDINGS = Path(__file__).parents[2] / "recordings"
KEYS = (*BODY_KEYS, *MOTOR_KEYS)


@pytest.fixture(scope="module")
def problem():
    return Problem(prepare([flown(12.0, 3)[0]]), BASE, point_of(BASE))


def changed(problem, **factors):
    point = {**problem.start, **{key: problem.start[key] * by for key, by in factors.items()}}
    fit = Fit(point, KEYS, 0.0, None)
    return {one.name: one for one in base_changes(problem, fit, point, {}, KEYS)}


def test_more_thrust_at_the_same_speeds_is_a_lighter_craft(problem):
    change = changed(problem, thrust_per_mass=1.25)["thrust_per_mass"]
    assert change.percent == pytest.approx(25.0)
    assert change.words == (
        "thrust_per_mass +25 %: the craft is 20 % lighter or its rotors stronger"
    )


def test_more_thrust_of_rotors_that_turn_slower_is_told_by_what_they_push(problem):
    volts = 3000.0
    fast, slow = (
        motor.steady_rev_s(volts)
        for motor in (BASE.motor, msgspec.structs.replace(BASE.motor, a0=0.85 * BASE.motor.a0))
    )
    made_up = (fast / slow) ** 2
    change = changed(problem, thrust_per_mass=made_up, a0=0.85)["thrust_per_mass"]
    assert change.percent > 20.0
    assert change.words.endswith("at the same PWM they push the craft as much as before")
    more = changed(problem, thrust_per_mass=1.3 * made_up, a0=0.85)["thrust_per_mass"]
    pushed = float(more.words.removesuffix(" % more").rpartition("they push the craft ")[2])
    assert pushed == pytest.approx(30.0, abs=2.0)


def test_what_pushes_beside_the_rotors_makes_no_other_speeds(problem):
    point = {**problem.start, "thrust_per_mass": 1.1 * problem.start["thrust_per_mass"]}
    fit = Fit({**point, "ground_effect.gain": 1.0}, KEYS, 0.0, None)
    (change,) = base_changes(problem, fit, fit.point, {}, KEYS)
    assert "lighter" in change.words


def test_a_change_of_another_constant_says_nothing_of_speeds(problem):
    change = changed(problem, c0=0.9)["c0"]
    assert change.words.startswith("c0 -10 %: roll answers less")


def with_c2(problem, factor):
    return Fit({**problem.start, "c2": factor * problem.start["c2"]}, ("c2",), 0.0, np.eye(1))


@pytest.mark.parametrize("flight", ["trefoil", "figure8"])
def test_slow_air_alone_does_not_change_the_drag_of_real_rotors(flight):
    """In slow air torque answers to moments, so that a third of the drag is likelier on all
    frequencies together; a propeller has no such drag, and where the craft is steered the flight
    says so."""
    model = vehicle_model(BUILT_IN["crazyflie21"])
    samples = open_recording(RECORDINGS / f"nanobench_{flight}.mcap").samples
    problem = Problem(prepare(flights_of(samples, flight)), model, point_of(model))
    bent = with_c2(problem, 0.3)
    assert confirmation(problem, bent.point, 2, EVERY_HZ) > 3.0 * KEEP
    assert unconfirmed(problem, bent) == ("c2",)


def test_a_drag_of_the_rotors_that_is_another_stands():
    start = point_of(BASE)
    flights = prepare([flown(30.0, 3)[0]])
    other = Problem(flights, BASE, {**start, "c2": 0.7 * start["c2"]})
    assert unconfirmed(other, with_c2(other, 1.0 / 0.7)) is None
