"""A pendulum is looked for at every length: columns at one say nothing of another."""

import pytest

from groundstation.discrepancy.acceptance import SCREENED, refusal
from groundstation.discrepancy.screening import screen, started, tried
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem
from support.flights import BASE, flown

(LOAD,) = [one for one in VARIANTS if one.effect == "slung_load"]
LENGTH = "slung_load.length_m"


def looked_for(effects):
    """(problem, what the load of each length would explain, and that length)"""
    run, _ = flown(30.0, 5, effects=effects)
    problem = Problem(prepare([run]), BASE, point_of(BASE))
    problem.settle_filters()
    screen(problem, problem.start)
    (found,) = tried(problem, problem.start, problem.base_keys, [LOAD])
    return problem, [(one, at[LENGTH]) for one, at in found]


@pytest.mark.parametrize("length_m", [0.15, 0.7])
def test_a_load_is_found_whatever_its_length(length_m):
    problem, found = looked_for({"slung_load": {"percent": 8.0, "length_m": length_m}})
    assert len(found) == len(LOAD.tried.parameter.tried)
    best, at = max(found, key=lambda one: one[0].drop)
    assert refusal(SCREENED, best) is None
    assert at == pytest.approx(length_m, rel=0.2)
    point = started(problem.start, best, {LENGTH: at})
    for _ in range(2):  # the noise is another once the load is in the model
        fit = problem.fit(point, (*problem.base_keys, *LOAD.keys))
        point = screen(problem, fit.point, LOAD.keys).point
    assert point[LENGTH] == pytest.approx(length_m, rel=0.02)
    assert point["slung_load.percent"] == pytest.approx(8.0, rel=0.1)


def test_a_craft_without_a_load_gets_no_columns_of_one():
    problem, found = looked_for({})
    for one, _ in found:
        assert refusal(SCREENED, one) is not None
    assert not {*problem.every_key} & {*LOAD.keys}
