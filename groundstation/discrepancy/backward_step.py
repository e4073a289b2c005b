"""Backward: what leaves the model again, because the others do as well without it, or because it
fails what it passed before the others joined."""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.discrepancy.acceptance import Stage, Trial, plausible, refusal
from groundstation.discrepancy.findings import Refusal
from groundstation.discrepancy.screening import cost_without
from groundstation.discrepancy.search_state import Accepted, SearchState
from groundstation.identification.likelihood.motion import Variant


def drop_needless(search: SearchState) -> bool:
    """Drop the accepted effect that the others do best without, if there is one."""
    if len(search.accepted) < 2:
        return False
    keys, point = search.now.keys, search.last.point
    covariance = search.last.covariance(keys)
    trials = []
    for one in search.accepted:
        cost = cost_without(one.variant, point, keys, covariance)
        if not plausible(one.variant, point):
            cost = min(cost, 0.0)
        trials.append((cost, one))
    cost, worst = min(trials, key=lambda item: item[0])
    why = refusal(Stage.JOINED, Trial(worst.variant, removal=cost))
    if why is None:
        return False
    search.drop((worst, why))
    return True


def drop_failing(search: SearchState) -> bool:
    """Drop, for good, the weakest accepted effect that fails what it once passed, if there is
    one."""
    variants = [one.variant for one in search.accepted]
    failed = failing(search, variants) if variants else []
    if not failed:
        return False
    search.banned.add(failed[-1][0].variant.label)
    search.drop(failed[-1])
    return True


def failing(search: SearchState, variants: Sequence[Variant]) -> list[tuple[Accepted, Refusal]]:
    """Ask each of these effects of the joint fit beside the others; those that fail, the weakest
    last, and why. All are accepted until they are dropped, the strongest first."""
    weighed = search.weighed(search.now, variants)
    both = [Accepted(one, evidence) for one, evidence in zip(variants, weighed, strict=True)]
    search.accepted = sorted(both, key=lambda one: -one.evidence.drop)
    search.held_out |= {one.variant.label: one.evidence.held_out for one in both}
    failed = []
    for one in search.accepted:
        why = refusal(Stage.WEIGHED, Trial(one.variant, search.now, evidence=one.evidence))
        if why is not None:
            failed.append((one, why))
    return failed
