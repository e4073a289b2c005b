"""Backward: what leaves the model again, because the others do as well without it, or because
chance can do it beside all that joined since."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.discrepancy.acceptance import Stage, Trial, plausible, refusal
from groundstation.discrepancy.evidence import by_blocks, separated
from groundstation.discrepancy.screening import removal_cost, sizes_at
from groundstation.discrepancy.search_state import SearchState


def drop_needless(search: SearchState) -> bool:
    """Drop the accepted effect that the others do best without, if there is one."""
    if len(search.accepted) < 2:
        return False
    keys, point = search.now.keys, search.last.point
    covariance = search.last.covariance(keys)
    trials = []
    for one in search.accepted:
        own = [keys.index(key) for key in one.variant.sizes]
        cost = removal_cost(sizes_at(one.variant, point), covariance[np.ix_(own, own)])
        if not plausible(one.variant, point):
            cost = min(cost, 0.0)
        trials.append((cost, one))
    cost, worst = min(trials, key=lambda item: item[0])
    why = refusal(Stage.JOINED, Trial(worst.variant, removal=cost))
    if why is None:
        return False
    search.drop(worst, why)
    return True


def drop_insignificant(search: SearchState) -> bool:
    """Drop, for good, the accepted effect that is least above chance, if one is not above it."""
    problem, now = search.problem, search.now
    linear = problem.linear(now.point, now.keys, problem.flights)
    refused = []
    for one in search.accepted:
        t = by_blocks(problem, separated(problem, linear, one.variant))
        one.evidence = replace(one.evidence, t=t)
        why = refusal(Stage.STABLE, Trial(one.variant, evidence=one.evidence))
        if why is not None:
            refused.append((t, one, why))
    if not refused:
        return False
    _, worst, why = min(refused, key=lambda each: each[0])
    search.banned.add(worst.variant.label)
    search.drop(worst, why)
    return True
