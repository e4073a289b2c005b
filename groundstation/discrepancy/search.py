"""The search: screen every effect, refit the few best, accept one, drop what became needless.

Starts from the model as it was given. In each round all columns are evaluated
once and every effect is scored from one Gram matrix; the best few are fitted jointly with the
base and what was accepted before; the best one that passes every test of ``judge`` joins. Then
whatever the newcomer made superfluous leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.flight import Flight
from groundstation.discrepancy.judge import (
    Evidence,
    by_parts,
    disagreement,
    judge,
    plausible,
    refusal,
)
from groundstation.discrepancy.own_candidates import OwnEffect
from groundstation.discrepancy.problem import BASE_KEYS, Fit, Linear, Problem, bounded
from groundstation.discrepancy.spectra import Quadratic
from groundstation.discrepancy.unknowns import (
    ABSENT,
    BODY_KEYS,
    LOW_PASS,
    TIMING,
    VARIANTS,
    Point,
    Variant,
    absent,
)
from groundstation.dynamics.effects.catalogue import EFFECTS
from groundstation.identification.estimate import inverse

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

WORTH = 16.0
"""Drop of -2 log L in the screening from which an effect is worth a joint fit."""
SHARE = 0.35
"""An effect that explains less than this share of what the best one does is not fitted."""
FITTED = 4
"""Joint fits in a round, at most, and effects easily confused with the best one."""
PENALTY = 8.0
"""For each parameter, in -2 log L."""
KEEP = 14.0
"""An accepted effect whose removal costs less than this leaves."""
BENT, SETTLINGS = 0.12, 8
"""A body constant so far off (in the logarithm) is not where columns are evaluated; how often it
is moved: by a factor of five at most each time."""
CURVED = {
    "dead_time.delay_s": 3e-4,
    LOW_PASS: 3e-4,
    "rotor_gyroscopic_torque.rotor_inertia_kg_m2": 1e-8,
    "rotor_acceleration_torque.rotor_inertia_kg_m2": 1e-8,
    "attitude_filter_lean.strength": 0.1,
}
"""Unknowns that others depend on, and how far from its place each may stay."""
SURE = 100.0
"""Drop of -2 log L beside every other effect from which one is taken without a contest: 10
standard errors, where no rival can be within reach."""
TURNS = 3
"""How often the next best are tried where the best were refused."""
RIVAL = 12.0
"""An effect that explains so little less, in -2 log L, is an alternative."""
ROUGHLY = 0.5
"""Drop of -2 log L at which a joint fit of a candidate ends."""
MOST_ROUNDS = 16
NOTHING_LEFT = "no significant improvement"
"""Said of what the screening finds too weak, beside whatever was accepted before."""


@dataclass(frozen=True, slots=True)
class Scored:
    """What the screening says of a variant: drop of -2 log L, and estimates with errors."""

    variant: Variant
    drop: float
    values: Array
    errors: Array

    @property
    def t(self) -> float:
        return float(np.max(np.abs(self.values) / np.maximum(self.errors, 1e-300)))


@dataclass(slots=True)
class Accepted:
    variant: Variant
    evidence: Evidence
    rivals: list[tuple[str, float]]
    fit: Fit
    gap: tuple[float, float]


@dataclass(slots=True)
class Outcome:
    """final: the joint fit. first: the screening before anything joined. reasons: variant label
    -> why it was refused. linear, quadratic: at the final point; first_linear, first_quadratic:
    at the model as it was given."""

    final: Fit
    accepted: list[Accepted]
    first: list[Scored]
    scores: list[Scored]
    held_out: dict[str, float]
    reasons: dict[str, str]
    linear: Linear
    quadratic: Quadratic
    first_linear: Linear
    first_quadratic: Quadratic
    trials: list[Fit] = field(default_factory=list)


def search(
    problem: Problem,
    validation: Sequence[Flight],
    known: Sequence[Variant],
    candidates: Sequence[Variant],
    progress: Progress,
) -> Outcome:
    """Find the effects among ``candidates`` that the flights show. known: effects of the model,
    fitted along and never dropped."""
    every = problem.every_key
    base_keys = (*BASE_KEYS, *(key for variant in known for key in variant.keys))
    # The base is not fitted alone first: bent to imitate what is missing, it would be a poor place
    # to linearise at. A centre of gravity off its place makes c0 vanish, for one.
    progress("screening", 0.1)
    first_linear, first_quadratic = _settled(problem, every)
    origin, seen = _without_effects(first_linear, first_quadratic, base_keys)
    first = screen(origin, seen, base_keys, candidates)
    reasons: dict[str, str] = {}
    held_out: dict[str, float] = {}
    now, accepted = _sure(
        problem, validation, first_linear, first_quadratic, base_keys, candidates, reasons, progress
    )
    held_out |= {one.variant.label: one.evidence.held_out for one in accepted}
    tried: set[frozenset[str]] = {frozenset(one.variant.label for one in accepted)}
    banned: set[str] = set()
    for number in range(MOST_ROUNDS):
        progress(
            "screening" if not accepted else f"screening after {len(accepted)} effects",
            min(0.9, 0.1 + 0.2 * number),
        )
        linear = problem.linear(now.point, every, problem.flights)
        linear = problem.learn_noise(linear)
        total = problem.with_prior(linear)
        dropped = _needless(linear, total, now.keys, accepted)
        if dropped is not None:
            accepted.remove(dropped)
            reasons[dropped.variant.label] = "superfluous once another effect had joined"
            now = problem.fit(_without(now.point, dropped.variant), _keys(base_keys, accepted))
            continue
        joined = {one.variant.effect for one in accepted} | {one.effect for one in known}
        able = [v for v in candidates if v.effect not in joined and v.label not in banned]
        scores = screen(linear, total, now.keys, able)
        newcomer = _round(
            problem,
            validation,
            now,
            scores,
            accepted,
            reasons,
            held_out,
            tried,
            base_keys,
            progress,
        )
        if newcomer is None:
            offender = _offender(problem, now, accepted)
            if offender is None:
                break
            one, why = offender
            accepted.remove(one)
            banned.add(one.variant.label)
            reasons[one.variant.label] = why
            now = problem.fit(_without(now.point, one.variant), _keys(base_keys, accepted))
            continue
        accepted.append(newcomer)
        reasons.pop(newcomer.variant.label, None)
        tried.add(frozenset(one.variant.label for one in accepted))
        now = newcomer.fit
    now = problem.fit(now.point, now.keys)
    return Outcome(
        now,
        accepted,
        first,
        scores,
        held_out,
        reasons,
        linear,
        total,
        first_linear,
        first_quadratic,
    )


def _settled(problem: Problem, every: Sequence[str]) -> tuple[Linear, Quadratic]:
    """All columns where a fit of every effect at once says that they mean something.

    A base that was fitted to the affected flights may be bent so far that no column evaluated
    there means anything; delays, lags and the rotors' inertia multiply each other, and yaw
    torque behind a lag looks like the rotors' acceleration. So the body's constants and
    what is far from linear move to what all effects together say, until they stay.
    """
    point = dict(problem.start)
    for _ in range(SETTLINGS):
        linear = problem.linear(point, every, problem.flights)
        linear = problem.learn_noise(linear)
        total = problem.with_prior(linear)
        change = _within_reason(linear, total)
        at = linear.place(BODY_KEYS)
        moved = bounded(point, BODY_KEYS, change[at])
        bent = any(abs(np.log(moved[key] / point[key])) > BENT for key in BODY_KEYS)
        goals = bounded(point, list(CURVED), change[linear.place(list(CURVED))])
        far = [key for key, near in CURVED.items() if _away(point, goals, key) > near]
        if not bent and not far:
            break
        if bent or any(key in point for key in far):
            point = moved
        point |= {key: goals[key] for key in far}
    return linear, total


def _within_reason(linear: Linear, total: Quadratic) -> Array:
    """The change (p,) to the best fit of everything at once, with each effect's range as a weak
    prior: a yaw damping of a thousand times that would bend c2 tenfold to go with it."""
    normal, gradient = total.normal.copy(), total.gradient.copy()
    for i, key in enumerate(linear.keys):
        if key in ABSENT:
            low, high = range_of(key)
            size = max(abs(low - ABSENT[key]), abs(high - ABSENT[key]))
            normal[i, i] += size**-2
            gradient[i] += (ABSENT[key] - linear.point.get(key, ABSENT[key])) / size**2
    return np.asarray(inverse(normal) @ gradient)


def _away(point: Point, goals: Point, key: str) -> float:
    return abs(goals[key] - point.get(key, absent(key)))


def _without_effects(
    linear: Linear, total: Quadratic, kept: Sequence[str]
) -> tuple[Linear, Quadratic]:
    """The same parabola seen from where every effect but those behind ``kept`` is absent."""
    gone = {k: absent(k) for k in linear.keys if k not in BASE_KEYS and k in linear.point}
    gone = {k: v for k, v in gone.items() if k not in kept}
    if not gone:
        return linear, total
    step = np.array([gone[k] - linear.point[k] if k in gone else 0.0 for k in linear.keys])
    value = total.value - 2.0 * total.gradient @ step + step @ total.normal @ step
    there = replace(linear, point={k: v for k, v in linear.point.items() if k not in gone})
    moved = replace(total, gradient=total.gradient - total.normal @ step, value=float(value))
    return there, moved


def screen(
    linear: Linear, total: Quadratic, base_keys: Sequence[str], variants: Sequence[Variant]
) -> list[Scored]:
    """Every variant's drop of -2 log L when it joins ``base_keys``, best first."""
    at = linear.place(base_keys)
    base = inverse(total.normal[np.ix_(at, at)])
    settled = base @ total.gradient[at]
    scored = []
    for variant in variants:
        keys = [key for key in variant.keys if key != "ground_effect.height_m"]
        own = linear.place(keys)
        cross = total.normal[np.ix_(own, at)]
        normal = total.normal[np.ix_(own, own)]
        left = normal - cross @ base @ cross.T
        gradient = total.gradient[own] - cross @ settled
        alive = np.diag(left) > 1e-9 * np.maximum(np.diag(normal), 1e-300)
        values, errors, drop = np.zeros(len(keys)), np.full(len(keys), np.inf), 0.0
        if alive.any():
            inside = np.ix_(alive, alive)
            covariance = inverse(left[inside])
            values[alive] = covariance @ gradient[alive]
            errors[alive] = np.sqrt(np.diag(covariance))
            drop = float(gradient[alive] @ values[alive])
        scored.append(Scored(variant, drop, values, errors))
    return sorted(scored, key=lambda one: one.drop - PENALTY * len(one.variant.keys), reverse=True)


