"""What a search has come to: the effects that joined, those that did not and why, the joint fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from groundstation.discrepancy.base_constants import groups
from groundstation.discrepancy.evidence import Evidence, folds_of, gather
from groundstation.discrepancy.findings import Leftover, Predicted, Refusal
from groundstation.discrepancy.screening import Scored, Screening, without
from groundstation.discrepancy.weight import Weight
from groundstation.dynamics.effect import CANDIDATES
from groundstation.identification.likelihood.motion import RENAMES, Point, Variant, absent
from groundstation.identification.likelihood.problem import STEPS, Fit, Problem

Progress = Callable[[str, float], None]

ROUGHLY = 0.5
"""Drop of -2 log L at which a joint fit of a candidate ends."""


@dataclass(slots=True)
class Accepted:
    """An effect that joined."""

    variant: Variant
    evidence: Evidence


class Judge(Protocol):
    """What predictions of fitted samples say (``judge.Judge``)."""

    def __call__(self, point: Point) -> Predicted: ...

    def weights(self, point: Point, accepted: Sequence[Accepted]) -> dict[str, Weight]: ...


class SearchState:
    """One search: what has joined so far, and why others have not."""

    def __init__(
        self,
        problem: Problem,
        known: Sequence[Variant],
        candidates: Sequence[Variant],
        progress: Progress,
    ) -> None:
        """known: effects of the model, fitted along and never dropped. What the firmware does on
        board is not fitted: its numbers are known, and beside what is missing they would bend."""
        self.problem, self.folds, self.progress = problem, folds_of(problem.flights), progress
        self.judge: Judge | None = None
        self.candidates = list(candidates)
        fixed = [one for one in known if one.definition.role not in CANDIDATES]
        free = [variant for variant in known if variant not in fixed]
        held = (key for one in fixed for key in one.keys if key not in problem.base_keys)
        self.fixed = {key: problem.start[key] for key in held}
        self.base_keys = (*problem.base_keys, *(key for variant in free for key in variant.keys))
        self.groups = groups(problem.start, [variant.keys for variant in free])
        self.renames = [variant for variant in RENAMES if variant not in known]
        self.trim = problem.trim
        self.trims: dict[frozenset[str], tuple[float, float, float]] = {}
        """Of flights beside the effects of these names; beside others, as far as ``trim``."""
        self.held: set[str] = set()
        self.errors: dict[str, float] = {}
        self.accepted: list[Accepted] = []
        self.refused: dict[str, Refusal] = {}
        self.held_out: dict[str, float] = {}
        self.weights: dict[str, Weight] = {}
        self.banned: set[str] = set()
        self.shapes: Point = {}
        """Of effects with a shape that is tried: its best value."""
        self.first: Screening
        self.scores: list[Scored]
        self.last: Screening
        self.now: Fit
        self.residual: Leftover

    def able(self) -> list[Variant]:
        """The candidates that may still join."""
        joined = {one.variant.effect for one in self.accepted}
        return [v for v in self.candidates if v.effect not in joined and v.label not in self.banned]

    def nested(self, fit: Fit, before: Fit, variant: Variant) -> Fit:
        """A fit with a variant, from where it is absent if that is better than where the fit with
        its screened size ended."""
        if fit.cost <= before.cost:
            return fit
        point = before.point | {k: self.shapes.get(k, absent(k)) for k in variant.keys}
        return self.problem.fit(point, fit.keys, settled=ROUGHLY)

    def drop(self, *failed: tuple[Accepted, Refusal], steps: int = STEPS) -> None:
        """Take effects out, and fit the others without them, in so many steps at most."""
        point = self.now.point
        for one, why in failed:
            self.accepted.remove(one)
            self.refused[one.variant.label] = why
            point = without(point, one.variant)
        joined = (key for one in self.accepted for key in one.variant.keys)
        self.now = self.problem.fit(point, (*self.base_keys, *joined), steps)

    def refit(self, accepted: Sequence[Accepted], held: set[str], sizes: Sequence[str] = ()) -> Fit:
        """The joint fit of some effects, and of ``sizes`` from where they are absent, with the
        constants ``held`` as they were given."""
        # Without what explains a trim, none is too large: a constant would make room for it.
        self.problem.trim = self.trims.get(names_of(accepted), self.trim)
        keys = (*self.base_keys, *(key for one in accepted for key in one.variant.keys), *sizes)
        start = self.problem.start
        point = {key: self.now.point[key] for key in keys if key in self.now.point}
        point |= {key: start.get(key, absent(key)) for key in held} | self.fixed
        return self.problem.fit(point, [key for key in keys if key not in held])

    def weighed(self, fit: Fit, variants: Sequence[Variant]) -> list[Evidence]:
        """What speaks for each of these effects of a joint fit beside the others."""
        return gather(self.problem, self.folds, fit, variants)


def names_of(accepted: Sequence[Accepted]) -> frozenset[str]:
    """Labels of effects, by which a set of them is known."""
    return frozenset(one.variant.label for one in accepted)
