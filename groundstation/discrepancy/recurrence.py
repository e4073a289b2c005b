"""Whether a name holds in parts of the flights: blocks, differences between them, subsets."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from groundstation.discrepancy.acceptance import DROP_PER_PARAMETER, LEAST_DROP, plausible
from groundstation.discrepancy.proof import Alternative, Reason, Refusal
from groundstation.discrepancy.screening import UNDETERMINED
from groundstation.dynamics.effect import Effect
from groundstation.identification.estimate import inverse
from groundstation.identification.likelihood.linear import Linear
from groundstation.identification.likelihood.motion import KEYS, VARIANTS, Point, Variant, absent
from groundstation.identification.likelihood.problem import Fit, Problem, white_rows
from groundstation.telemetry.arrays import Array

# The likelihood of a last fit by blocks of time: one Gram matrix each, of which resamples, flights
# left out and sizes by blocks are sums.


BLOCK_S, MOST_BLOCKS = 2.0, 200
"""Longer than any residual is correlated; of long recordings blocks are longer."""


@dataclass(frozen=True, slots=True)
class Blocks:
    """-2 log L around a point, by blocks of time.

    keys: (p), of which the first ``fitted`` are in the fit. normal: (b, p, p); gradient: (b, p);
    flight: (b,) that a block belongs to. whole: what no weight changes (normal, gradient), the
    prior.
    """

    keys: tuple[str, ...]
    fitted: int
    normal: Array
    gradient: Array
    flight: NDArray[np.int64]
    whole: tuple[Array, Array]

    def weighed(self, weights: Array) -> tuple[Array, Array]:
        """(normal (p, p), gradient (p,)) with weights (b,) of the blocks."""
        normal, gradient = self.whole
        return (
            normal + np.tensordot(weights, self.normal, 1),
            gradient + weights @ self.gradient,
        )

    def together(self) -> tuple[Array, Array]:
        """The same of all blocks as they are."""
        return self.weighed(np.ones(len(self.flight)))

    def of(self, keys: Sequence[str]) -> Blocks:
        """Those of some of the columns, the fitted ones first."""
        at = [self.keys.index(key) for key in keys]
        normal, gradient = self.whole
        return replace(
            self,
            keys=tuple(keys),
            fitted=sum(place < self.fitted for place in at),
            normal=self.normal[:, at][:, :, at],
            gradient=self.gradient[:, at],
            whole=(normal[np.ix_(at, at)], gradient[at]),
        )

    def seen_from(self, step: Array) -> Blocks:
        """The same parabolas around a point that is ``step`` (p,) away."""
        normal, gradient = self.whole
        return replace(
            self,
            gradient=self.gradient - self.normal @ step,
            whole=(normal, gradient - normal @ step),
        )


def last_blocks(problem: Problem, final: Fit, others: Sequence[Variant]) -> Blocks:
    """Of a last fit, and with the columns of ``others``' sizes."""
    keys = (*final.keys, *(key for one in others for key in one.sizes))
    linear = problem.linear(final.point, keys, problem.flights)
    return by_blocks(problem, linear, len(final.keys))


def by_blocks(problem: Problem, linear: Linear, fitted: int) -> Blocks:
    """A linearisation by blocks of time. fitted: how many of its keys are in the fit."""
    count = len(linear.keys)
    seconds = {s.flight: len(s.hz) / (2.0 * s.hz[-1]) for s in linear.spectra}
    block_s = max(BLOCK_S, sum(seconds.values()) / MOST_BLOCKS)
    pieces = {flight: max(1, round(long / block_s)) for flight, long in seconds.items()}
    first = dict(zip(pieces, np.cumsum([0, *pieces.values()]).tolist(), strict=False))
    flight = np.repeat([*pieces], [*pieces.values()])
    normal, gradient = np.zeros((len(flight), count, count)), np.zeros((len(flight), count))
    for s in linear.spectra:
        rows = white_rows(
            s, problem.noise[s.channel], np.concatenate([s.residual[None], s.columns])
        )
        rows *= np.sqrt(0.5 * float(s.weight.sum()))
        ends = np.linspace(0, rows.shape[1], pieces[s.flight] + 1).astype(int).tolist()
        for number, (a, b) in enumerate(pairwise(ends), first[s.flight]):
            columns, residual = rows[1:, a:b], rows[0, a:b]
            normal[number][np.ix_(s.place, s.place)] += columns @ columns.T
            gradient[number][s.place] += columns @ residual
    for row in linear.verticals:
        mine = flight == row.flight
        normal[mine] += np.outer(row.slopes, row.slopes) / row.sigma**2 / mine.sum()
        gradient[mine] += row.slopes * row.residual / row.sigma**2 / mine.sum()
    prior = problem.with_prior(replace(linear, spectra=[], verticals=[]))
    whole = prior.normal, prior.gradient
    return Blocks(linear.keys, fitted, normal, gradient, flight, whole)


