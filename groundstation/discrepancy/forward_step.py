"""Forward: what joins the model. Candidates are screened, the best few fitted jointly, and the
first that passes the gates joins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from groundstation.discrepancy.acceptance import Stage, Trial, plausible, refusal
from groundstation.discrepancy.backward_step import failing
from groundstation.discrepancy.findings import Reason
from groundstation.discrepancy.screening import (
    PENALTY,
    Scored,
    Screening,
    screen,
    started,
    tried,
)
from groundstation.discrepancy.search_state import ROUGHLY, Accepted, SearchState
from groundstation.identification.likelihood.motion import Point, Variant, absent
from groundstation.identification.likelihood.problem import Fit

SURE = 100.0
"""Drop of -2 log L beside every other effect from which one is taken without a contest: 10
standard errors, where no rival can be within reach."""
LEADS = 0.3
"""Of the best candidate's drop in the screening, what another has to promise to be fitted beside
it: a joint fit changes what is promised by less, and takes the longest of all."""
ROUGH_STEPS = 2
"""Of a joint fit from which one of many leaves, until no more do: as many as twenty leave."""
FITTED, MORE_FITTED = 4, 2
"""Joint fits at once, at most, and beside them effects easily confused with the best one."""


def join_what_is_sure(search: SearchState, plain: Screening) -> None:
    """Join what is beyond doubt beside every other effect, all at once.

    One by one, the first to join would have to stand for those that are still missing. Each is
    asked beside all the others, and the weaker half of those that fail leaves; the next step may
    take one of them again.
    """
    best: dict[str, Scored] = {}
    for one in search.first.beside_all(search.candidates):
        margin = one.drop - PENALTY * (len(one.variant.sizes) - 1)
        known = margin > SURE and bool(np.isfinite(one.errors).all())
        rival = best.get(one.variant.effect)
        first = known and (rival is None or one.drop > rival.drop)
        if first and plausible(one.variant, _placed(plain, one)):
            best[one.variant.effect] = one
    sure = list(best.values())
    point = dict(plain.point)
    for one in sure:
        point = started(point, one)
    keys = (*search.base_keys, *(key for one in sure for key in one.variant.keys))
    if not sure:
        search.now = Fit(point, keys, np.inf, np.zeros((len(keys),) * 2))
        return
    search.progress("fitting what is beyond doubt", 0.2)
    search.now = search.problem.fit(point, keys)
    variants = [one.variant for one in sure]
    search.progress("asking each beside the others", -1.0)
    rough = False
    while variants:
        failed = failing(search, variants)
        if failed:
            search.drop(*failed[len(failed) // 2 :], steps=ROUGH_STEPS)
            variants = [one.variant for one in search.accepted]
        elif not rough:
            break
        else:
            search.now = search.problem.fit(search.now.point, search.now.keys)
        rough = bool(failed)


def join_best(search: SearchState, able: Sequence[Variant]) -> bool:
    """Fit the best of these candidates and join the first that passes; those that promise far less
    than the best only where it does not."""
    shortlist = _shortlist(search, search.last.scores(search.now.keys, able))
    if not shortlist:
        return False
    before = search.problem.fit(search.now.point, search.now.keys, steps=1)
    least = LEADS * shortlist[0].drop
    leads = [one for one in shortlist if one.drop >= least]
    behind = [one for one in shortlist if one.drop < least]
    return any(_join_first(search, group, before) for group in (leads, behind))


def _join_first(search: SearchState, shortlist: Sequence[Scored], before: Fit) -> bool:
    """Join the first of these, the best one first, that passes."""
    for trial in _fitted(search, shortlist, before):
        label = trial.variant.label
        assert trial.fit is not None
        (evidence,) = search.weighed(trial.fit, [trial.variant])
        trial.evidence = replace(evidence, drop=before.cost - trial.fit.cost)
        search.held_out[label] = trial.evidence.held_out
        why = refusal(Stage.WEIGHED, trial)
        if why is None:
            _join(search, trial)
            return True
        search.refused[label] = why
    return False


def join_tried(search: SearchState) -> bool:
    """Join an effect with a shape of which several values are tried, once nothing else joins.

    It has columns only where one of the values promises something, and where it is refused
    after all everything is as it was: a column without a meaning takes a share of the noise.
    """
    promising: list[Variant] = []
    for one, shape in best_tried(search, search.now.point, search.now.keys):
        others = [other for other in search.scores if other.variant is not one.variant]
        search.scores = [*others, one]
        why = refusal(Stage.SCREENED, Trial(one.variant, scored=one))
        if why is None:
            promising.append(one.variant)
            search.shapes |= shape
        else:
            search.refused.setdefault(one.variant.label, why)
    if not promising:
        return False
    problem, last = search.problem, search.last
    noise, own, motors = dict(problem.noise), dict(problem.shapes), problem.motors
    keys = (*search.now.keys, *(key for one in promising for key in one.keys))
    search.last = screen(problem, {**search.now.point, **search.shapes}, keys)
    if join_best(search, promising):
        return True
    problem.noise, problem.shapes, problem.motors = noise, own, motors
    search.last = last
    return False


def best_tried(
    search: SearchState, point: Point, keys: Sequence[str]
) -> list[tuple[Scored, Point]]:
    """Of each effect with a shape that is tried, the best value that is possible."""

    def worth(one: tuple[Scored, Point]) -> tuple[bool, float]:
        scored = one[0]
        return refusal(Stage.SCREENED, Trial(scored.variant, scored=scored)) is None, scored.drop

    return [max(some, key=worth) for some in tried(search.problem, point, keys, search.able())]


def _shortlist(search: SearchState, scores: Sequence[Scored]) -> list[Scored]:
    """The best few that pass the screening, and what the best one is easily confused with."""
    able = []
    for one in scores:
        why = refusal(Stage.SCREENED, Trial(one.variant, scored=one))
        if why is None:
            able.append(one)
        elif why.reason is Reason.WEAK:
            search.refused.setdefault(one.variant.label, why)
        else:
            search.refused[one.variant.label] = why
    if not able:
        return []
    close = able[:FITTED]
    rivals = {c.other for one in close[:1] for c in one.variant.definition.confused_with}
    more = [one for one in able if one.variant.effect in rivals and one not in close]
    return close + more[:MORE_FITTED]


def _fitted(search: SearchState, shortlist: Sequence[Scored], before: Fit) -> list[Trial]:
    """Joint fits of candidates, the best one first."""
    trials = []
    for one in shortlist:
        search.progress(f"fitting {one.variant.effect}", -1.0)
        keys = (*search.now.keys, *one.variant.keys)
        start = started(search.now.point, one, search.shapes)
        fit = search.problem.fit(start, keys, settled=ROUGHLY)
        fit = search.nested(fit, before, one.variant)
        gain = before.cost - fit.cost - PENALTY * len(one.variant.keys)
        trials.append(Trial(one.variant, fit, gain))
    return sorted(trials, key=lambda trial: trial.gain, reverse=True)


def _join(search: SearchState, trial: Trial) -> None:
    assert trial.fit is not None
    assert trial.evidence is not None
    search.accepted.append(Accepted(trial.variant, trial.evidence))
    search.refused.pop(trial.variant.label, None)
    search.now = trial.fit


def _placed(plain: Screening, one: Scored) -> dict[str, float]:
    """The given model with an effect at its screened size."""
    values = dict(zip(one.variant.sizes, one.values.tolist(), strict=True))
    return {**plain.point, **{key: absent(key) + size for key, size in values.items()}}
