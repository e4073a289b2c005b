"""What speaks for an effect."""

from dataclasses import replace

import pytest
from affected_flights import BASE, flown

from groundstation.discrepancy.evidence import gather
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.parameters import VARIANTS, point_of
from groundstation.identification.likelihood.problem import Problem

DAMPING = next(one for one in VARIANTS if one.effect == "rate_damping")


@pytest.fixture(scope="module")
def problem():
    flights = prepare([flown(20.0, seed, "rate_damping")[0] for seed in (1, 2)])
    found = Problem(flights, BASE, point_of(BASE))
    found.learn_noise(found.linear(found.start, found.every_key, found.flights))
    return found


def test_what_was_known_before_promises_nothing_of_held_out_rows(problem):
    """Motors that were bent against what is known of them fit held-out rows as they fit these."""
    bent = problem.start | {"a0": 1.05 * problem.start["a0"]}
    before = problem.fit(bent, ("c0", "c1", "c2"))
    after = problem.fit(problem.start, ("c0", "c1", "c2", *DAMPING.keys))
    found = gather(problem, problem.flights, before, after, DAMPING)
    # Of the very rows it was fitted to.
    assert found.expected == pytest.approx(found.held_out, rel=0.2)
    assert found.drop > found.expected + 5.0
    problem.prior = [(keys, centre, 100.0 * weight) for keys, centre, weight in problem.prior]
    costs = [problem.fit(one.point, (), steps=0).cost for one in (before, after)]
    surely = [replace(one, cost=cost) for one, cost in zip((before, after), costs, strict=True)]
    again = gather(problem, problem.flights, *surely, DAMPING)
    assert again.drop > found.drop + 500.0
    assert again.expected == pytest.approx(found.expected)
