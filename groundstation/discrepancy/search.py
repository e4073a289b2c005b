"""The search: effects are added, dropped and settled until nothing more is worth a name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.acceptance import (
    JOINED,
    NAMED,
    SCREENED,
    TOUCHES,
    WEIGHED,
    Group,
    Last,
    groups,
    not_improved,
    plausible,
    refusal,
    unconfirmed,
)
from groundstation.discrepancy.disturbances import (
    Slow,
    best_followed,
    slow_part,
    with_term,
)
from groundstation.discrepancy.proof import (
    LEFT,
    FittedRows,
    Leftover,
    Predicted,
    Reason,
    Refusal,
    Weight,
    weight,
)
from groundstation.discrepancy.screening import (
    PENALTY,
    Evidence,
    Scored,
    Screening,
    cost_without,
    folds_of,
    gather,
    leftover,
    screen,
    settle,
    started,
    tried,
    without,
)
from groundstation.dynamics.effect import CANDIDATES
from groundstation.dynamics.model import Model
from groundstation.identification.likelihood.motion import RENAMES, Point, Variant, absent
from groundstation.identification.likelihood.problem import STEPS, Fit, Problem

# How a search judges what it found by predictions.
#
# What drifts slowly is in every prediction and belongs to no effect of a search: beside it one that
# is right may seem to predict worse. So it is followed where effects are weighed. Whether it has a
# name is asked of the final model (``slow_disturbance``), and so is whether that predicts worse.


CLEARLY_T = 2.0
"""Standard errors by which a channel is worse beside what is followed. There one is no reason: how
much of a channel the follower takes depends on the model a little, and that the given model as it
is predicts nothing better is asked of the final one."""


class Judge:
    """Fitted rows as the model at a point predicts them, beside what the given model says; the
    observer follows what is ``slow`` in both alike, where it is given."""

    def __init__(
        self, fitted: FittedRows, model_at: Callable[[Point], Model], slow: Slow | None = None
    ) -> None:
        self._given, self._model_at, self._slow = fitted, model_at, slow
        given = fitted.before.model
        self._beside = FittedRows(fitted.of(with_term(given, slow))) if slow else fitted

    def __call__(self, point: Point) -> Predicted:
        model = self._model_at(point)
        if self._slow is None:
            return self._given.judge(model)
        found = self._beside.judge(with_term(model, self._slow))
        if not found.worse:
            return found
        # A channel that is predicted better where nothing is followed is no witness, nor is one
        # within noise that hardly changes.
        better = self._given.of(model).rms < self._given.before.rms
        before = self._beside.before
        hardly = LEFT * before.rms / before.noise_floor
        worse = {
            channel: t
            for channel, t in found.worse.items()
            if t >= CLEARLY_T
            and not better[channel]
            and not found.gaps[channel] <= min(1.0, hardly[channel])
        }
        return replace(found, worse=worse)

    def weights(self, point: Point, accepted: Sequence[Evidence]) -> dict[str, Weight]:
        """What each of these effects carries, by label; none of those that touch only channels in
        which nothing is left to explain."""
        improved, found = self._model(point), {}
        near = self._beside.of(improved)
        now = self._beside.squares(improved)
        for one in accepted:
            left = self._beside.squares(self._model(without(point, one.variant)), near)
            carried = weight(self._given.before.gap, now, left, one.channels)
            if carried is not None:
                found[one.variant.label] = carried
        return found

    def _model(self, point: Point) -> Model:
        """With what is slow."""
        model = self._model_at(point)
        return model if self._slow is None else with_term(model, self._slow)


def to_follow(fitted: Comparison) -> Slow | None:
    """What a model leaves of fitted rows that lasts, as predictions are best; None: nothing does,
    or the model says of itself what is slow."""
    if fitted.model.disturbance is not None:
        return None
    slow = slow_part(fitted.errors)
    return best_followed(slow, fitted) if slow.is_there else None


# What a search has come to: the effects that joined, those that did not and why, the joint fit.


Progress = Callable[[str, float], None]

ROUGHLY = 0.5
"""Drop of -2 log L at which a joint fit of a candidate ends."""


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
        self.known, self.candidates = known, list(candidates)
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
        """Standard errors by key, everything being free."""
        self.accepted: list[Evidence] = []
        self.refused: dict[str, Refusal] = {}
        """By label, why a variant is not named."""
        self.held_out: dict[str, float] = {}
        """By label, the drop of -2 log L on flights left out when it was weighed last."""
        self.weights: dict[str, Weight] = {}
        """By label, what an effect carries."""
        self.banned: set[str] = set()
        self.shapes: Point = {}
        """Of effects with a shape that is tried: its best value."""
        self.first: Screening  # at the model as it was given
        self.scores: list[Scored]  # of it
        self.last: Screening
        self.now: Fit
        self.residual: Leftover

    def able(self) -> list[Variant]:
        """The candidates that may still join."""
        joined = {one.variant.effect for one in self.accepted}
        return [v for v in self.candidates if v.effect not in joined and v.label not in self.banned]

    def drop(self, *failed: tuple[Evidence, Refusal], steps: int = STEPS) -> None:
        """Take effects out, and fit the others without them, in so many steps at most."""
        point = self.now.point
        for one, why in failed:
            self.accepted.remove(one)
            self.refused[one.variant.label] = why
            point = without(point, one.variant)
        joined = (key for one in self.accepted for key in one.variant.keys)
        self.now = self.problem.fit(point, (*self.base_keys, *joined), steps)

    def refit(
        self,
        accepted: Sequence[Evidence],
        held: set[str],
        sizes: Sequence[str] = (),
        rough: bool = False,
    ) -> Fit:
        """The joint fit of some effects, and of ``sizes`` from where they are absent, with the
        constants ``held`` as they were given. rough: with the columns of where it begins."""
        # Without what explains a trim, none is too large: a constant would make room for it.
        self.problem.trim = self.trims.get(names_of(accepted), self.trim)
        keys = (*self.base_keys, *(key for one in accepted for key in one.variant.keys), *sizes)
        start = self.problem.start
        point = {key: self.now.point[key] for key in keys if key in self.now.point}
        point |= {key: start.get(key, absent(key)) for key in held} | self.fixed
        return self.problem.fit(point, [key for key in keys if key not in held], rough=rough)

    def weighed(self, fit: Fit, variants: Sequence[Variant]) -> list[Evidence]:
        """What speaks for each of these effects of a joint fit beside the others."""
        return gather(self.problem, self.folds, fit, variants)


def names_of(accepted: Sequence[Evidence]) -> frozenset[str]:
    """Labels of effects, by which a set of them is known."""
    return frozenset(one.variant.label for one in accepted)


# The last question: what was found has to predict fitted samples, 20 and 50 ms ahead.
#
# The search looks one row ahead, where torque shows best; what a model is for is further ahead. An
# effect or a changed constant with which a channel is predicted worse than by the given model is
# taken back, and so is an effect without which all channels together are predicted better.


Without = tuple[Predicted, Evidence | Group, Fit]
"""What predictions say of the joint fit without an effect or a changed constant, and that fit."""


def answer_to_predictions(search: SearchState, judge: Judge) -> bool:
    """Take back, one by one, what predictions speak against; whether anything was. What the effects
    that stay carry is in ``search.weights`` then.

    Where a channel is predicted worse than by the given model, something leaves each time: at the
    end of that way stands the given model.
    """
    now, changed = judge(search.now.point), False
    while trials := _trials(search, judge, now):
        now, changed = _take_back(search, now, trials), True
    while trials := _raising(search, judge, now):
        now, changed = _take_back(search, now, trials), True
    return changed


def _take_back(search: SearchState, now: Predicted, trials: Sequence[Without]) -> Predicted:
    """The best of these ways; what predictions say then."""
    left, option, fit = min(trials, key=lambda trial: trial[0].badness)
    if isinstance(option, tuple):
        search.held.update(option)
    else:
        search.accepted.remove(option)
        search.refused[option.variant.label] = _refusal(now, left)
    search.now = fit
    search.now = search.refit(search.accepted, search.held)
    return left


def _raising(search: SearchState, judge: Judge, now: Predicted) -> list[Without]:
    """The same without each effect that raises the gap, where no channel is worse without it."""
    search.progress("asking what each name carries", 0.93)
    search.weights = judge.weights(search.now.point, search.accepted)
    trials = [
        _without(search, judge, one)
        for one in search.accepted
        if (own := search.weights.get(one.variant.label)) and own.raises
    ]
    return [one for one in trials if not one[0].worse and one[0].gap < now.gap]


def _trials(search: SearchState, judge: Judge, now: Predicted) -> list[Without]:
    """What predictions say without each effect or changed constant that may be at fault.

    Where channels are predicted worse, those that touch them; where none of these makes it better,
    every other one as well: a filter that is not there is hardly seen in the rates one row ahead,
    and spoils them 50 ms ahead.
    """
    if not now.worse:
        return []
    near, others = _by_channels(search, now.worse)
    trials = [_without(search, judge, one) for one in near]
    if all(left.badness[0] >= now.badness[0] for left, _, _ in trials):
        trials += [_without(search, judge, one) for one in others]
    return trials


def _without(search: SearchState, judge: Judge, option: Evidence | Group) -> Without:
    search.progress("asking predictions of fitted samples", 0.93)
    rest = [one for one in search.accepted if one is not option]
    held = search.held.union(option) if isinstance(option, tuple) else search.held
    fit = search.refit(rest, held, rough=True)
    return judge(fit.point), option, fit


def _refusal(now: Predicted, left: Predicted) -> Refusal:
    mended = [channel for channel in now.worse if channel not in left.worse]
    if mended:
        words = f"predicts {_named(mended)} on fitted samples worse than the given model"
    elif now.worse:
        words = (
            f"{_named(now.worse)} on fitted samples would be predicted worse than by the given"
            " model; it is what costs the least to take out"
        )
    else:
        words = (
            f"fitted samples are predicted better without it: the gap of {now.gap:.2f} falls by"
            f" {100.0 * (1.0 - left.gap / now.gap):.1f} %"
        )
    return Refusal(Reason.PREDICTS_WORSE, words)


def _named(channels: Iterable[int]) -> str:
    return ", ".join(CHANNELS[channel] for channel in channels)


def _by_channels(
    search: SearchState, worse: Iterable[int]
) -> tuple[list[Evidence | Group], list[Evidence | Group]]:
    """Effects and changed constants that touch these channels, and the others."""
    bad = set(worse)
    every = range(len(CHANNELS))
    near: list[Evidence | Group] = []
    others: list[Evidence | Group] = []
    for one in search.accepted:
        (near if bad.intersection(one.channels) else others).append(one)
    for group in search.groups:
        if not search.held.issuperset(group):
            touches = bad.intersection(TOUCHES.get(group[0], every))
            (near if touches else others).append(group)
    return near, others


# The end of a search: which changed constants stay, which change has a name, and whether what was
# found predicts fitted samples.


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
        after = search.refit(search.accepted, held, (own,), rough=True)
        (evidence,) = search.weighed(after, [variant])
        if refusal(WEIGHED, evidence) or refusal(NAMED, Last(variant, after)):
            continue
        after = search.problem.fit(after.point, after.keys)
        (evidence,) = search.weighed(after, [variant])
        apart = [one for one in search.accepted if not _shares(one.variant, variant)]
        if len(apart) < len(search.accepted):
            alone = search.refit(apart, held, (own,))
            if abs(alone.point[own] - after.point[own]) > variant.definition.negligible:
                continue
        search.now, search.held = after, held
        search.accepted.insert(0, evidence)
        search.errors[own] = after.stderr()[own]
        search.held_out[variant.label] = evidence.held_out


def _shares(variant: Variant, other: Variant) -> bool:
    """Whether a variant can take a share of what a change of a base constant (``other``) does."""
    one = variant.definition
    rivals = {confusion.other for confusion in other.definition.confused_with}
    return one.name in rivals or one.stage in ("supply", "motor", "rotor")


# Backward: what leaves the model again, because the others do as well without it, or because it
# fails what it passed before the others joined.


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
    why = refusal(JOINED, cost)
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


def failing(search: SearchState, variants: Sequence[Variant]) -> list[tuple[Evidence, Refusal]]:
    """Ask each of these effects of the joint fit beside the others; those that fail, the weakest
    last, and why. All are accepted until they are dropped, the strongest first."""
    weighed = search.weighed(search.now, variants)
    search.accepted = sorted(weighed, key=lambda one: -one.drop)
    search.held_out |= {one.variant.label: one.held_out for one in weighed}
    return [(one, why) for one in search.accepted if (why := refusal(WEIGHED, one))]


# Forward: what joins the model. Candidates are screened, the best few fitted jointly, and the
# first that passes the gates joins.


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
        sizes = zip(one.variant.sizes, one.values.tolist(), strict=True)
        placed = {key: absent(key) + size for key, size in sizes}
        if first and plausible(one.variant, {**plain.point, **placed}):
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
    nothing = plain.point | {key: absent(key) for one in sure for key in one.variant.keys}
    search.now = search.problem.fit(search.problem.better(point, nothing, keys), keys)
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
    """Fit each of these jointly, and join the first, the best one first, that passes."""
    trials = []
    for one in shortlist:
        variant, keys = one.variant, (*search.now.keys, *one.variant.keys)
        search.progress(f"fitting {variant.effect}", -1.0)
        start = started(search.now.point, one, search.shapes)
        fit = search.problem.fit(start, keys, settled=ROUGHLY, rough=True)
        if fit.cost > before.cost:  # than where it is absent: from there
            point = before.point | {k: search.shapes.get(k, absent(k)) for k in variant.keys}
            fit = search.problem.fit(point, fit.keys, settled=ROUGHLY, rough=True)
        gain = before.cost - fit.cost - PENALTY * len(variant.keys)
        trials.append((gain, variant, fit))
    for _, variant, fit in sorted(trials, key=lambda trial: -trial[0]):
        (evidence,) = search.weighed(fit, [variant])
        evidence = replace(evidence, drop=before.cost - fit.cost)
        search.held_out[variant.label] = evidence.held_out
        why = refusal(WEIGHED, evidence)
        if why is None:
            search.accepted.append(evidence)
            search.refused.pop(variant.label, None)
            search.now = fit
            return True
        search.refused[variant.label] = why
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
        why = refusal(SCREENED, one)
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
        return refusal(SCREENED, one[0]) is None, one[0].drop

    return [max(some, key=worth) for some in tried(search.problem, point, keys, search.able())]


def _shortlist(search: SearchState, scores: Sequence[Scored]) -> list[Scored]:
    """The best few that pass the screening, and what the best one is easily confused with."""
    able = []
    for one in scores:
        why = refusal(SCREENED, one)
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


# The procedure: screen every effect, add the best one, drop what became needless, until stable.
#
# ``search_effects`` and ``answer_to_predictions`` are the whole of it; what comes before and after
# is ``engine.find_effects``. Columns of every effect are
# evaluated once a round (``screening.py``), the best few are fitted jointly with the base and what
# was accepted before, and each stage has its gates (``acceptance.py``).


MOST_ROUNDS = 16


def search_effects(search: SearchState) -> None:
    """From the model as it was given to a set of effects that stays, but for what
    predictions say of it (``answer_to_predictions``)."""
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
