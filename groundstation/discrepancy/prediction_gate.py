"""The last question: what was found has to predict fitted samples, 20 and 50 ms ahead.

The search looks one row ahead, where torque shows best; what a model is for is further ahead. An
effect or a changed constant with which a channel is predicted worse than by the given model is
taken back, and so is an effect without which all channels together are predicted better.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.base_constants import TOUCHES, Group
from groundstation.discrepancy.findings import Predicted, Reason, Refusal
from groundstation.discrepancy.search_state import Accepted, Judge, SearchState
from groundstation.identification.likelihood.problem import Fit

Without = tuple[Predicted, Accepted | Group, Fit]
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


def _without(search: SearchState, judge: Judge, option: Accepted | Group) -> Without:
    search.progress("asking predictions of fitted samples", 0.93)
    rest = [one for one in search.accepted if one is not option]
    held = search.held.union(option) if isinstance(option, tuple) else search.held
    fit = search.refit(rest, held)
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
) -> tuple[Sequence[Accepted | Group], Sequence[Accepted | Group]]:
    """Effects and changed constants that touch these channels, and the others."""
    bad = set(worse)
    every = range(len(CHANNELS))
    near: list[Accepted | Group] = []
    others: list[Accepted | Group] = []
    for one in search.accepted:
        (near if bad.intersection(one.evidence.channels) else others).append(one)
    for group in search.groups:
        if not search.held.issuperset(group):
            touches = bad.intersection(TOUCHES.get(group[0], every))
            (near if touches else others).append(group)
    return near, others
