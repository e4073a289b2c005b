"""Global search over gains: differential evolution on whole populations, and what it leaves.

The judges are compiled and take a population at once, so the search itself is plain arrays. All
that was ever judged is kept: the fronts are drawn from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
    generator = np.random.default_rng(seed)
    bottom, span = np.log(low), np.log(high) - np.log(low)

    def evaluate(points: Array) -> tuple[Array, Array]:
        candidates = np.exp(bottom + span * points)
        judgements = judge(candidates)
        archive.add(candidates, judgements)
        return score(judgements), judgements

    points = generator.random((budget.first, len(low)))
    if start is not None and len(start):
        points = np.vstack([np.clip((np.log(start) - bottom) / span, 0, 1), points])
    scores, judgements = evaluate(points)
    order = np.argsort(scores, kind="stable")[: budget.population]
    points, scores, judgements = points[order], scores[order], judgements[order]
    best, since = scores.min(), 0
    population = len(points)
    for _ in range(budget.generations):
        parents = np.argsort(generator.random((population, population)), axis=1)[:, :3]
        leader = points[np.argmin(scores)]
        toward = np.where(generator.random((population, 1)) < 0.5, leader, points[parents[:, 0]])
        trial = toward + MUTATION * (points[parents[:, 1]] - points[parents[:, 2]])
        keep = generator.random(trial.shape) > CROSSOVER
        trial = np.where(keep, points, trial)
        outside = (trial < 0) | (trial > 1)
        trial = np.where(outside, generator.random(trial.shape), trial)
        new_scores, new_judgements = evaluate(trial)
        better = new_scores <= scores
        points[better], scores[better] = trial[better], new_scores[better]
        judgements[better] = new_judgements[better]
        since = 0 if scores.min() < best * (1 - STALLED) else since + 1
        best = min(best, scores.min())
        if since >= STALL:
            break
    winner = int(np.argmin(scores))
    return np.exp(bottom + span * points[winner]), judgements[winner]


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
