"""What pushes and turns a craft slowly and belongs to no flight condition: the disturbance.

No column shows it, for it has no law but its spread and its pace. What is left of predictions is
averaged over half seconds: noise is forgotten from one to the next, and what acts slowly is not.
The likelihood of these means gives the spread, and how well fitted rows are predicted the pace.
Two flights in which nothing of it shows do not say that the third has none: batteries are pushed
in anew, and one pushes more than another. So moments are never held to be smaller than the trims of
flights in general (``trim_of``), nor the force along z than what batteries differ by.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import FURTHER_EVERY_S, AheadErrors
from groundstation.discrepancy.acceptance import LEAST_SURE, is_significant
from groundstation.discrepancy.drift import drift_of, spread_of
from groundstation.dynamics.model import Disturbance, Estimate, Model, model_vehicle
from groundstation.dynamics.registry import DISTURBANCE
from groundstation.identification.likelihood.motion import trim_of
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import STANDARD_GRAVITY

BLOCK_S = 0.5
"""Ten times the horizon, which neighbours share at their edges; a circle takes five seconds."""
PACES_S = (0.3, 1.0, 3.0, 10.0, 30.0)
"""How fast it may change: more slowly than a craft is steered, and told by a flight of a minute."""
LEAST_BLOCKS = 20
"""Means that tell anything."""
LIFT_SHARE = 0.03
"""Of its weight, what a craft's thrust differs by from flight to flight at one PWM and voltage:
flights of one craft tell thrusts per mass up to 5 % apart."""
FAINTEST = 1e-300
"""A chance that a double still holds; it is one of 37 standard errors."""


@dataclass(frozen=True, slots=True)
class Slow:
    """spread (6,): standard deviation of moments (rad/s^2) and forces (m/s^2) along x, y, z, 0
    where nothing lasts. time_s: the pace of all. t: ``standard_errors`` of the six, where one at
    least lasts; drop: of -2 log L where each has its likeliest pace. seconds: so much was flown.
    variances (paces, 6): of the means of half seconds, by ``PACES_S``. usual: (6,) spreads of
    flights in general, below which these flights, or others, did not tell one."""

    spread: Array
    time_s: float
    t: float
    drop: float
    seconds: float
    variances: Array
    usual: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(6, np.bool_))

    def at(self, time_s: float) -> Slow:
        """The spreads with which a first-order process of this pace has such means."""
        variance = self.variances[PACES_S.index(time_s)]
        return replace(self, time_s=time_s, spread=spread_of(variance, BLOCK_S, time_s))

    def with_trims(self, least: Array) -> Slow:
        """Spreads at least as large as these (6,)."""
        return replace(self, spread=np.maximum(self.spread, least), usual=self.spread < least)

    @property
    def parameters(self) -> dict[str, Estimate]:
        """With the standard errors of a first-order process that was watched for so long, none
        where no flight told the spread; the pace is known to a step of ``PACES_S``."""
        error = math.sqrt(self.time_s / max(2.0 * self.seconds, self.time_s))
        told = (self.spread > 0.0) & ~self.usual
        found = {
            one.name: Estimate(spread, error * spread if known else None, one.unit)
            for one, spread, known in zip(
                DISTURBANCE.sizes, self.spread.tolist(), told.tolist(), strict=True
            )
        }
        (pace,) = (one for one in DISTURBANCE.parameters if one.kind == "shape")
        return {
            **found,
            pace.name: Estimate(self.time_s, max(2.0 * error, 0.5) * self.time_s, pace.unit),
        }

    @property
    def is_there(self) -> bool:
        """Whether white noise hardly explains the means as well."""
        return is_significant(self.t, self.drop)


def with_disturbance(model: Model, fitted: Comparison) -> Model:
    """A model with the slow forces and moments that it leaves in fitted samples, none where white
    noise explains these as well. fitted: the model on them."""
    slow = slow_part(fitted.errors)
    if not slow.is_there:
        return model
    trims = np.array([*trim_of(model_vehicle(model)), 0.0, 0.0, LIFT_SHARE * STANDARD_GRAVITY])
    return with_term(model, best_followed(slow, fitted).with_trims(trims))


def is_followed(model: Model) -> bool:
    """Whether a model says of itself what is slow."""
    return model.disturbance is not None


def best_followed(slow: Slow, fitted: Comparison) -> Slow:
    """At the pace with which fitted rows are predicted best, with the spreads only of those
    channels that are: beside what is fast and has no name, following what is slow can mislead."""
    told = np.isfinite(fitted.rms)
    before = _squares(_coarsely(fitted, fitted.model), told)
    found = []
    for time_s in PACES_S:
        one = slow.at(time_s)
        gained = before - _squares(_coarsely(fitted, with_term(fitted.model, one)), told)
        kept = replace(one, spread=np.where(gained > 0.0, one.spread, 0.0))
        found.append((float(gained[gained > 0.0].sum()), kept))
    return max(found, key=lambda each: each[0])[1]


def _coarsely(fitted: Comparison, model: Model) -> Array:
    """Gaps (9,) of a model on fitted rows, from few of them: it is asked of many models."""
    return fitted.with_model(model, FURTHER_EVERY_S).rms / fitted.noise_floor


def _squares(gaps: Array, told: NDArray[np.bool_]) -> Array:
    """Of the channels (9,) that a moment or a force on each axis moves, (6,); infinite where a
    channel that can be told is predicted no number."""
    known = np.where(np.isfinite(gaps), gaps, np.inf)
    squares = np.where(told, known, 0.0) ** 2
    return np.concatenate([squares[:3] + squares[6:], squares[3:6]])


def slow_part(errors: Sequence[AheadErrors]) -> Slow:
    """What lasts in the errors of predictions at the longest horizon.

    The rate that a craft has gained by then is a moment times the horizon. A channel which white
    noise explains as well has none.
    """
    flights = [_means(one) for one in errors]
    seconds = BLOCK_S * float(sum(len(means) for means in flights))
    count = sum(np.isfinite(means).sum(axis=0) for means in flights)
    drops, variances = drift_of(flights, BLOCK_S, PACES_S)
    likeliest = np.where(count >= LEAST_BLOCKS, drops.max(axis=0), 0.0)
    lasting = likeliest >= LEAST_SURE**2  # all six are asked at once, and need more
    found = Slow(
        spread=np.zeros(6),
        time_s=PACES_S[0],
        t=standard_errors(likeliest) if lasting.any() else math.sqrt(likeliest.max()),
        drop=float(likeliest.sum()) if lasting.any() else 0.0,
        seconds=seconds,
        variances=np.where(lasting, variances, 0.0),
    )
    return found.at(PACES_S[int(drops[:, lasting].sum(axis=1).argmax())])


def standard_errors(drops: Array) -> float:
    """Of a normal deviate that chance makes as seldom as the largest drop of -2 log L by one
    variance, or as all six (6,) together where that is seldomer: what pushes a craft is seldom in
    one channel alone."""
    from scipy.special import ndtri

    half = 0.5 * float(drops.sum())
    chance = math.exp(-half) * (1.0 + half + 0.5 * half**2)  # of chi^2, six degrees of freedom
    return max(math.sqrt(drops.max()), float(-ndtri(max(0.5 * chance, FAINTEST))))


def _means(one: AheadErrors) -> Array:
    """Moments and forces that are missing, (blocks, 6), averaged over each block; NaN where less
    than half of it was judged."""
    period, last = one.run.period_s, one.horizons[-1][:, :6]
    missing = last / np.concatenate([one.rows[-1][:3] * period, np.ones(3)])
    size = max(round(BLOCK_S / period), 1)
    blocks = missing[: len(missing) // size * size].reshape(-1, size, 6)
    known = np.isfinite(blocks)
    count = known.sum(axis=1)
    sums = np.where(known, blocks, 0.0).sum(axis=1)
    return np.where(count * 2 >= size, sums / np.maximum(count, 1), np.nan)


def with_term(model: Model, slow: Slow) -> Model:
    """A model whose observer follows what is slow."""
    import msgspec

    if not slow.spread.any():
        return model
    x, y, z, u, v, w = slow.spread.tolist()
    return msgspec.structs.replace(
        model, disturbance=Disturbance((x, y, z), (u, v, w), slow.time_s)
    )
