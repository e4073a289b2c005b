"""What the given model says of its constants is information, and no more than that."""

import msgspec
import numpy as np
import pytest

from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import (
    BODY_DOUBT,
    BODY_KEYS,
    MOTOR_KEYS,
    Prior,
    body_prior,
    point_of,
    prior_of,
)
from groundstation.identification.likelihood.problem import Problem
from support.flights import BASE, flown

START = point_of(BASE)


def stating(covariance):
    account = {"names": list(BODY_KEYS), "covariance": covariance.tolist()}
    return msgspec.structs.replace(BASE, fit={"body": {"estimates": account}})


def test_a_model_that_states_nothing_is_believed_to_three_per_cent():
    known = body_prior(msgspec.structs.replace(BASE, fit={}), START)
    assert known.keys == BODY_KEYS
    assert known.centre == {key: START[key] for key in BODY_KEYS}
    errors = np.sqrt(np.diag(np.linalg.inv(known.weight)))
    assert errors == pytest.approx([BODY_DOUBT * START[key] for key in BODY_KEYS])


def test_what_a_model_states_is_added():
    stated = np.diag([(0.04 * START[key]) ** 2 for key in BODY_KEYS])
    errors = np.sqrt(np.diag(np.linalg.inv(body_prior(stating(stated), START).weight)))
    assert errors == pytest.approx([0.05 * START[key] for key in BODY_KEYS])


def test_what_is_not_finite_is_not_stated():
    assert np.isfinite(body_prior(stating(np.full((4, 4), np.nan)), START).weight).all()


def test_the_value_has_the_slope_that_is_said_and_a_model_far_off_hardly_weighs():
    known = body_prior(BASE, START)
    for share in (1.0, 1.02, 1.5):
        point = {**START, "c0": share * START["c0"]}
        step = 1e-6 * START["c0"]
        after, before = (
            known.at({**point, "c0": point["c0"] + sign * step})[2] for sign in (1, -1)
        )
        slope = known.at(point)[1][0]
        assert (after - before) / (2.0 * step) == pytest.approx(-2.0 * slope, rel=1e-3, abs=1e-3)
    near, far = (known.at({**START, "c0": s * START["c0"]})[0][0, 0] for s in (1.0, 1.5))
    assert far < 0.2 * near


@pytest.mark.parametrize(
    ("benched", "pace", "told", "may_be_far_off"),
    [
        (False, 0.8, True, True),
        (False, 0.8, False, False),
        (False, 1.0, True, False),
        (True, 0.8, True, False),
    ],
)
def test_motors_may_be_far_off_where_flights_set_their_pace_and_rows_show_what_they_did(
    benched, pace, told, may_be_far_off
):
    values = np.array([START[key] for key in MOTOR_KEYS])
    account = {"names": list(MOTOR_KEYS), "covariance": np.diag((0.02 * values) ** 2).tolist()}
    fit = {"body": {"motor_pace": {"value": pace}}}
    fit |= {"motor": {"estimates": account}} if benched else {}
    (motors, _), known = prior_of(msgspec.structs.replace(BASE, fit=fit), START, told)
    assert known is benched
    near, far = (
        motors.at({**START, **{key: share * START[key] for key in MOTOR_KEYS}})[0][0, 0]
        for share in (1.0, 1.3)
    )
    assert far == pytest.approx(near) if not may_be_far_off else far < 0.1 * near


def test_a_prior_counts_alike_whatever_else_is_fitted():
    """A constant that is held where it is leaves the others their part of a joint prior."""
    (run, _) = flown(20.0, 1)
    problem = Problem(prepare([run]), BASE, START)
    problem.learn_noise(problem.linear(START, problem.every_key, problem.flights))
    weight = np.array([[4.0, 1.0], [1.0, 9.0]]) * 1e12
    centre = {"c0": 1.01 * START["c0"], "c1": 0.98 * START["c1"]}
    problem.prior = [Prior(("c0", "c1"), centre, weight)]
    both, one = (problem.linear(START, keys, problem.flights) for keys in (("c0", "c1"), ("c0",)))
    whole, part = problem.with_prior(both), problem.with_prior(one)
    assert part.normal[0, 0] == pytest.approx(whole.normal[0, 0])
    assert part.gradient[0] == pytest.approx(whole.gradient[0])
    assert part.value == pytest.approx(whole.value)
    problem.prior = []
    assert problem.with_prior(one).normal[0, 0] < part.normal[0, 0] - 1e12
