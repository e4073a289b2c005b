"""The procedure: screen every effect, add the best one, drop what became needless, until stable.

``search_effects`` and ``concluded`` are the whole of it. Columns of every effect are evaluated once
a round (``screening.py``), the best few are fitted jointly with the base and what was accepted
before, and each stage has its gates (``acceptance.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.discrepancy.backward_step import (
    drop_failing,
    drop_needless,
)
from groundstation.discrepancy.findings import Leftover, Refusal
from groundstation.discrepancy.forward_step import join_best, join_tried, join_what_is_sure
from groundstation.discrepancy.screening import Scored, Screening, screen, settle
from groundstation.discrepancy.search_state import Accepted, SearchState
from groundstation.discrepancy.settlement import (
    confirm,
    hold_base,
    name_base_changes,
    settle_trim,
)
from groundstation.discrepancy.weight import Weight
from groundstation.discrepancy.whiteness import leftover
from groundstation.identification.likelihood.problem import Fit

MOST_ROUNDS = 16


@dataclass(slots=True)
class Outcome:
    """final: the joint fit. errors: standard errors by key, everything being free. residual: what
    it leaves. refused: variant label -> why it is not named. held_out: variant label -> drop of
    -2 log L on flights left out when it was weighed last. weights: variant label -> what it
    carries. first: the screening at the model as it was given; scores: of it."""

    final: Fit
    errors: dict[str, float]
    accepted: list[Accepted]
    residual: Leftover
    refused: dict[str, Refusal]
    held_out: dict[str, float]
    weights: dict[str, Weight]
    first: Screening
    scores: list[Scored]


def search_effects(search: SearchState) -> None:
    """From the model as it was given to a set of effects that stays, but for what
    predictions say of it (``concluded``)."""
    # The base is not fitted alone first: bent to imitate what is missing, it would be a poor
    # place to linearise at. A centre of gravity off its place makes c0 vanish, for one.
    search.progress("screening", 0.1)
    search.first = settle(search.problem)
    plain = search.first.without_effects(search.base_keys)
    search.scores = plain.scores(search.base_keys, search.candidates)
    join_what_is_sure(search, plain)
    for number in range(MOST_ROUNDS):
        count = len(search.accepted)
        what = f"screening after {count} effects" if count else "screening"
        search.progress(what, min(0.9, 0.1 + 0.2 * number))
        search.last = screen(search.problem, search.now.point, search.now.keys)
        if not (
            drop_needless(search)
            or join_best(search, search.able())
            or drop_failing(search)
            or join_tried(search)
        ):
            break
    search.now = search.problem.fit(search.now.point, search.now.keys)
    search.residual = leftover(search.problem, search.now)
    settle_trim(search)
    hold_base(search)
    name_base_changes(search)


def concluded(search: SearchState) -> Outcome:
    """What stays of a search where predictions are asked."""
    if confirm(search):
        search.residual = leftover(search.problem, search.now)
    return Outcome(
        final=search.now,
        errors=search.errors,
        accepted=search.accepted,
        residual=search.residual,
        refused=search.refused,
        held_out=search.held_out,
        weights=search.weights,
        first=search.first,
        scores=search.scores,
    )
