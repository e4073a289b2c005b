"""Backward: what leaves the model again, because the others do as well without it, because chance
can do it beside all that joined since, or because something without a name is larger."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.discrepancy.acceptance import Stage, Trial, plausible, refusal
from groundstation.discrepancy.evidence import by_parts, separated
from groundstation.discrepancy.findings import Leftover
from groundstation.discrepancy.screening import removal_cost, sizes_at
from groundstation.discrepancy.search_state import Accepted, SearchState
from groundstation.discrepancy.whiteness import leftover


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
        t, parts = by_parts(problem, separated(problem, linear, one.variant))
        one.evidence = replace(one.evidence, t=t, parts=parts)
        why = refusal(Stage.STABLE, Trial(one.variant, evidence=one.evidence))
        if why is not None:
            refused.append((t, one, why))
    if not refused:
        return False
    _, worst, why = min(refused, key=lambda each: each[0])
    search.banned.add(worst.variant.label)
    search.drop(worst, why)
    return True


def drop_below_residual(search: SearchState) -> Leftover:
    """Judge the residual; what is small beside an unexplained structure loses its name.

    It stays in the fit: a centre of gravity that sits elsewhere in each flight, left out, took
    a third of the moment of velocity and a tenth of c1 with it on real flights.
    """
    left, slow = leftover(search.problem, search.now)
    for one in list(search.accepted):
        trial = Trial(one.variant, evidence=one.evidence, slow=slow)
        why = refusal(Stage.LEFT, trial)
        if why is not None and search.judge is not None:
            trial.predicted = _predicted(search, one)
            why = refusal(Stage.LEFT, trial)
        if why is not None:
            search.refused[one.variant.label] = why
            search.accepted.remove(one)
            search.beside.append(one.variant)
    return left


def _predicted(search: SearchState, one: Accepted) -> float:
    """Share of the squared excess over noise that predictions lose with an effect."""
    rest = [other for other in search.accepted if other is not one]
    excess = search.judged(search.refit(rest, search.held).point).gap ** 2 - 1.0
    left = search.judged(search.now.point).gap ** 2 - 1.0
    return 1.0 - left / excess if excess > 0.0 else 0.0
