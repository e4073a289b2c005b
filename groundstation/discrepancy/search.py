"""The procedure: screen every effect, add the best one, drop what became needless, until stable.

``Search.run`` is the whole of it. Columns of every effect are evaluated once a round
(``screening.py``), the best few are fitted jointly with the base and what was accepted before,
and each stage has its gates (``acceptance.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.discrepancy.acceptance import (
    SHARE,
    Stage,
    Trial,
    plausible,
    refusal,
)
from groundstation.discrepancy.base_constants import groups, not_improved, unconfirmed
from groundstation.discrepancy.evidence import Evidence, by_parts, gather
from groundstation.discrepancy.findings import Leftover, Reason, Refusal
from groundstation.discrepancy.prediction_gate import (
    Judge,
    Predicted,
    answer_to_predictions,
    drop_idle,
)
from groundstation.discrepancy.screening import (
    PENALTY,
    Scored,
    Screening,
    removal_cost,
    screen,
    settle,
    sizes_at,
    started,
    tried,
    without,
)
from groundstation.discrepancy.whiteness import leftover
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.parameters import RENAMES, Point, Variant, absent
from groundstation.identification.likelihood.problem import Fit, Problem

Progress = Callable[[str, float], None]

SURE = 100.0
"""Drop of -2 log L beside every other effect from which one is taken without a contest: 10
standard errors, where no rival can be within reach."""
FITTED, MORE_FITTED = 4, 2
"""Joint fits in a turn, at most, and beside them effects easily confused with the best one."""
TURNS = 3
"""How often the next best are tried where the best were refused."""
RIVAL = 12.0
"""An effect that explains so little less, in -2 log L, is an alternative: odds of one in 400."""
ROUGHLY = 0.5
"""Drop of -2 log L at which a joint fit of a candidate ends."""
MOST_ROUNDS = 16
TRIM_ROUNDS = 6
"""How often the trims of flights and what explains them settle on each other."""


@dataclass(slots=True)
class Accepted:
    """An effect that joined: rivals are (name, how much less it explains)."""

    variant: Variant
    evidence: Evidence
    rivals: list[tuple[str, float]]


@dataclass(slots=True)
class Outcome:
    """final: the joint fit. errors: standard errors by key, everything being free. residual: what
    it leaves. refused: variant label -> why it is not named. held_out: variant label -> drop of
    -2 log L on held-out rows when it was weighed last. first, last: columns at the model as it was
    given and at the end; scores: of the first."""

    final: Fit
    errors: dict[str, float]
    accepted: list[Accepted]
    residual: Leftover
    refused: dict[str, Refusal]
    held_out: dict[str, float]
    first: Screening
    scores: list[Scored]
    last: Screening


class Search:
    """One search: what has joined so far, and why others have not."""

    def __init__(
        self,
        problem: Problem,
        validation: Sequence[Flight],
        known: Sequence[Variant],
        candidates: Sequence[Variant],
        progress: Progress,
    ) -> None:
        """known: effects of the model, fitted along and never dropped. What the firmware does on
        board is not fitted: its numbers are known, and beside what is missing they would bend."""
        self.problem, self.validation, self.progress = problem, validation, progress
        self.judge: Judge | None = None
        self.candidates = list(candidates)
        fixed = [one for one in known if one.definition.renames or one.definition.on_board]
        free = [variant for variant in known if variant not in fixed]
        self.fixed = {key: problem.start[key] for one in fixed for key in one.keys}
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
        self.tried: set[frozenset[str]] = set()
        self.banned: set[str] = set()
        self.beside: list[Variant] = []
        """Fitted along, not named: too small to be believed, but left out they bend the others."""
        self.shapes: Point = {}
        """Of effects with a shape that is tried: its best value."""
        self.first: Screening
        self.last: Screening
        self.now: Fit

    def run(self) -> Outcome:
        """From the model as it was given to a set of effects that stays."""
        # The base is not fitted alone first: bent to imitate what is missing, it would be a poor
        # place to linearise at. A centre of gravity off its place makes c0 vanish, for one.
        self.progress("screening", 0.1)
        self.first = settle(self.problem)
        plain = self.first.without_effects(self.base_keys)
        scores = plain.scores(self.base_keys, self.candidates)
        scores += [one for one, _ in self.best_tried(plain.point, self.base_keys)]
        self.join_what_is_sure(plain)
        for number in range(MOST_ROUNDS):
            count = len(self.accepted)
            what = f"screening after {count} effects" if count else "screening"
            self.progress(what, min(0.9, 0.1 + 0.2 * number))
            self.last = screen(self.problem, self.now.point, self.now.keys)
            if not (
                self.drop_needless()
                or self.join_best(self.able())
                or self.drop_disputed()
                or self.join_tried()
            ):
                break
        self.now = self.problem.fit(self.now.point, self.now.keys)
        residual = self.drop_drowned()
        self.settle_trim()
        self.hold_base()
        self.name_base_changes()
        if self.settle():
            residual, _ = leftover(self.problem, self.now, self.validation)
        final, accepted = replace(self.now, point=self._named_point(self.now.point)), self.accepted
        return Outcome(
            *(final, self.errors, accepted, residual, self.refused, self.held_out),
            *(self.first, scores, self.last),
        )

    # Forward.

    def join_what_is_sure(self, plain: Screening) -> None:
        """Join what is beyond doubt beside every other effect, all at once.

        One by one, the first to join would have to stand for those that are still missing.
        Evidence is gathered by taking the weakest away again and again; the order is the reverse.
        """
        best: dict[str, Scored] = {}
        for one in self.first.beside_all(self.candidates):
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
        keys = (*self.base_keys, *(key for one in sure for key in one.variant.keys))
        if not sure:
            self.now = Fit(point, keys, np.inf, np.zeros((len(keys),) * 2))
            return
        self.progress("fitting what is beyond doubt", 0.2)
        after = self.now = self.problem.fit(point, keys)
        out: list[Variant] = []
        while sure:
            weakest = sure.pop(int(np.argmin([_removal(after, one.variant) for one in sure])))
            variant = weakest.variant
            self.progress(f"weighing {variant.effect}", -1.0)
            rest = tuple(key for key in after.keys if key not in variant.keys)
            before = self.problem.fit(without(after.point, variant), rest, settled=ROUGHLY)
            after = self._nested(after, before, variant)
            evidence = gather(self.problem, self.validation, before, after, variant)
            why = refusal(Stage.WEIGHED, Trial(variant, after, evidence=evidence))
            if why is None:
                self.accepted.insert(0, Accepted(variant, evidence, []))
                self.held_out[variant.label] = evidence.held_out
            else:
                self.refused[variant.label] = why
                out.append(variant)
            after = before
        if out:
            self._refit_without(*out)
        self.tried.add(self._names())

    def join_tried(self) -> bool:
        """Join an effect with a shape of which several values are tried, once nothing else joins.

        It has columns only where one of the values promises something, and where it is refused
        after all everything is as it was: a column without a meaning takes a share of the noise.
        """
        promising: list[Variant] = []
        for one, shape in self.best_tried(self.now.point, self.now.keys):
            why = refusal(Stage.SCREENED, Trial(one.variant, scored=one))
            if why is None:
                promising.append(one.variant)
                self.shapes |= shape
            else:
                self.refused.setdefault(one.variant.label, why)
        if not promising:
            return False
        problem, last = self.problem, self.last
        noise, own, reference = dict(problem.noise), dict(problem.shapes), problem.reference
        keys = (*self.now.keys, *(key for one in promising for key in one.keys))
        self.last = screen(problem, {**self.now.point, **self.shapes}, keys)
        if self.join_best(promising):
            return True
        problem.noise, problem.shapes, problem.reference = noise, own, reference
        self.last = last
        return False

    def best_tried(self, point: Point, keys: Sequence[str]) -> list[tuple[Scored, Point]]:
        """Of each effect with a shape that is tried, the best value that is possible."""

        def worth(one: tuple[Scored, Point]) -> tuple[bool, float]:
            scored = one[0]
            return refusal(
                Stage.SCREENED, Trial(scored.variant, scored=scored)
            ) is None, scored.drop

        return [max(some, key=worth) for some in tried(self.problem, point, keys, self.able())]

    def join_best(self, able: Sequence[Variant]) -> bool:
        """Fit the best of these candidates and join the first that passes.

        Where all of the best are refused, the next ones get their turn: what is wrong with the
        strongest need not be wrong with an effect on other channels.
        """
        scores = self.last.scores(self.now.keys, able)
        before: Fit | None = None
        for _ in range(TURNS):
            shortlist = self._shortlist(scores)
            if not shortlist:
                return False
            before = before or self.problem.fit(self.now.point, self.now.keys, steps=1)
            trials = self._fitted(shortlist, before)
            for trial in trials:
                label = trial.variant.label
                why = refusal(Stage.FITTED, trial)
                if why is not None:
                    self.refused.setdefault(label, why)
                    continue
                assert trial.fit is not None
                trial.evidence = gather(
                    self.problem, self.validation, before, trial.fit, trial.variant
                )
                trial.tried = self._names(label) in self.tried
                self.held_out[label] = trial.evidence.held_out
                why = refusal(Stage.WEIGHED, trial)
                if why is None:
                    self._join(trial, trials)
                    return True
                self.refused[label] = why
            scores = [one for one in scores if one not in shortlist]
        return False

    def able(self) -> list[Variant]:
        """The candidates that may still join."""
        joined = {one.variant.effect for one in self.accepted}
        return [v for v in self.candidates if v.effect not in joined and v.label not in self.banned]

    def _shortlist(self, scores: Sequence[Scored]) -> list[Scored]:
        """The best few that pass the screening, and what the best one is easily confused with."""
        able = []
        for one in scores:
            why = refusal(Stage.SCREENED, Trial(one.variant, scored=one))
            if why is None:
                able.append(one)
            elif why.reason is Reason.WEAK:
                self.refused.setdefault(one.variant.label, why)
            else:
                self.refused[one.variant.label] = why
        if not able:
            return []
        close = [one for one in able if one.drop > SHARE * able[0].drop][:FITTED]
        rivals = {c.other for one in close[:1] for c in one.variant.definition.confused_with}
        more = [one for one in able if one.variant.effect in rivals and one not in close]
        return close + more[:MORE_FITTED]

    def _fitted(self, shortlist: Sequence[Scored], before: Fit) -> list[Trial]:
        """Joint fits of candidates, the best one first."""
        trials = []
        for one in shortlist:
            self.progress(f"fitting {one.variant.effect}", -1.0)
            keys = (*self.now.keys, *one.variant.keys)
            start = started(self.now.point, one, self.shapes)
            fit = self.problem.fit(start, keys, settled=ROUGHLY)
            fit = self._nested(fit, before, one.variant)
            gain = before.cost - fit.cost - PENALTY * len(one.variant.keys)
            trials.append(Trial(one.variant, fit, gain))
        trials.sort(key=lambda trial: trial.gain, reverse=True)
        # What cannot be there explains nothing, and sets no bar for others.
        able = [(t.gain, t.variant.effect) for t in trials if t.fit and _possible(t)]
        for trial in trials:
            trial.best = able[0] if able else (0.0, "")
        return trials

    def _nested(self, fit: Fit, before: Fit, variant: Variant) -> Fit:
        """A fit with a variant, from where it is absent if that is better than where the fit with
        its screened size ended."""
        if fit.cost <= before.cost:
            return fit
        point = before.point | {k: self.shapes.get(k, absent(k)) for k in variant.keys}
        return self.problem.fit(point, fit.keys, settled=ROUGHLY)

    def _join(self, trial: Trial, others: Sequence[Trial]) -> None:
        assert trial.fit is not None
        assert trial.evidence is not None
        variant = trial.variant
        rivals = [
            (other.variant.effect, trial.gain - other.gain)
            for other in others
            if other.variant.effect != variant.effect
            and other.gain > trial.gain - RIVAL
            and _possible(other)
        ]
        self.accepted.append(Accepted(variant, trial.evidence, rivals))
        self.refused.pop(variant.label, None)
        self.tried.add(self._names())
        self.now = trial.fit

    # Backward.

    def drop_needless(self) -> bool:
        """Drop the accepted effect that the others do best without, if there is one."""
        if len(self.accepted) < 2:
            return False
        keys, point = self.now.keys, self.last.point
        covariance = self.last.covariance(keys)
        trials = []
        for one in self.accepted:
            own = [keys.index(key) for key in one.variant.sizes]
            cost = removal_cost(sizes_at(one.variant, point), covariance[np.ix_(own, own)])
            if not plausible(one.variant, point):
                cost = min(cost, 0.0)
            trials.append((cost, one))
        cost, worst = min(trials, key=lambda item: item[0])
        why = refusal(Stage.JOINED, Trial(worst.variant, removal=cost))
        if why is None:
            return False
        self._drop(worst, why)
        return True

    def drop_disputed(self) -> bool:
        """Drop, for good, the effect on whose size channels or recordings disagree most."""
        worst: tuple[float, Accepted, Refusal] | None = None
        for one in self.accepted:
            t, parts = by_parts(self.problem, self.now, one.variant)
            one.evidence = replace(one.evidence, t=t, parts=parts)
            why = refusal(Stage.STABLE, Trial(one.variant, evidence=one.evidence))
            errors = max(one.evidence.spread(0)[0], one.evidence.spread(1)[0])
            if why is not None and (worst is None or errors > worst[0]):
                worst = errors, one, why
        if worst is None:
            return False
        _, one, why = worst
        self.banned.add(one.variant.label)
        self._drop(one, why)
        return True

    def drop_drowned(self) -> Leftover:
        """Judge the residual; what is small beside an unexplained structure loses its name.

        It stays in the fit: a centre of gravity that sits elsewhere in each flight, left out, took
        a third of the moment of velocity and a tenth of c1 with it on real flights.
        """
        left, slow = leftover(self.problem, self.now, self.validation)
        for one in list(self.accepted):
            trial = Trial(one.variant, evidence=one.evidence, slow=slow)
            why = refusal(Stage.LEFT, trial)
            if why is not None and self.judge is not None:
                trial.predicted = self._predicted(one)
                why = refusal(Stage.LEFT, trial)
            if why is not None:
                self.refused[one.variant.label] = why
                self.accepted.remove(one)
                self.beside.append(one.variant)
        return left

    def settle_trim(self) -> None:
        """Learn how far the trims of flights differ beside what was found, and fit with that."""
        for _ in range(TRIM_ROUNDS):
            self.problem.learn_trim(self.now.point)
            self.now = self.problem.fit(self.now.point, self.now.keys)
        self.trims = {self._names(): self.problem.trim}

    def settle(self) -> bool:
        """Ask predictions, and the sizes that are left at the very end; whether anything left."""
        changed, leaves = False, True
        while leaves:
            if self.judge is not None:
                changed |= answer_to_predictions(self, self._judged)
                changed |= drop_idle(self, self._judged)
            leaves = self.drop_implausible()
            changed |= leaves
        return changed

    def drop_implausible(self) -> bool:
        """Take back, the weakest first, what the last fits left with a size that cannot be; whether
        anything was."""
        changed = False
        while True:
            asked = ((one, Trial(one.variant, self.now)) for one in self.accepted)
            out = [(one, why) for one, trial in asked if (why := refusal(Stage.SETTLED, trial))]
            if not out:
                return changed
            one, why = min(out, key=lambda each: each[0].evidence.drop)
            self.accepted.remove(one)
            self.refused[one.variant.label] = why
            self.now = self.refit(self.accepted, self.held)
            changed = True

    def _predicted(self, one: Accepted) -> float:
        """Share of the squared excess over noise that predictions lose with an effect."""
        rest = [other for other in self.accepted if other is not one]
        excess = self._judged(self.refit(rest, self.held).point).gap ** 2 - 1.0
        left = self._judged(self.now.point).gap ** 2 - 1.0
        return 1.0 - left / excess if excess > 0.0 else 0.0

    def _judged(self, point: Point) -> Predicted:
        """Predictions of held-out rows with what is named at a point."""
        assert self.judge is not None
        return self.judge(self._named_point(point))

    def _named_point(self, point: Point) -> Point:
        for variant in self.beside:
            point = without(point, variant)
        return point

    def hold_base(self) -> None:
        """Give back the base constants that these data do not improve; standard errors are those
        of the fit in which everything was free."""
        self.errors = self.now.stderr()
        self.held, point = not_improved(self.problem, self.now, self.groups, self.validation)
        if self.held:
            self.now = replace(self.now, point=point)
            self.now = self.refit(self.accepted, self.held)
        while group := unconfirmed(self.problem, self.now):
            self.held.update(group)
            self.now = self.refit(self.accepted, self.held)

    def name_base_changes(self) -> None:
        """A base constant that moved so far that the change has a name becomes that effect.

        Where an effect of supply, motors or rotors or one that is easily taken for it is in the
        model, the constant may have moved to make room for that: then the change has to be the
        same without it.
        """
        for variant in self.renames:
            assert variant.definition.renames is not None
            key, (own,) = variant.definition.renames.constant, variant.sizes
            if key in self.held or key not in self.now.keys:
                continue
            held = self.held | {key}
            before, after = self._renamed(self.accepted, held, own)
            evidence = gather(self.problem, self.validation, before, after, variant)
            trial = Trial(variant, after, evidence=evidence)
            if refusal(Stage.WEIGHED, trial) or refusal(Stage.NAMED, trial):
                continue
            apart = [one for one in self.accepted if not _shares(one.variant, variant)]
            if len(apart) < len(self.accepted):
                _, alone = self._renamed(apart, held, own)
                if abs(alone.point[own] - after.point[own]) > variant.definition.negligible:
                    continue
            self.now, self.held = after, held
            self.accepted.insert(0, Accepted(variant, evidence, []))
            self.errors[own] = after.stderr()[own]
            self.held_out[variant.label] = evidence.held_out

    def _renamed(self, accepted: Sequence[Accepted], held: set[str], own: str) -> tuple[Fit, Fit]:
        """Fits with the constants ``held`` as given, without and with the size ``own``."""
        before = self.refit(accepted, held)
        return before, self.problem.fit(before.point, (*before.keys, own))

    def _drop(self, one: Accepted, why: Refusal) -> None:
        self.accepted.remove(one)
        self.refused[one.variant.label] = why
        self._refit_without(one.variant)

    def _refit_without(self, *variants: Variant) -> None:
        point = self.now.point
        for variant in variants:
            point = without(point, variant)
        joined = (key for one in self.accepted for key in one.variant.keys)
        self.now = self.problem.fit(point, (*self.base_keys, *joined))

    def refit(self, accepted: Sequence[Accepted], held: set[str]) -> Fit:
        """The joint fit of some effects, with the constants ``held`` as they were given."""
        # Without what explains a trim, none is too large: a constant would make room for it.
        self.problem.trim = self.trims.get(_names(accepted), self.trim)
        fitted = (*(one.variant for one in accepted), *self.beside)
        keys = (*self.base_keys, *(key for variant in fitted for key in variant.keys))
        start = self.problem.start
        point = {key: self.now.point[key] for key in keys if key in self.now.point}
        point |= {key: start.get(key, absent(key)) for key in held} | self.fixed
        return self.problem.fit(point, [key for key in keys if key not in held])

    def point_with(self, accepted: Sequence[Accepted]) -> Point:
        """The final constants, with only some of the effects."""
        keys = {*self.base_keys, *(key for one in accepted for key in one.variant.keys)}
        return {k: number for k, number in self.now.point.items() if k in keys} | self.fixed

    def _names(self, *more: str) -> frozenset[str]:
        return _names(self.accepted) | {*more}


def _names(accepted: Sequence[Accepted]) -> frozenset[str]:
    return frozenset(one.variant.label for one in accepted)


def _shares(variant: Variant, other: Variant) -> bool:
    """Whether a variant can take a share of what a change of a base constant (``other``) does."""
    one = variant.definition
    rivals = {confusion.other for confusion in other.definition.confused_with}
    return one.name in rivals or one.stage in ("supply", "motor", "rotor")


def _possible(trial: Trial) -> bool:
    return trial.fit is not None and plausible(trial.variant, trial.fit.point)


def _placed(plain: Screening, one: Scored) -> dict[str, float]:
    """The given model with an effect at its screened size."""
    values = dict(zip(one.variant.sizes, one.values.tolist(), strict=True))
    return {**plain.point, **{key: absent(key) + size for key, size in values.items()}}


def _removal(fit: Fit, variant: Variant) -> float:
    own = [fit.keys.index(key) for key in variant.sizes]
    return removal_cost(sizes_at(variant, fit.point), fit.covariance[np.ix_(own, own)])
