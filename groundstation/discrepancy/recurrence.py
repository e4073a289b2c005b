"""How often each name is chosen where other stretches and flights count, and what then stands in
its place.

The Gram matrix of every column is kept by blocks of time. A resample gives each block and each
flight a weight of its own (the Bayesian bootstrap, Rubin 1981); the subset of names with the least
penalised -2 log L is then a matter of small matrices (stability selection, Meinshausen and
Buehlmann 2010).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.findings import Reason, Refusal
from groundstation.discrepancy.subsets import Subsets
from groundstation.identification.likelihood.linearisation import Linear
from groundstation.identification.likelihood.parameters import Variant, absent
from groundstation.identification.likelihood.problem import Fit, Problem
from groundstation.identification.likelihood.spectra import white_rows

Array = NDArray[np.float64]

RESAMPLES = 100
BLOCK_S, MOST_BLOCKS = 2.0, 200
"""Longer than any residual is correlated; of long recordings blocks are longer."""
RIVAL = 12.0
"""What explains so little less, in -2 log L, is an alternative: odds of one in 400."""
LEFT_OUT = (Reason.WEAK, Reason.INSIGNIFICANT, Reason.SUPERFLUOUS)
"""Refusals that other rows may lift."""
INSTEAD, OFTENER = 0.1, 2.0
"""Share of resamples from which what stood in a name's place is an alternative, and how much
oftener it stood there than beside the name."""


@dataclass(frozen=True, slots=True)
class Instead:
    """Another name. margin: how much less it explains in a name's place, in penalised -2 log L;
    share: of resamples in which it was chosen and the name was not."""

    name: str
    margin: float
    share: float


@dataclass(frozen=True, slots=True)
class Recurrence:
    """share: of resamples in which a name was chosen; instead: what stands for it, likely first."""

    share: float
    instead: tuple[Instead, ...] = ()


def asked_again(candidates: Sequence[Variant], refused: Mapping[str, Refusal]) -> list[Variant]:
    """Candidates that something else than other rows would have to let in."""
    return [
        one
        for one in candidates
        if one.label not in refused or refused[one.label].reason in LEFT_OUT
    ]


@dataclass(frozen=True, slots=True)
class Blocks:
    """-2 log L around a point where every name is absent, by blocks of time.

    normal: (b, p, p); gradient: (b, p); flight: (b,) that a block belongs to. whole: what no
    weight changes (normal, gradient), the prior.
    """

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


def recurrences(
    problem: Problem, final: Fit, found: Sequence[Variant], candidates: Sequence[Variant]
) -> dict[str, Recurrence]:
    """How often each of ``found`` is chosen beside all ``candidates``, by label; nothing of what
    has no column beside the constants. Shapes (time constants) stay as they were fitted."""
    free = {*final.keys}
    shapes = {key for one in found for key in one.keys}
    base = [key for key in final.keys if key not in shapes]
    mine = [one for one in found if free.issuperset(one.sizes)]
    taken = {one.label for one in mine}
    rest = [
        one
        for one in candidates
        if one.label not in taken and {*problem.every_key}.issuperset(one.sizes)
    ]
    variants = [*mine, *rest]
    sizes = [key for one in variants for key in one.sizes]
    linear = problem.linear(final.point, (*base, *sizes), problem.flights)
    blocks = by_blocks(problem, linear, sizes)
    start = frozenset(range(len(mine)))
    chosen = np.zeros((RESAMPLES, len(variants)), np.bool_)
    random = np.random.default_rng(0)
    for row in chosen:
        weights = random.exponential(size=len(blocks.flight))
        if len(problem.flights) > 1:
            weights *= random.exponential(size=len(problem.flights))[blocks.flight]
        resampled = blocks.weighed(weights / weights.mean())
        row[list(Subsets(variants, final.point, *resampled).best(start))] = True
    as_it_is = Subsets(variants, final.point, *blocks.weighed(np.ones(len(blocks.flight))))
    beside = np.maximum(as_it_is.beside(start), 0.0)
    found_again = {}
    for number, one in enumerate(mine):
        alone = as_it_is.beside(start - {number})
        margins = alone[number] - (alone - beside)
        share = float(chosen[:, number].mean())
        instead = _alternatives(variants, number, margins, chosen)
        found_again[one.label] = Recurrence(share, instead)
    return found_again


def _alternatives(
    variants: Sequence[Variant], number: int, margins: Array, chosen: NDArray[np.bool_]
) -> tuple[Instead, ...]:
    """By name, the likely first; none of the name itself, of another rotor say.

    margins: (v,) by which each variant is worth less in the name's place, beyond what it is worth
    beside it. chosen: (resamples, v).
    """
    there = chosen[:, number]
    stood = chosen[~there].sum(axis=0)
    rate, usual = stood / max(np.sum(~there), 1), chosen[there].sum(axis=0) / max(there.sum(), 1)
    found: dict[str, Instead] = {}
    for other, one in enumerate(variants):
        share, margin, name = float(stood[other]) / len(chosen), float(margins[other]), one.effect
        if not np.isfinite(margin) or name == variants[number].effect:
            continue
        if margin < RIVAL or (share >= INSTEAD and rate[other] > OFTENER * usual[other]):
            before = found.get(name)
            if before is None or (share, -margin) > (before.share, -before.margin):
                found[name] = Instead(name, margin, share)
    return tuple(sorted(found.values(), key=lambda one: (-one.share, one.margin)))


def by_blocks(problem: Problem, linear: Linear, sizes: Sequence[str]) -> Blocks:
    """A linearisation by blocks of time, seen from where ``sizes`` are absent."""
    count = len(linear.keys)
    step = np.zeros(count)
    for key, place in zip(sizes, linear.place(sizes), strict=True):
        step[place] = absent(key) - linear.point.get(key, absent(key))
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
    return Blocks(
        normal,
        gradient - normal @ step,
        flight,
        (prior.normal, prior.gradient - prior.normal @ step),
    )
