"""What a search came to, told: effects with their evidence, candidates, what could not be shown."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace

from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.acceptance import Stage, Trial, refusal
from groundstation.discrepancy.base_constants import base_changes
from groundstation.discrepancy.differences import BY_MASS, UNWEIGHED
from groundstation.discrepancy.findings import (
    Alternative,
    Candidate,
    Findings,
    FoundEffect,
    NotShown,
    Reason,
    Verdict,
)
from groundstation.discrepancy.recurrence import Recurrence
from groundstation.discrepancy.screening import Scored
from groundstation.discrepancy.search import Outcome
from groundstation.discrepancy.search_state import Accepted
from groundstation.dynamics.model import Estimate, Model, model_vehicle
from groundstation.dynamics.registry import EFFECTS
from groundstation.identification.body.setup import open_delay_s, unseen_delay_s
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.motion import (
    BODY_KEYS,
    MOTOR_KEYS,
    Point,
    Variant,
    absent,
    estimates_of,
    model_of,
)
from groundstation.identification.likelihood.problem import Problem

SHOWN = 5.0
"""An effect can be shown when its usual size is so many standard errors."""


def conclude(
    outcome: Outcome,
    errors: Mapping[str, float],
    recurrence: Mapping[str, Recurrence],
    problem: Problem,
    model: Model,
    known: Sequence[Variant],
    lost: dict[str, str],
    warnings: list[str],
) -> Findings:
    """The findings, but for what predictions say of the verdict.

    errors: standard errors by key that are told. recurrence: by label. known: effects of the given
    model. lost: as in ``Findings``.
    """
    final, residual = outcome.final, outcome.residual
    given = tuple(key for v in known for key in v.keys)
    named, possible = _named_and_possible(outcome, recurrence, problem)
    others = [one for one in outcome.accepted if one not in named]
    unnamed = (*given, *(key for one in others for key in one.variant.keys))

    def told(one: Accepted, order: int, keys: tuple[str, ...]) -> FoundEffect:
        again = recurrence.get(one.variant.label)
        return _effect(one, again, order, outcome, errors, keys, model, problem.frame.own)

    keys, effects = unnamed, []
    for order, one in enumerate(named, 1):
        keys = (*keys, *one.variant.keys)
        effects.append(told(one, order, keys))
    warnings += _not_measured(problem, model, effects)
    verdict = Verdict.EFFECTS_FOUND
    if not effects and residual.verdict == "structured":
        verdict = Verdict.UNEXPLAINED
    elif not effects:
        verdict = Verdict.NO_DISCREPANCY
    base = (*BODY_KEYS, *MOTOR_KEYS, *given)
    changed = _with_renamed(final.point, outcome, problem)
    return Findings(
        verdict=verdict,
        effects=tuple(effects),
        possible=tuple(
            replace(told(one, 0, unnamed), refused=outcome.refused[one.variant.label])
            for one in possible
        ),
        base=model,
        given=model,
        moved=model_of(final.point, errors, unnamed, model, problem.frame.own),
        base_changes=base_changes(problem, final, changed, errors, base),
        model=model_of(final.point, errors, keys, model, problem.frame.own),
        candidates=_candidates(outcome),
        not_shown=tuple(_not_shown(outcome.scores, {effect.name for effect in effects})),
        lost=lost,
        residual=residual,
        warnings=tuple(warnings),
    )


def _not_measured(problem: Problem, model: Model, effects: Sequence[FoundEffect]) -> Iterator[str]:
    if not problem.known_motor:
        yield (
            "the model has no bench covariance for a0, a1, a2: 2 % each is assumed, and small"
            " effects of voltage are taken for it"
        )
    if model.vehicle_profile is None and any(_is_by_mass(effect) for effect in effects):
        yield (
            f"sizes in kg and N are for the mass of the profile,"
            f" {1e3 * model_vehicle(model).mass_kg:.3g} g, and their errors hold"
            f" {100.0 * UNWEIGHED:g} % for it: weigh the craft, and fit with --mass"
        )


def _is_by_mass(effect: FoundEffect) -> bool:
    return any(one.unit.startswith(BY_MASS) for one in effect.parameters.values())


def _with_renamed(point: Point, outcome: Outcome, problem: Problem) -> Point:
    """The point with constants moved by the accepted effects that are another name for it."""
    changed = dict(point)
    for one in outcome.accepted:
        rename = one.variant.definition.renames
        if rename is not None:
            size = point[one.variant.sizes[0]]
            changed[rename.constant] = rename.moved(problem.start[rename.constant], size)
    return changed


def open_of(flights: Sequence[Flight]) -> float:
    """Delay (s) that the rows of these flights leave open; measured rotor speeds know what the
    controller did within a row."""
    modelled = [flight for flight in flights if not flight.rotor_measured]
    return max(
        (max(open_delay_s(one.period_s), unseen_delay_s(one.run)) for one in modelled), default=0.0
    )


def _named_and_possible(
    outcome: Outcome, recurrence: Mapping[str, Recurrence], problem: Problem
) -> tuple[list[Accepted], list[Accepted]]:
    """Effects that pass the last gates, and those that are no more than possible; why the others
    have no name is in ``outcome.refused`` then."""
    open_s = open_of(problem.flights)
    named, possible = [], []
    for one in outcome.accepted:
        label = one.variant.label
        trial = Trial(
            one.variant,
            outcome.final,
            open_s=open_s,
            recurrence=recurrence[label].share if label in recurrence else 1.0,
            errors=outcome.errors,
            weight=outcome.weights.get(label),
        )
        why = refusal(Stage.NAMED, trial)
        if why is None:
            named.append(one)
            continue
        outcome.refused[label] = why
        if why.reason is not Reason.NEGLIGIBLE:
            possible.append(one)
    return named, possible


def _effect(
    one: Accepted,
    again: Recurrence | None,
    order: int,
    outcome: Outcome,
    errors: Mapping[str, float],
    keys: tuple[str, ...],
    model: Model,
    own: Sequence[Variant],
) -> FoundEffect:
    name, evidence = one.variant.effect, one.evidence
    point = outcome.final.point
    return FoundEffect(
        name=name,
        order=order,
        parameters=estimates_of(one.variant, point, errors),
        evidence={
            "likelihood_ratio": evidence.drop,
            "t": evidence.t,
            "held_out": evidence.held_out,
            "held_out_expected": evidence.expected,
        },
        alternatives=tuple(
            Alternative(other.name, other.margin, _manoeuvre(name, other.name, own), other.share)
            for other in (again.instead if again else ())
        ),
        recurrence=again.share if again else math.nan,
        channels=tuple(CHANNELS[c] for c in evidence.channels),
        adds=one.variant.definition.adds,
        model=model_of(point, errors, keys, model, own),
    )


def _manoeuvre(name: str, other: str, own: Sequence[Variant]) -> str:
    """What separates two effects, from the catalogue, whichever of the two knows it."""
    effects = {**EFFECTS, **{one.effect: one.definition for one in own}}
    for one, two in ((name, other), (other, name)):
        for confusion in effects[one].confused_with:
            if confusion.other == two:
                return confusion.manoeuvre
    return effects[other].excited_by


def _candidates(outcome: Outcome) -> tuple[Candidate, ...]:
    fitted = {one.variant.label for one in outcome.accepted}
    found = []
    for one in outcome.scores:
        label = one.variant.label
        parameters = {
            key.partition(".")[2]: Estimate(float(size + absent(key)), float(error), "")
            for key, size, error in zip(one.variant.sizes, one.values, one.errors, strict=True)
        }
        why = outcome.refused.get(label)
        held_out = outcome.held_out.get(label, 0.0)
        accepted = label in fitted and why is None
        found.append(Candidate(label, parameters, one.drop, one.t, held_out, accepted, why))
    return tuple(found)


def _not_shown(scores: Sequence[Scored], named: Container[str]) -> list[NotShown]:
    """Effects whose usual size would be lost in the noise of these recordings; no named ones."""
    found = []
    for one in scores:
        if one.variant.effect in named:
            continue
        effect = one.variant.definition
        sizes = (unknown for unknown in one.variant.unknowns if unknown.parameter.kind == "size")
        for unknown, error in zip(sizes, one.errors.tolist(), strict=True):
            if SHOWN * error > unknown.worth:
                name, unit = unknown.key.partition(".")[2], unknown.unit
                stderr = error if math.isfinite(error) else None
                found.append(
                    NotShown(effect.name, name, stderr, unknown.worth, unit, effect.excited_by)
                )
    return found
