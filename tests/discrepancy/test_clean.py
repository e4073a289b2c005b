"""On a craft without any effect every candidate's estimate is zero within its interval.

The most useful test of all: a regressor that knows too much, a band that is cut, a delay of a
tenth of a millisecond between two channels, each shows here as a finding out of nothing.
"""

import numpy as np
import pytest

from groundstation.discrepancy.screening import screen
from groundstation.dynamics.effect import CANDIDATES
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.motion import VARIANTS, point_of
from groundstation.identification.likelihood.problem import BASE_KEYS, Problem
from support.flights import base_model
from support.flights import searched as flights

NOISES = {"nominal": (1.0, 1.0), "rough": (6.0, 2.0)}


def sought(variant):
    """Whether it is a candidate: not another name of a constant, a firmware's own filter, or of a
    shape that is looked for at the end (``test_tried_shapes``)."""
    return variant.definition.role in CANDIDATES and not variant.tried


def screened(seed, torque_noise, sensor_noise):
    runs, _ = flights(seed, torque_noise=torque_noise, sensor_noise=sensor_noise)
    model = base_model()
    start = point_of(model)
    problem = Problem(prepare(runs), model, start)
    problem.settle_filters()
    candidates = [one for one in VARIANTS if sought(one)]
    return screen(problem, start).scores(BASE_KEYS, candidates)


@pytest.mark.parametrize("noise", NOISES)
def test_every_estimate_is_zero_within_its_interval(noise):
    scores = [one for seed in (101, 102) for one in screened(seed, *NOISES[noise])]
    sizes = np.concatenate([one.values / one.errors for one in scores])
    assert len(sizes) == 2 * sum(len(one.sizes) for one in VARIANTS if sought(one))
    # Many of them are the same noise seen twice, so not quite a chi-squared.
    assert np.abs(sizes).max() < 4.5
    assert 0.4 < np.sqrt(np.mean(sizes**2)) < 1.5


@pytest.mark.parametrize("noise", NOISES)
def test_no_effect_is_worth_a_joint_fit(noise):
    scores = screened(103, *NOISES[noise])
    assert max(one.drop for one in scores) < 16.0