# What standard errors hold beside noise: what numbers differ by from flight to flight, a random
# effect of each, a delay that rows leave open, and what no flight measures.


DELAY = next(one.sizes[0] for one in VARIANTS if one.definition.stage == "delay")

UNWEIGHED = 0.1
"""Of a craft's mass, where nobody weighed it: decks, batteries and repairs are 3 g of 30."""
BY_MASS = ("kg", "N")
"""How units begin of what is reckoned by it."""
UNMEASURED_MOTORS = 0.03
"""Of a torque by its thrust, where neither a bench nor a sensor measured the motors: the slope of
their speed over voltage, which makes one, is the profile's, and crafts of one kind differ."""
INFORMED = 0.05
"""Share of the information on a number from which a flight takes part."""
CHANCE = 0.95
"""Of samples in which blocks of one size scatter less than this."""


def with_differences(errors: Mapping[str, float], blocks: Blocks) -> dict[str, float]:
    """Standard errors by key, with what flights differ by.

    blocks: of the last fit, at its point.
    """
    normal, _ = blocks.together()
    covariance = inverse(normal[: blocks.fitted, : blocks.fitted])
    wider = dict(errors)
    for n, key in enumerate(blocks.keys[: blocks.fitted]):
        if key in wider and covariance[n, n] > 0.0:  # else rows say nothing of it
            # The column without what all others imitate of it, by a unit of the number.
            alone = np.pad(covariance[:, n] / covariance[n, n], (0, len(normal) - blocks.fitted))
            trust = np.einsum("i,bij,j->b", alone, blocks.normal, alone)
            own = min(float(trust.sum()) * errors[key] ** 2, 1.0)  # the rest is the prior's
            more = own * difference(trust, blocks.gradient @ alone, blocks.flight)
            wider[key] = float(np.hypot(errors[key], more))
    return wider


def with_open_delay(errors: Mapping[str, float], blocks: Blocks, open_s: float) -> dict[str, float]:
    """Standard errors by key, with what a delay that the rows leave open moves each number by.

    open_s: the delay is anywhere between none and so much, either way. A delay that is fitted is
    not known better than that, and moves no other number.
    """
    if open_s == 0.0 or DELAY not in blocks.keys:
        return dict(errors)
    normal, _ = blocks.together()
    fitted, at = blocks.keys[: blocks.fitted], blocks.keys.index(DELAY)
    if DELAY in fitted:
        moved = np.eye(len(fitted))[at]
    else:
        moved = inverse(normal[: len(fitted), : len(fitted)]) @ normal[: len(fitted), at]
    spread = dict(zip(fitted, np.abs(moved) * open_s / np.sqrt(3.0), strict=True))
    return {key: float(np.hypot(error, spread.get(key, 0.0))) for key, error in errors.items()}


