"""What leaves a model again."""

import pytest

from groundstation.discrepancy.proof import Reason
from groundstation.discrepancy.search import SearchState, drop_failing
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem
from support.flights import BASE, flown

DAMPING = next(one for one in VARIANTS if one.effect == "rate_damping")
DELAY = next(one for one in VARIANTS if one.effect == "dead_time")


@pytest.fixture
def search():
    """Of two flights with a damping, before anything joined."""
    flights = prepare([flown(15.0, seed, "rate_damping")[0] for seed in (1, 2)])
    problem = Problem(flights, BASE, point_of(BASE))
    problem.learn_noise(problem.linear(problem.start, problem.every_key, problem.flights))
    return SearchState(problem, (), [DAMPING, DELAY], lambda what, share: None)


def test_what_fails_beside_the_others_leaves_for_good_and_they_are_fitted_without_it(search):
    both = [DAMPING, DELAY]
    keys = (*search.base_keys, *(key for one in both for key in one.keys))
    search.now = search.problem.fit(search.problem.start, keys)
    search.accepted = search.weighed(search.now, both)
    assert drop_failing(search)
    assert [one.variant for one in search.accepted] == [DAMPING]
    assert search.refused[DELAY.label].reason is Reason.INSIGNIFICANT
    assert search.able() == []
    assert not {*DELAY.keys} & {*search.now.keys}
    assert not drop_failing(search)


def test_where_nothing_joined_nothing_is_asked(search):
    assert not drop_failing(search)
