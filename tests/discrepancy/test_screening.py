"""Where a joint fit begins: next to where it ends, as the columns of every effect foretell."""

import pytest
from affected_flights import BASE, flown

from groundstation.discrepancy.screening import screen, started
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.parameters import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem

(MISMATCH,) = [one for one in VARIANTS if one.label == "rotor_mismatch.3"]
CLEARLY = 0.05
"""Share of what another start leaves for the fit to gain."""


@pytest.fixture(scope="module")
def seen():
    """(problem, its columns where nothing is in the model) of a flight with a weak rotor."""
    run, _ = flown(20.0, 6, effects={"rotor_mismatch": {"rotor": 3, "excess": -0.03}})
    problem = Problem(prepare([run]), BASE, point_of(BASE))
    problem.settle_filters()
    return problem, screen(problem, problem.start)


def left_by_the_start(problem, start, keys):
    fit = problem.fit(start, keys)
    return problem.fit(start, keys, steps=0).cost - fit.cost


def test_a_fit_of_the_constants_begins_where_it_ends(seen):
    problem, found = seen
    keys = problem.base_keys
    gained = left_by_the_start(problem, found.point, keys)
    assert gained > 10.0
    assert left_by_the_start(problem, found.settled(found.point, keys), keys) < CLEARLY * gained


def test_and_so_does_one_with_an_effect_whose_size_is_known(seen):
    problem, found = seen
    keys = problem.base_keys
    before = problem.fit(found.settled(found.point, keys), keys)
    (one,) = found.scores(keys, [MISMATCH])
    alone = started(before.point, one)
    both = (*keys, *MISMATCH.keys)
    far = left_by_the_start(problem, alone, both)
    assert far > 100.0
    answered = found.with_answer(alone, keys, MISMATCH)
    assert left_by_the_start(problem, answered, both) < CLEARLY * far