def _sure(
    problem: Problem,
    validation: Sequence[Flight],
    linear: Linear,
    total: Quadratic,
    base_keys: tuple[str, ...],
    candidates: Sequence[Variant],
    reasons: dict[str, str],
    progress: Progress,
) -> tuple[Fit, list[Accepted]]:
    """Join what is beyond doubt beside every other effect, all at once.

    One by one, the first to join would have to stand for those that are still missing. Evidence
    is gathered by taking the weakest away again and again; the order is the reverse.
    """
    origin, _ = _without_effects(linear, total, base_keys)
    covariance = inverse(total.normal)
    change = covariance @ total.gradient
    best: dict[str, tuple[float, Scored]] = {}
    for variant in candidates:
        linear_keys = [key for key in variant.keys if key != "ground_effect.height_m"]
        nothing = np.array([absent(key) for key in linear_keys])
        own = linear.place(linear_keys)
        there = np.array([linear.point.get(key, absent(key)) for key in linear_keys]) - nothing
        values, block = there + change[own], covariance[np.ix_(own, own)]
        one = Scored(variant, 0.0, values, np.sqrt(np.diag(block)))
        drop = float(values @ inverse(block) @ values) - PENALTY * (len(own) - 1)
        at = {**origin.point, **dict(zip(linear_keys, (values + nothing).tolist(), strict=True))}
        known = drop > SURE and np.isfinite(one.errors).all() and plausible(variant, at)
        if known and drop > best.get(variant.effect, (0.0,))[0]:
            best[variant.effect] = drop, one
    point = dict(origin.point)
    for _, one in best.values():
        point = _started(point, one)
    sure = [one.variant for _, one in best.values()]
    keys = (*base_keys, *(key for variant in sure for key in variant.keys))
    if not sure:
        return Fit(point, keys, np.inf, np.zeros((len(keys),) * 2)), []
    progress("fitting what is beyond doubt", 0.2)
    after = now = problem.fit(point, keys)
    found: list[Accepted] = []
    refused: list[Variant] = []
    while sure:
        costs = [_cost(after, variant) for variant in sure]
        weakest = sure.pop(int(np.argmin(costs)))
        progress(f"weighing {weakest.effect}", -1.0)
        rest = tuple(key for key in after.keys if key not in weakest.keys)
        before = problem.fit(_without(after.point, weakest), rest, settled=ROUGHLY)
        evidence = judge(problem, validation, before, after, weakest)
        why = refusal(weakest, after, evidence)
        if why:
            reasons[weakest.label] = why
            refused.append(weakest)
        else:
            found.insert(0, Accepted(weakest, evidence, [], after, evidence.gap))
        after = before
    if refused:
        point = now.point
        for variant in refused:
            point = _without(point, variant)
        now = problem.fit(point, _keys(base_keys, found))
    return now, found