def with_unmeasured(
    errors: Mapping[str, float],
    point: Point,
    *,
    row_s: float,
    is_weighed: bool,
    motors_known: bool,
) -> dict[str, float]:
    """Standard errors by key, with what no flight tells of a size: the craft's mass, by which what
    is in kg or N is reckoned from accelerations; how its motors turn a voltage into speed, by
    which what moves the rotors is; and when within a row a setting began."""
    wider = dict(errors)
    for key in errors.keys() & point.keys() & KEYS.keys():
        size = abs(point[key] - KEYS[key].absent)
        unit, stage = KEYS[key].parameter.unit, KEYS[key].effect.stage
        more = [0.0]
        if not is_weighed and unit.startswith(BY_MASS):
            more.append(UNWEIGHED * size)
        if not motors_known and stage in ("body", "rotor") and KEYS[key].parameter.kind == "size":
            more.append(UNMEASURED_MOTORS * size)
        if key == DELAY:
            more.append(row_s / np.sqrt(12.0))
        wider[key] = float(np.hypot(errors[key], np.linalg.norm(more)))
    return wider


def difference(trust: Array, score: Array, flight: NDArray[np.int64]) -> float:
    """Standard error of a number that comes from flights being different, beside what noise within
    them makes.

    trust, score: (b,) of blocks of time, each of which tells a number score / trust from the joint
    one with precision trust; flight: that a block belongs to. The variance between flights is by
    moments (DerSimonian and Laird 1986), from what flights tell, or from what blocks tell where
    these differ by more than chance: two flights hardly tell a variance, and they differ at least
    as much as parts of one.
    """
    own = [np.bincount(flight, one) for one in (trust, score)]
    known = own[0] > INFORMED * own[0].sum()
    told = own[0][known]
    if not len(told):
        return 0.0
    variance, _ = _moments(told, own[1][known])
    within, above_chance = _moments(trust, score)
    variance = max(variance, within if above_chance else 0.0, 0.0)
    mean = 1.0 / float((1.0 / (1.0 / told + variance)).sum()) - 1.0 / float(told.sum())
    return float(np.sqrt(max(mean, 0.0)))


def _moments(trust: Array, score: Array) -> tuple[float, bool]:
    """(variance of a number between parts, whether they scatter by more than chance)."""
    trust, score = trust[trust > 0.0], score[trust > 0.0]
    whole, count = float(trust.sum()), len(trust)
    if count < 2:
        return 0.0, False
    scatter = float((score**2 / trust).sum()) - float(score.sum()) ** 2 / whole
    variance = (scatter - (count - 1)) / (whole - float(trust @ trust) / whole)
    return variance, scatter > 2.0 * float(gammaincinv(0.5 * (count - 1), CHANCE))


# The subset of effects with the least penalised -2 log L, on one Gram matrix.


RIDGE = 1e-9
"""Share of a column's power that is added to it: two that are alike have an inverse."""
MOST_MOVES = 60


