"""Crafts among crafts, flight after flight: how much flights scatter, what changed, who differs.

A value of flight j of craft k is  craft_k(j) + scatter + error, the error with the fit's standard
error, the scatter (weather, battery, place) alike for all crafts. The scatter comes from the
differences of neighbouring flights, which no change of a craft can blow up (its median); so do
the spread of crafts and their middle (DerSimonian and Laird's model, medians in place of moments).
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array

LEAST_PART = 3
"""Flights before and after a change: the middle of three is not one wild flight."""
LEAST_CRAFTS = 4
MEDIAN_CHI2 = 0.4549364
"""Median of a squared standard normal."""
EFFICIENCY = 0.37
"""Of a variance by a median: so much of the degrees of freedom count."""
POSSIBLE = 0.1
"""Chance beyond which no test is ever believed, so that its exact value is not worth computing."""
ALMOST = 0.8
"""Share of the clearest place's z at which another place of the change is possible."""
MEDIAN_STDERR = 1.2533
"""Standard error of a median over that of a mean, of many normal values."""


@dataclass(frozen=True, slots=True)
class Change:
    """flight: index of the first flight after it. step: the same of the likeliest step, of a drift
    too. size, stderr: after less before; of a drift, from the first flight to the last. p: how
    often chance does as much, anywhere in this series."""

    flight: int
    step: int
    size: float
    stderr: float
    drift: bool
    p: float


def scatter_variance(series: Sequence[tuple[Array, Array]]) -> tuple[float, float]:
    """(variance from flight to flight beyond the errors, degrees of freedom it is known to).

    series: (values (n,), standard errors (n,)) of each craft, in order of time.
    """
    steps = np.concatenate([np.diff(values) for values, _ in series] or [np.zeros(0)])
    known = [errors[1:] ** 2 + errors[:-1] ** 2 for _, errors in series]
    noise = np.concatenate(known or [np.zeros(0)])
    return 0.5 * excess_variance(steps, noise), max(1.0, EFFICIENCY * len(steps))


def excess_variance(deviations: Array, noise: Array) -> float:
    """The variance that must be added to ``noise`` for squared deviations to have the median of
    normal ones; never negative."""
    from scipy.optimize import brentq

    if len(deviations) == 0:
        return 0.0
    squares = deviations**2

    def beyond(extra: float) -> float:
        return float(np.median(squares / np.maximum(noise + extra, 1e-300))) - MEDIAN_CHI2

    most = float(squares.max()) / MEDIAN_CHI2
    if most == 0.0 or beyond(0.0) <= 0.0:
        return 0.0
    return float(brentq(beyond, 0.0, most))


def change_in(values: Array, variance: Array, freedom: float) -> Change | None:
    """The likeliest single change of a series (n,), however unlikely; None where it is too short.

    variance: (n,), scatter included. Means and medians before and after must both differ; for a
    drift the slope must be there and the order of the values (Mann and Kendall's test) as well, so
    that one wild flight is neither.
    """
    n = len(values)
    places = np.arange(LEAST_PART, n - LEAST_PART + 1)
    if len(places) < 1:
        return None
    sizes, stderrs, z, costs = _steps(values, variance, places)
    # Medians hardly say where: of the places that they allow, the means choose.
    allowed = np.abs(z) >= ALMOST * np.abs(z).max()
    best = int(np.argmax(np.where(allowed, np.abs(sizes) / stderrs, -1.0)))
    size, stderr = float(sizes[best]), float(stderrs[best])
    p = min(1.0, len(places) * _either_way(float(z[best]), freedom))
    slope, slope_stderr, drift_cost = _trend(values, variance)
    if drift_cost + 2.0 < float(costs[best]) + math.log(n):  # a step has its place besides
        span = float(n - 1)
        p = _either_way(slope / slope_stderr, freedom)
        if p < POSSIBLE:
            p = max(p, _order(values))
        return Change(0, int(places[best]), slope * span, slope_stderr * span, True, p)
    return Change(int(places[best]), int(places[best]), size, stderr, False, p)


def level(values: Array, variance: Array) -> tuple[float, float]:
    """Weighted mean and its variance."""
    weight = 1.0 / variance
    return float((weight * values).sum() / weight.sum()), float(1.0 / weight.sum())