def _cost(fit: Fit, variant: Variant) -> float:
    """What the others lose without a variant, in -2 log L, by the covariance of their fit."""
    keys = [key for key in variant.keys if key != "ground_effect.height_m"]
    own = [fit.keys.index(key) for key in keys]
    values = np.array([fit.point[key] - absent(key) for key in keys])
    return float(values @ inverse(fit.covariance[np.ix_(own, own)]) @ values)


def _round(
    problem: Problem,
    validation: Sequence[Flight],
    now: Fit,
    scores: list[Scored],
    accepted: list[Accepted],
    reasons: dict[str, str],
    held_out: dict[str, float],
    tried: set[frozenset[str]],
    base_keys: tuple[str, ...],
    progress: Progress,
) -> Accepted | None:
    """Fit the best candidates and return the one to accept.

    Where all of the best are refused, the next ones get their turn: what is wrong with the
    strongest need not be wrong with an effect on other channels.
    """
    before: Fit | None = None
    refused: set[str] = set()
    for _ in range(TURNS):
        left = [one for one in scores if one.variant.label not in refused]
        shortlist = _shortlist(left, reasons)
        if not shortlist:
            return None
        before = before or problem.fit(now.point, now.keys, steps=1)
        fits: list[tuple[float, Scored, Fit]] = []
        for one in shortlist:
            progress(f"fitting {one.variant.effect}", -1.0)
            keys = (*now.keys, *one.variant.keys)
            fit = problem.fit(_started(now.point, one), keys, settled=ROUGHLY)
            fits.append((before.cost - fit.cost - PENALTY * len(one.variant.keys), one, fit))
        fits.sort(key=lambda item: item[0], reverse=True)
        # What cannot be there explains nothing, and sets no bar for others.
        able = [(g, s.variant.effect) for g, s, f in fits if plausible(s.variant, f.point)]
        best, strongest = able[0] if able else (0.0, "")
        for gain, one, fit in fits:
            label = one.variant.label
            if gain <= 0.0 or gain < SHARE * best:
                reasons.setdefault(label, f"explains less than {strongest}")
                continue
            names = frozenset([label, *(other.variant.label for other in accepted)])
            evidence = judge(problem, validation, before, fit, one.variant)
            held_out[label] = evidence.held_out
            why = refusal(one.variant, fit, evidence) or ("tried before" if names in tried else "")
            if not why:
                return Accepted(one.variant, evidence, _rivals(gain, one, fits), fit, evidence.gap)
            reasons[label] = why
        refused |= {one.variant.label for one in shortlist}
    return None