class Subsets:
    """Subsets of variants beside a base that is always there, under one likelihood.

    normal: (p, p), gradient: (p,), the base's columns first, then the variants' sizes in their
    order, as seen from where all variants are absent. A subset is worth what it takes off -2 log L
    less a price for each variant, that of joining a search (``LEAST_DROP``).
    """

    def __init__(
        self, variants: Sequence[Variant], point: Point, normal: Array, gradient: Array
    ) -> None:
        """point: with the shapes of the variants."""
        self._variants, self._point = variants, point
        self._scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        self._normal = normal * np.outer(self._scale, self._scale) + RIDGE * np.eye(len(gradient))
        self._gradient = gradient * self._scale
        count = np.array([len(one.sizes) for one in variants])
        base = len(gradient) - int(count.sum())
        self._base = list(range(base))
        ends = np.cumsum([base, *count]).tolist()
        self._own = [list(range(a, b)) for a, b in pairwise(ends)]
        self._price = LEAST_DROP + DROP_PER_PARAMETER * (count - 1.0)
        self._alone, self._several = np.flatnonzero(count == 1), np.flatnonzero(count > 1).tolist()
        self._at = np.array(ends[:-1])[self._alone]

    def best(self, start: frozenset[int]) -> frozenset[int]:
        """The best that adding, dropping and exchanging reach, from ``start`` and from nothing."""
        ends = (self._settled(start), self._settled(frozenset()))
        return max(ends, key=self.worth)

    def worth(self, chosen: Collection[int]) -> float:
        """Of a subset."""
        at = self._places(chosen)
        own = self._gradient[at]
        taken = float(own @ np.linalg.solve(self._normal[np.ix_(at, at)], own))
        return taken - float(self._price[list(chosen)].sum())

    def beside(self, chosen: Collection[int]) -> Array:
        """What each variant (v,) is worth as one more; -inf for those that are of the same effect
        as one of ``chosen``, or of a size or sign that no craft has."""
        worth, sizes = self._joining(chosen)
        for n in np.flatnonzero(np.isfinite(worth)).tolist():
            if not self._possible(n, sizes[n]):
                worth[n] = -np.inf
        return worth

    def _settled(self, chosen: frozenset[int]) -> frozenset[int]:
        for _ in range(MOST_MOVES):
            gain, more = self._addition(chosen)
            if gain <= 0.0:
                now = self.worth(chosen)
                rests = [(self.worth(chosen - {one}) - now, chosen - {one}) for one in chosen]
                gain, more = max(rests, default=(0.0, chosen), key=lambda option: option[0])
                if gain <= 0.0:
                    joined = ((loss, *self._addition(rest)) for loss, rest in rests)
                    options = [(loss + gain, other) for loss, gain, other in joined]
                    gain, more = max(options, default=(0.0, chosen), key=lambda option: option[0])
            if gain <= 1e-6:
                break
            chosen = more
        return chosen

    def _addition(self, chosen: frozenset[int]) -> tuple[float, frozenset[int]]:
        """(what the variant that is worth most adds, the subset with it)."""
        worth, sizes = self._joining(chosen)
        for n in np.argsort(-worth).tolist():
            if not np.isfinite(worth[n]):
                break
            if worth[n] <= 0.0 or self._possible(n, sizes[n]):
                return float(worth[n]), chosen | {n}
        return -np.inf, chosen

    def _joining(self, chosen: Collection[int]) -> tuple[Array, dict[int, Array]]:
        """(what each variant (v,) is worth beside these, whatever its size; these sizes)."""
        at = self._places(chosen)
        cross = self._normal[:, at]
        imitated = np.linalg.solve(self._normal[np.ix_(at, at)], cross.T).T
        slope = self._gradient - imitated @ self._gradient[at]
        own = np.diag(self._normal)[self._at]
        left = own - np.einsum("ij,ij->i", imitated[self._at], cross[self._at])
        left = np.where(left > UNDETERMINED * own, left, np.inf)
        worth = np.empty(len(self._variants))
        worth[self._alone] = slope[self._at] ** 2 / left
        sizes = dict(zip(self._alone.tolist(), (slope[self._at] / left)[:, None], strict=True))
        for n in self._several:
            mine = self._own[n]
            inner = self._normal[np.ix_(mine, mine)] - imitated[mine] @ cross[mine].T
            sizes[n] = np.linalg.solve(inner + RIDGE * np.eye(len(mine)), slope[mine])
            worth[n] = slope[mine] @ sizes[n]
        taken = {self._variants[n].effect for n in chosen}
        out = [n for n, one in enumerate(self._variants) if one.effect in taken]
        worth -= self._price
        worth[out] = -np.inf
        return worth, sizes

    def _places(self, chosen: Collection[int]) -> list[int]:
        return [*self._base, *(place for one in sorted(chosen) for place in self._own[one])]

    def _possible(self, n: int, size: Array) -> bool:
        one = self._variants[n]
        counted = (size * self._scale[self._own[n]]).tolist()
        sizes = {key: absent(key) + s for key, s in zip(one.sizes, counted, strict=True)}
        return plausible(one, {**self._point, **sizes})


# How often each name is chosen where other stretches and flights count, and what then stands in
# its place.
#
# A resample gives each block of time and each flight a weight of its own (the Bayesian bootstrap,
# Rubin 1981); the subset of names with the least penalised -2 log L is then a matter of small
# matrices (stability selection, Meinshausen and Buehlmann 2010).


RESAMPLES = 100
RIVAL = 12.0
"""What explains so little less, in -2 log L, is an alternative: odds of one in 400."""
LEFT_OUT = (Reason.WEAK, Reason.INSIGNIFICANT, Reason.SUPERFLUOUS)
"""Refusals that other rows may lift."""
INSTEAD, OFTENER = 0.1, 2.0
"""Share of resamples from which what stood in a name's place is an alternative, and how much
oftener it stood there than beside the name."""


