"""The end of a search: which changed constants stay, which change has a name, and whether what was
found predicts fitted samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.discrepancy.acceptance import Stage, Trial, refusal
from groundstation.discrepancy.base_constants import not_improved, unconfirmed
from groundstation.discrepancy.prediction_gate import answer_to_predictions
from groundstation.discrepancy.search_state import Accepted, SearchState, names_of
from groundstation.identification.likelihood.motion import Variant

TRIM_ROUNDS, TRIM_SETTLED = 6, 0.01
"""How often the trims of flights and what explains them settle on each other, at most, and the
share of them that is no change."""


def settle_trim(search: SearchState) -> None:
    """Learn how far the trims of flights differ beside what was found, and fit with that."""
    for _ in range(TRIM_ROUNDS):
        before = search.problem.trim
        search.problem.learn_trim(search.now.point)
        search.now = search.problem.fit(search.now.point, search.now.keys)
        if np.allclose(search.problem.trim, before, rtol=TRIM_SETTLED):
            break
    search.trims = {names_of(search.accepted): search.problem.trim}


def hold_base(search: SearchState) -> None:
    """Give back the base constants that these data do not improve; standard errors are those
    of the fit in which everything was free."""
    search.errors = search.now.stderr()
    search.held, point = not_improved(search.problem, search.now, search.groups, search.folds)
    if search.held:
        search.now = replace(search.now, point=point)
        search.now = search.refit(search.accepted, search.held)
    while group := unconfirmed(search.problem, search.now):
        search.held.update(group)
        search.now = search.refit(search.accepted, search.held)


def name_base_changes(search: SearchState) -> None:
    """A base constant that moved so far that the change has a name becomes that effect.

    Where an effect of supply, motors or rotors or one that is easily taken for it is in the
    model, the constant may have moved to make room for that: then the change has to be the
    same without it.
    """
    for variant in search.renames:
        assert variant.definition.renames is not None
        key, (own,) = variant.definition.renames.constant, variant.sizes
        if key in search.held or key not in search.now.keys:
            continue
        held = search.held | {key}
        after = search.refit(search.accepted, held, (own,))
        (evidence,) = search.weighed(after, [variant])
        trial = Trial(variant, after, evidence=evidence)
        if refusal(Stage.WEIGHED, trial) or refusal(Stage.NAMED, trial):
            continue
        apart = [one for one in search.accepted if not _shares(one.variant, variant)]
        if len(apart) < len(search.accepted):
            alone = search.refit(apart, held, (own,))
            if abs(alone.point[own] - after.point[own]) > variant.definition.negligible:
                continue
        search.now, search.held = after, held
        search.accepted.insert(0, Accepted(variant, evidence))
        search.errors[own] = after.stderr()[own]
        search.held_out[variant.label] = evidence.held_out


def confirm(search: SearchState) -> bool:
    """Ask predictions; whether anything left."""
    if search.judge is None:
        return False
    return answer_to_predictions(search, search.judge)


def _shares(variant: Variant, other: Variant) -> bool:
    """Whether a variant can take a share of what a change of a base constant (``other``) does."""
    one = variant.definition
    rivals = {confusion.other for confusion in other.definition.confused_with}
    return one.name in rivals or one.stage in ("supply", "motor", "rotor")
