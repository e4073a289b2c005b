"""Global search over gains: scipy's differential evolution on whole populations.

The judges are compiled and take a population at once. All that was ever judged is kept: the fronts
are drawn from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array

MUTATION, CROSSOVER = 0.6, 0.9
STALL, STALLED = 25, 1e-4
"""Generations after which a search ends that has gained less than this share."""


@dataclass(frozen=True, slots=True)
class Budget:
    """first: random candidates, of which the first generation is the best. population:
    individuals. generations: at most."""

    first: int = 1500
    population: int = 48
    generations: int = 70


@dataclass
class Archive:
    """Everything judged so far: candidates (n, d) and judgements (n, c)."""

    candidates: list[Array] = field(default_factory=list)
    judgements: list[Array] = field(default_factory=list)

    def add(self, candidates: Array, judgements: Array) -> None:
        good = np.isfinite(judgements).all(axis=1)
        self.candidates.append(candidates[good])
        self.judgements.append(judgements[good])

    def table(self) -> tuple[Array, Array]:
        """All of them as two arrays, row by row."""
        return np.vstack(self.candidates), np.vstack(self.judgements)


def search(
    judge: Callable[[Array], Array],
    score: Callable[[Array], Array],
    low: Array,
    high: Array,
    archive: Archive,
    seed: int,
    budget: Budget,
    start: Array | None = None,
) -> tuple[Array, Array]:
    """The candidate with the lowest score, and its judgement.

    Candidates are searched on a logarithmic scale between low and high (d,), all positive.
    score: judgements (m, c) to (m,), infinite only where nothing can be compared.
    start: (s, d) candidates to begin with beside random ones.
    """
    from scipy.optimize import differential_evolution

    generator = np.random.default_rng(seed)
    bottom, span = np.log(low), np.log(high) - np.log(low)
    least: list[float] = []

    def candidates_of(points: Array) -> Array:
        return np.exp(bottom + span * points)

    def scores(points: Array) -> Array:
        """Of points (d, m) in the unit cube."""
        candidates = candidates_of(points.T)
        judgements = judge(candidates)
        archive.add(candidates, judgements)
        return score(judgements)

    def stalled(intermediate_result: Any) -> bool:
        least.append(float(intermediate_result.fun))
        return len(least) > STALL and least[-1] > least[-1 - STALL] * (1 - STALLED)

    points = generator.random((budget.first, len(low)))
    if start is not None and len(start):
        points = np.vstack([np.clip((np.log(start) - bottom) / span, 0, 1), points])
    first = points[np.argsort(scores(points.T), kind="stable")[: budget.population]]
    found = differential_evolution(
        scores,
        [(0.0, 1.0)] * len(low),
        strategy="randtobest1bin",
        init=first,
        mutation=MUTATION,
        recombination=CROSSOVER,
        maxiter=budget.generations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=generator,
        callback=stalled,
    )
    winner = candidates_of(found.x)
    return winner, judge(winner[None])[0]


def pareto_front(costs: Array) -> NDArray[np.intp]:
    """Rows of costs (n, c) that no other row equals or beats in every column, sorted by the
    first column."""
    left = np.lexsort(costs.T[::-1])
    # In the first column none is better than one before it.
    others, front = np.ascontiguousarray(costs.T[1:]).take(left, axis=1), []
    while len(left):
        front.append(left[0])
        better = np.flatnonzero((others < others[:, :1]).any(axis=0))
        left, others = left[better], others.take(better, axis=1)
    return np.array(front, np.intp)