@dataclass(frozen=True, slots=True)
class Recurrence:
    """share: of resamples in which a name was chosen; instead: what stands for it, likely first."""

    share: float
    instead: tuple[Alternative, ...] = ()


def asked_again(
    candidates: Sequence[Variant], refused: Mapping[str, Refusal], found: Sequence[Variant]
) -> list[Variant]:
    """Candidates that were not found, and that nothing else than other rows has to let in."""
    out = {one.label for one in found}
    out |= {label for label, why in refused.items() if why.reason not in LEFT_OUT}
    return [one for one in candidates if one.label not in out]


def recurrences(
    blocks: Blocks, point: Point, found: Sequence[Variant], others: Sequence[Variant]
) -> dict[str, Recurrence]:
    """How often each of ``found`` is chosen beside all ``others``, by label.

    blocks: at ``point``, with columns of the constants, of what was found and of the others.
    """
    variants = [*found, *others]
    mine = {key for one in found for key in one.keys}  # shapes stay as they were fitted
    base = [key for key in blocks.keys[: blocks.fitted] if key not in mine]
    blocks = blocks.of([*base, *(key for one in variants for key in one.sizes)])
    absences = [absent(key) - point.get(key, absent(key)) for one in variants for key in one.sizes]
    blocks = blocks.seen_from(np.pad(absences, (len(blocks.keys) - len(absences), 0)))
    start, flights = frozenset(range(len(found))), len(np.unique(blocks.flight))
    chosen = np.zeros((RESAMPLES, len(variants)), np.bool_)
    random = np.random.default_rng(0)
    for row in chosen:
        weights = random.exponential(size=len(blocks.flight))
        if flights > 1:
            weights *= random.exponential(size=flights)[blocks.flight]
        resampled = blocks.weighed(weights / weights.mean())
        row[list(Subsets(variants, point, *resampled).best(start))] = True
    as_it_is = Subsets(variants, point, *blocks.together())
    beside = np.maximum(as_it_is.beside(start), 0.0)
    found_again = {}
    for number, one in enumerate(found):
        alone = as_it_is.beside(start - {number})
        with np.errstate(invalid="ignore"):  # neither possible alone nor beside: no margin
            margins = alone[number] - (alone - beside)
        share = float(chosen[:, number].mean())
        instead = _alternatives(variants, number, margins, chosen)
        found_again[one.label] = Recurrence(share, instead)
    return found_again


def _alternatives(
    variants: Sequence[Variant], number: int, margins: Array, chosen: NDArray[np.bool_]
) -> tuple[Alternative, ...]:
    """By name, the likely first; none of the name itself, of another rotor say.

    margins: (v,) by which each variant is worth less in the name's place, beyond what it is worth
    beside it. chosen: (resamples, v).
    """
    there = chosen[:, number]
    stood = chosen[~there].sum(axis=0)
    rate, usual = stood / max(np.sum(~there), 1), chosen[there].sum(axis=0) / max(there.sum(), 1)
    found: dict[str, Alternative] = {}
    for other, one in enumerate(variants):
        share, margin, name = float(stood[other]) / len(chosen), float(margins[other]), one.effect
        if not np.isfinite(margin) or name == variants[number].effect:
            continue
        if margin < RIVAL or (share >= INSTEAD and rate[other] > OFTENER * usual[other]):
            before = found.get(name)
            if before is None or (share, -margin) > (before.share, -before.margin):
                fly = _manoeuvre(variants[number].definition, one.definition)
                found[name] = Alternative(name, margin, fly, share)
    return tuple(sorted(found.values(), key=lambda one: (-one.share, one.margin)))


def _manoeuvre(one: Effect, two: Effect) -> str:
    """What separates two effects, from the catalogue, whichever of the two knows it."""
    known = [c.manoeuvre for c in one.confused_with if c.other == two.name]
    known += [c.manoeuvre for c in two.confused_with if c.other == one.name]
    return known[0] if known else two.excited_by
