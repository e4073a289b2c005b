"""Find what a model is missing: the entry of the search."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from groundstation.discrepancy.findings import (
    CHANNELS,
    Alternative,
    Candidate,
    Findings,
    FoundEffect,
    Leftover,
    Verdict,
)
from groundstation.discrepancy.flight import Flight, prepare
from groundstation.discrepancy.problem import Problem
from groundstation.discrepancy.search import Outcome, search
from groundstation.discrepancy.unknowns import (
    ABSENT,
    VARIANTS,
    Variant,
    model_of,
    parameters_of,
    point_of,
)
from groundstation.dynamics.model import Model
from groundstation.identification.runs import Run, hold_out

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is done, 0..1 (negative: as before)."""


def find_effects(
    flights: Sequence[Run],
    model: Model,
    validation: Sequence[Run] | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Findings:
    """Find, name and fit the effects that ``model`` is missing in ``flights``.

    flights: to fit on; rows that were lost may be NaN (see ``recordings.flights_of``).
    validation: rows that no fit sees; None: the last third of the flights.
    """
    report: Progress = progress or (lambda what, share: None)
    if validation is None:
        flights, validation = hold_out(flights)
    fit_on, held = prepare(flights), prepare(validation)
    start = point_of(model)
    problem = Problem(fit_on, model, start)
    problem.settle_filters()
    known = [v for v in VARIANTS if any(start.get(k, ABSENT[k]) != ABSENT[k] for k in v.keys)]
    outcome = search(problem, held, known, VARIANTS, report)
    return _findings(outcome, problem, held, model, known)


def _findings(
    outcome: Outcome,
    problem: Problem,
    held: Sequence[Flight],
    model: Model,
    known: Sequence[Variant],
) -> Findings:
    base_keys = tuple(key for v in known for key in v.keys)
    effects = []
    errors = outcome.final.stderr()
    keys = base_keys
    for number, one in enumerate(outcome.accepted):
        keys = (*keys, *one.variant.keys)
        effects.append(
            FoundEffect(
                name=one.variant.effect,
                order=number + 1,
                parameters=parameters_of(
                    one.variant.effect, outcome.final.point, errors, one.variant.keys
                ),
                evidence={
                    "likelihood_ratio": one.evidence.drop,
                    "t": one.evidence.t,
                    "held_out": one.evidence.held_out,
                },
                alternatives=tuple(Alternative(name, margin, "") for name, margin in one.rivals),
                gap_before=one.gap[0],
                gap_after=one.gap[1],
                channels=tuple(CHANNELS[c] for c in one.evidence.channels),
                model=model_of(one.fit.point, one.fit.stderr(), keys, model),
            )
        )
    return Findings(
        verdict=Verdict.EFFECTS_FOUND if effects else Verdict.NO_DISCREPANCY,
        effects=tuple(effects),
        base=model,
        model=model_of(outcome.final.point, errors, keys, model),
        candidates=tuple(
            Candidate(
                s.variant.label,
                {},
                s.drop,
                s.t,
                outcome.held_out.get(s.variant.label, 0.0),
                False,
                outcome.reasons.get(s.variant.label, ""),
            )
            for s in outcome.first
        ),
        not_shown=(),
        lost={},
        channels={},
        residual=Leftover("white"),
    )
