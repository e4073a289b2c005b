"""How often a name is chosen again, and what stands in its place."""

from itertools import chain, combinations

import numpy as np
import pytest

from groundstation.discrepancy.proof import Reason, Refusal
from groundstation.discrepancy.recurrence import (
    Subsets,
    asked_again,
    by_blocks,
    last_blocks,
    recurrences,
)
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import VARIANTS, absent, point_of
from groundstation.identification.likelihood.problem import Problem
from support.flights import BASE, flown

HIDDEN = "rate_damping"
VARIANT = {one.label: one for one in VARIANTS}
DAMPING, ABSENT = VARIANT[HIDDEN], VARIANT["velocity_moment"]
CONSTANTS = ("c0", "c1", "c2")


@pytest.fixture(scope="module")
def problem():
    flights = prepare([flown(20.0, seed, HIDDEN)[0] for seed in (1, 2)])
    found = Problem(flights, BASE, point_of(BASE))
    found.learn_noise(found.linear(found.start, found.every_key, found.flights))
    return found


def chosen_again(problem, fit, found):
    """How often ``found`` is, beside every effect that has columns."""
    seen = [one for one in VARIANTS if {*problem.every_key}.issuperset(one.sizes)]
    others = asked_again(seen, {}, found)
    return recurrences(last_blocks(problem, fit, others), fit.point, found, others)


def test_blocks_together_are_the_likelihood(problem):
    keys = (*CONSTANTS, *DAMPING.sizes)
    linear = problem.linear(problem.start, keys, problem.flights)
    blocks = by_blocks(problem, linear, len(keys))
    normal, gradient = blocks.together()
    whole = problem.with_prior(linear)
    np.testing.assert_allclose(normal, whole.normal, rtol=1e-6, atol=1e-9 * whole.normal.max())
    np.testing.assert_allclose(gradient, whole.gradient, rtol=1e-6, atol=1e-6)
    assert np.bincount(blocks.flight).tolist() == [8, 8]


def test_a_step_back_to_absent_is_that_of_the_parabola(problem):
    keys = (*CONSTANTS, *DAMPING.sizes)
    fit = problem.fit(problem.start, keys)
    linear = problem.linear(fit.point, keys, problem.flights)
    step = np.zeros(len(keys))
    step[-1] = absent(DAMPING.sizes[0]) - fit.point[DAMPING.sizes[0]]
    normal, gradient = by_blocks(problem, linear, len(keys)).seen_from(step).together()
    size = np.linalg.solve(normal, gradient)[-1]
    assert size == pytest.approx(fit.point[DAMPING.sizes[0]] - absent(DAMPING.sizes[0]), rel=0.01)


def test_what_is_there_is_chosen_again_and_what_is_not_is_hardly(problem):
    keys = (*CONSTANTS, *DAMPING.keys, *ABSENT.keys)
    fit = problem.fit(problem.start, keys)
    found = chosen_again(problem, fit, [DAMPING, ABSENT])
    assert found[DAMPING.label].share == 1.0
    assert found[ABSENT.label].share < 0.6
    assert all(np.isfinite(other.margin) for one in found.values() for other in one.instead)


def test_what_stands_in_a_names_place_is_its_alternative(problem):
    """A damping quadratic in the rate is what the damping looks like, were that not listed."""
    other = VARIANT["quadratic_rate_damping"]
    fit = problem.fit(problem.start, (*CONSTANTS, *other.keys))
    (found,) = chosen_again(problem, fit, [other]).values()
    first = found.instead[0]
    assert (first.name, found.share) == (HIDDEN, pytest.approx(1.0 - first.share, abs=0.05))
    assert first.share > 0.9
    assert first.margin < 0.0


def test_refused_for_good_is_not_asked_again():
    refused = {
        DAMPING.label: Refusal(Reason.NOT_HELD_OUT, ""),
        ABSENT.label: Refusal(Reason.WEAK, ""),
    }
    assert asked_again([DAMPING, ABSENT], refused, []) == [ABSENT]
    assert asked_again([DAMPING, ABSENT], refused, [ABSENT]) == []


@pytest.mark.parametrize("seed", range(8))
def test_the_subset_is_the_best_of_all(seed):
    generator = np.random.default_rng(seed)
    variants = [VARIANT[name] for name in (HIDDEN, "velocity_moment", "yaw_damping", "rotor_drag")]
    columns = sum(len(one.sizes) for one in variants)
    mixed = generator.normal(size=(60, 2 + columns))
    mixed[:, 3:] += 0.7 * mixed[:, 2:-1]  # neighbours look alike
    sizes = [key for one in variants for key in one.unknowns if key.key in one.sizes]
    scale = np.array([1.0, 1.0, *(0.1 * key.plausible[1] for key in sizes)])
    rows = mixed @ generator.choice([0.0, 2.4], size=2 + columns) + generator.normal(size=60)
    normal = mixed.T @ mixed / np.outer(scale, scale)
    gradient = mixed.T @ rows / scale
    subsets = Subsets(variants, point_of(BASE), normal, gradient)
    best = subsets.best(frozenset({0, 1, 2, 3}))
    every = chain.from_iterable(combinations(range(4), size) for size in range(5))
    assert subsets.worth(best) == pytest.approx(max(map(subsets.worth, every)))
    assert np.all(subsets.beside(best) <= 0.0)
