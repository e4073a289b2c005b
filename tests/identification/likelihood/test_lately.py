"""What was evaluated at a point is not evaluated again while a search asks of it."""

import numpy as np
import pytest

from groundstation.dynamics.model import model_vehicle
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood import linear
from groundstation.identification.likelihood.motion import VARIANTS, Frame, point_of
from groundstation.identification.likelihood.problem import Problem
from support.flights import BASE, flown

MOMENT = next(one for one in VARIANTS if one.effect == "velocity_moment").keys[0]
START, KEYS = point_of(BASE), ("c0", MOMENT, "a0", "thrust_per_mass")


@pytest.fixture(scope="module")
def flights():
    return prepare([flown(10.0, 1)[0]])


@pytest.fixture
def evaluated(monkeypatch):
    """The points at which flights were evaluated, in order."""
    points = []

    class Counted(linear.Evaluation):
        def __init__(self, flight, frame, point, channels=range(9)):
            points.append(dict(point))
            super().__init__(flight, frame, point, channels)

    monkeypatch.setattr(linear, "Evaluation", Counted)
    return points


def assert_same(one, other):
    assert (one.keys, one.point) == (other.keys, other.point)
    for a, b in zip(one.spectra, other.spectra, strict=True):
        for field in ("residual", "columns", "place", "lasting"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    for a, b in zip(one.verticals, other.verticals, strict=True):
        assert (a.residual, a.sigma) == (b.residual, b.sigma)
        np.testing.assert_array_equal(a.slopes, b.slopes)


@pytest.mark.parametrize(
    ("asked", "times"), [([()], 1), ([("a0",), ("c0",)], 3), ([KEYS[::-1]], 1)]
)
def test_a_point_says_the_same_whatever_was_asked_of_it_before(flights, evaluated, asked, times):
    lately, frame = linear.Lately(), Frame(model_vehicle(BASE), BASE.motors)
    for keys in asked:
        lately.linearise(flights, frame, START, keys)
    found = lately.linearise(flights, frame, START, KEYS)
    assert len(evaluated) == times
    assert_same(found, linear.linearise(flights, frame, START, KEYS))


def test_what_the_caller_does_to_columns_changes_none_that_is_kept(flights):
    lately, frame = linear.Lately(), Frame(model_vehicle(BASE), BASE.motors)
    for s in lately.linearise(flights, frame, START, KEYS).spectra:
        np.multiply(s.columns, 2.0, out=s.columns)
    again = lately.linearise(flights, frame, START, KEYS)
    assert_same(again, linear.linearise(flights, frame, START, KEYS))


def test_columns_of_every_effect_are_not_kept(flights, evaluated, monkeypatch):
    monkeypatch.setattr(linear, "KEPT_COLUMNS", 1)
    lately, frame = linear.Lately(), Frame(model_vehicle(BASE), BASE.motors)
    for _ in range(2):
        found = lately.linearise(flights, frame, START, KEYS)
    assert len(evaluated) == 2
    assert_same(found, linear.linearise(flights, frame, START, KEYS))


def test_a_fit_evaluates_each_point_once_and_the_last_one_is_known_then(flights, evaluated):
    problem = Problem(flights, BASE, START)
    problem.learn_noise(problem.linear(START, problem.every_key, flights))
    fit = problem.fit({**START, MOMENT: 5.0}, ("c0", "c1", MOMENT))
    evaluated.clear()
    problem.linear(fit.point, fit.keys, flights)
    problem.fit(fit.point, fit.keys, steps=1)
    assert fit.point not in evaluated