@dataclass(frozen=True, slots=True)
class Population:
    """middle, its standard error, and spread (standard deviation) of crafts; p (k,): how often a
    craft of that population is as far out; shrunk, stderr (k,): the crafts' values given it, moved
    by one standard error of their own at most, for a craft of another kind owes the others nothing
    (Efron and Morris 1972)."""

    middle: float
    middle_stderr: float
    spread: float
    p: Array
    shrunk: Array
    stderr: Array


def population(levels: Array, variance: Array) -> Population | None:
    """Of crafts' levels (k,) with their variances; None for fewer than ``LEAST_CRAFTS``."""
    from scipy.stats import t

    count = len(levels)
    if count < LEAST_CRAFTS:
        return None
    middle = float(np.median(levels))
    between = excess_variance(levels - middle, variance)
    total = variance + between
    middle_variance = MEDIAN_STDERR**2 / float((1.0 / total).sum())
    z = (levels - middle) / np.sqrt(total + middle_variance)
    p = 2.0 * t.sf(np.abs(z), max(1.0, EFFICIENCY * (count - 1)))
    share = between / total
    own = np.sqrt(variance)
    shrunk = levels + np.clip((share - 1.0) * (levels - middle), -own, own)
    return Population(
        middle,
        math.sqrt(middle_variance),
        math.sqrt(between),
        np.asarray(p),
        np.asarray(shrunk),
        np.asarray(np.sqrt(share * variance + (1.0 - share) ** 2 * middle_variance)),
    )


def discoveries(p: Array, share: float) -> NDArray[np.bool_]:
    """Which of the tests (m,) to believe, so that at most ``share`` of those believed are chance
    (Benjamini and Hochberg 1995; holds for tests that depend on each other positively)."""
    from scipy.stats import false_discovery_control

    return np.asarray(false_discovery_control(p) <= share) if len(p) else np.zeros(0, np.bool_)


def _steps(
    values: Array, variance: Array, places: NDArray[np.int64]
) -> tuple[Array, Array, Array, Array]:
    """Of a step at each place: size, standard error, the weaker of two z (of means and of medians,
    0 where they disagree on its sign), and the cost of the fit. By sums that grow along the series:
    large fleets have many."""
    values = values - values.mean()  # the sums' digits are for what differs
    weight = 1.0 / variance
    w, wv, wvv = (np.concatenate([[0.0], np.cumsum(weight * values**power)]) for power in (0, 1, 2))
    before = wv[places] / w[places]
    after = (wv[-1] - wv[places]) / (w[-1] - w[places])
    sizes = after - before
    stderrs = np.sqrt(1.0 / w[places] + 1.0 / (w[-1] - w[places]))
    middle = _medians(values[::-1])[len(values) - places] - _medians(values)[places]
    means, robust = sizes / stderrs, middle / (MEDIAN_STDERR * stderrs)
    z = np.where(means * robust > 0.0, np.minimum(np.abs(means), np.abs(robust)), 0.0)
    costs = wvv[-1] - w[places] * before**2 - (w[-1] - w[places]) * after**2 + 2.0
    return sizes, stderrs, z, costs


def _medians(values: Array) -> Array:
    """Of the first k values, for every k; nothing for none."""
    ordered: list[float] = []
    found = np.full(len(values) + 1, np.nan)
    for k, value in enumerate(values.tolist(), 1):
        insort(ordered, value)
        found[k] = 0.5 * (ordered[(k - 1) // 2] + ordered[k // 2])
    return found


def _either_way(z: float, freedom: float) -> float:
    """How often Student's t is as far from 0."""
    from scipy.special import stdtr

    return 2.0 * float(stdtr(freedom, -abs(z)))


def _trend(values: Array, variance: Array) -> tuple[float, float, float]:
    """Slope per flight, its standard error, and the cost of the straight line."""
    weight = 1.0 / variance
    place = np.arange(len(values)) - level(np.arange(len(values), dtype=np.float64), variance)[0]
    middle = level(values, variance)[0]
    power = float((weight * place**2).sum())
    slope = float((weight * place * (values - middle)).sum()) / power
    cost = float((weight * (values - middle - slope * place) ** 2).sum())
    return slope, 1.0 / math.sqrt(power), cost


def _order(values: Array) -> float:
    """How often chance puts values in such an order: mostly rising, or mostly falling (Mann and
    Kendall; exact for short series)."""
    from scipy.stats import kendalltau

    return float(kendalltau(np.arange(len(values)), values).pvalue)