def _rivals(
    gain: float, chosen: Scored, fits: Sequence[tuple[float, Scored, Fit]]
) -> list[tuple[str, float]]:
    """Other effects that explain nearly as much, with how much less."""
    return [
        (other.variant.effect, gain - less)
        for less, other, rival in fits
        if other.variant.effect != chosen.variant.effect
        and less > gain - RIVAL
        and plausible(other.variant, rival.point)
    ]


def _shortlist(scores: list[Scored], reasons: dict[str, str]) -> list[Scored]:
    """The best few with a plausible sign, and what the best one is easily confused with."""
    able = []
    for one in scores:
        if one.drop < WORTH + PENALTY * (len(one.variant.keys) - 1):
            reasons.setdefault(one.variant.label, NOTHING_LEFT)
        elif not _sign_possible(one):
            reasons[one.variant.label] = "fits only with a sign that physics does not allow"
        else:
            able.append(one)
    if not able:
        return []
    close = [one for one in able if one.drop > SHARE * able[0].drop][:FITTED]
    rivals = {c.other for one in close[:1] for c in one.variant.definition.confused_with}
    more = [one for one in able if one.variant.effect in rivals and one not in close]
    return close + more[:2]


def _sign_possible(one: Scored) -> bool:
    """Whether a one-sided parameter does not clearly point to the wrong side."""
    if len(one.variant.keys) > 1 and one.variant.effect != "ground_effect":
        return True
    key = one.variant.keys[0]
    low, high = range_of(key, one.variant.own)
    value = one.values[0] + absent(key)
    return bool(low < 0 or value > 0) and (key != "motor_braking_asymmetry.factor" or high > 0)


