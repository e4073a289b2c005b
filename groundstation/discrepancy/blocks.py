"""The likelihood of a last fit by blocks of time: one Gram matrix each, of which resamples, flights
left out and sizes by blocks are sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.likelihood.motion import Variant
from groundstation.identification.likelihood.problem import Fit, Problem
from groundstation.identification.likelihood.spectra import Linear, white_rows
from groundstation.telemetry.arrays import Array

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