def range_of(key: str, own: OwnEffect | None = None) -> tuple[float, float]:
    """Plausible range of an unknown, in the search's own units."""
    if own is not None:
        return own.range_of(key)
    effect, _, name = key.partition(".")
    if effect == "rotor_mismatch":
        name = "excess"
    if effect == "gyro_low_pass":
        parameter = EFFECTS[effect].parameters[0]
        return tuple(sorted(1 / (2 * np.pi * f) for f in (parameter.low, parameter.high)))  # type: ignore[return-value]
    parameter = EFFECTS[effect].parameter(name)
    return parameter.low, parameter.high


def _started(point: Point, one: Scored) -> Point:
    start = dict(point)
    variant = one.variant
    if variant.start:
        start.update(zip(variant.keys, variant.start[len(variant.start) // 2], strict=True))
        return start
    for key, size in zip(variant.keys, one.values.tolist(), strict=False):
        low, high = range_of(key, variant.own)
        start[key] = float(np.clip(absent(key) + size, min(low, absent(key)), high))
    if variant.effect == "ground_effect":
        start["ground_effect.height_m"] = ABSENT["ground_effect.height_m"]
    return start


def _keys(base_keys: tuple[str, ...], accepted: Sequence[Accepted]) -> tuple[str, ...]:
    return (*base_keys, *(key for one in accepted for key in one.variant.keys))


def _without(point: Point, variant: Variant) -> Point:
    return {key: number for key, number in point.items() if key not in variant.keys}


def _offender(
    problem: Problem, now: Fit, accepted: Sequence[Accepted]
) -> tuple[Accepted, str] | None:
    """An accepted effect on whose size channels or recordings disagree in the end."""
    worst: tuple[float, Accepted, str] | None = None
    for one in accepted:
        t, parts = by_parts(problem, now, one.variant)
        evidence = replace(one.evidence, t=t, parts=parts)
        one.evidence = evidence
        why = disagreement(evidence)
        errors = max(evidence.spread(0)[0], evidence.spread(1)[0])
        if why and (worst is None or errors > worst[0]):
            worst = errors, one, why
    return None if worst is None else worst[1:]


def _needless(
    linear: Linear, total: Quadratic, keys: Sequence[str], accepted: list[Accepted]
) -> Accepted | None:
    """The accepted effect that the others do best without, if there is one."""
    if len(accepted) < 2:
        return None
    at = linear.place(keys)
    covariance = inverse(total.normal[np.ix_(at, at)])
    costs = []
    for one in accepted:
        own = [list(keys).index(key) for key in one.variant.keys if key != "ground_effect.height_m"]
        values = np.array([linear.point[keys[i]] - absent(keys[i]) for i in own])
        costs.append(float(values @ inverse(covariance[np.ix_(own, own)]) @ values))
        if not plausible(one.variant, linear.point):
            costs[-1] = min(costs[-1], 0.0)
    worst = int(np.argmin(costs))
    return accepted[worst] if costs[worst] < KEEP else None


__all__ = ["TIMING", "VARIANTS", "Accepted", "Outcome", "Scored", "range_of", "screen", "search"]
