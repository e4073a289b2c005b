"""What pushes and turns a craft slowly and belongs to no flight condition: ``wind``.

No column shows it, for it has no law but its spread and its pace. What is left of predictions is
averaged over half seconds: noise is forgotten from one to the next, and what acts slowly is not.
The covariance of neighbours gives the spread, and how well fitted rows are predicted the pace.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.comparison.channels import CHANNELS
from groundstation.comparison.comparison import Comparison
from groundstation.comparison.gap import AheadErrors
from groundstation.discrepancy.acceptance import LEAST_DROP, LEAST_T, PREDICTED_SHARE
from groundstation.discrepancy.findings import (
    Candidate,
    Findings,
    FoundEffect,
    Reason,
    Refusal,
    Verdict,
)
from groundstation.discrepancy.proof import HeldOut
from groundstation.dynamics.model import EffectTerm, Estimate, Model
from groundstation.dynamics.registry import EFFECTS

Array = NDArray[np.float64]

WIND = next(effect for effect in EFFECTS.values() if effect.followed)
BLOCK_S = 0.5
"""Ten times the horizon, which neighbours share at their edges; a circle takes five seconds."""
PACES_S = (0.3, 1.0, 3.0, 10.0)
"""How fast it may change: more slowly than a craft is steered, and told by a flight of a minute."""
LEAST_BLOCKS, LEAST_LASTING = 20, 3.0
"""Means that tell a covariance, and its standard errors from which a channel has one; all six are
asked at once, and the surest needs more."""
EXCESS = 1.2
"""Gap on held-out rows below which nothing is left that a name could explain."""


@dataclass(frozen=True, slots=True)
class Slow:
    """spread (6,): standard deviation of moments (rad/s^2) and forces (m/s^2) along x, y, z, 0
    where nothing lasts. time_s: the pace of all. t: of the surest; drop: of -2 log L of the means
    of half seconds where each remembers the one before. seconds: so much was flown. shared (6,):
    covariance of neighbouring means."""

    spread: Array
    time_s: float
    t: float
    drop: float
    seconds: float
    shared: Array = field(default_factory=lambda: np.zeros(6))

    def at(self, time_s: float) -> Slow:
        """The spreads with which a first-order process of this pace has such means."""
        share = (time_s / BLOCK_S * (1.0 - math.exp(-BLOCK_S / time_s))) ** 2
        return replace(self, time_s=time_s, spread=np.sqrt(self.shared / share))


def with_wind(findings: Findings, train: Comparison, held: HeldOut) -> Findings:
    """The findings, with ``wind`` as the last effect where held-out predictions are better for it.

    train: the given model on the rows that were fitted.
    """
    base = findings.model
    if any(term.name == WIND.name for term in base.effects):
        return findings
    now = held.judge(base)
    if now.gap < EXCESS:
        return findings
    fitted = train.with_model(base)
    slow = slow_part(fitted.errors)
    if slow.t < LEAST_T or slow.drop < LEAST_DROP:
        words = f"not significant: {slow.t:.1f} standard errors"
        return _refused(findings, slow, Refusal(Reason.INSIGNIFICANT, words))
    slow = best_followed(slow, fitted)
    found = held.judge(_with_term(base, slow))
    while found.worse and slow.spread.any():
        # Where following makes it worse it is not followed.
        away = [channel % 3 + (3 if 3 <= channel < 6 else 0) for channel in found.worse]
        rest = slow.spread.copy()
        rest[away] = 0.0
        if (rest == slow.spread).all():
            rest[:] = 0.0
        slow = replace(slow, spread=rest)
        found = held.judge(_with_term(base, slow))
    parameters = _parameters(slow)
    if not WIND.plausible({name: one.value for name, one in parameters.items()}):
        words = ", ".join(f"{k} {one.value:.3g} {one.unit}" for k, one in parameters.items())
        return _refused(findings, slow, Refusal(Reason.IMPLAUSIBLE, f"not plausible: {words}"))
    share = 1.0 - (found.gap**2 - 1.0) / (now.gap**2 - 1.0)
    if share < PREDICTED_SHARE:
        words = f"explains {100.0 * max(share, 0.0):.0f} % of what is wrong in predictions"
        return _refused(findings, slow, Refusal(Reason.DROWNED, words))
    return _joined(findings, slow, slow_part(held.of(base).errors), (now.gap, found.gap))


def best_followed(slow: Slow, fitted: Comparison) -> Slow:
    """At the pace with which fitted rows are predicted best, with the spreads only of those
    channels that are: beside what is fast and has no name, following what is slow can mislead."""
    told = np.isfinite(fitted.rms)
    before = _squares(fitted.rms / fitted.noise_floor, told)
    found = []
    for time_s in PACES_S:
        one = slow.at(time_s)
        after = fitted.with_model(_with_term(fitted.model, one)).rms / fitted.noise_floor
        gained = before - _squares(after, told)
        kept = replace(one, spread=np.where(gained > 0.0, one.spread, 0.0))
        found.append((float(gained[gained > 0.0].sum()), kept))
    return max(found, key=lambda each: each[0])[1]


def _squares(gaps: Array, told: NDArray[np.bool_]) -> Array:
    """Of the channels (9,) that a moment or a force on each axis moves, (6,); infinite where a
    channel that can be told is predicted no number."""
    known = np.where(np.isfinite(gaps), gaps, np.inf)
    squares = np.where(told, known, 0.0) ** 2
    return np.concatenate([squares[:3] + squares[6:], squares[3:6]])


def slow_part(errors: Sequence[AheadErrors]) -> Slow:
    """What lasts in the errors of predictions at the longest horizon.

    The rate that a craft has gained by then is a moment times the horizon. A channel whose
    neighbouring means agree no better than chance has none.
    """
    flights = [_means(one) for one in errors]
    seconds = BLOCK_S * float(sum(len(means) for means in flights))
    variance, shared = (_covariances(flights, lag) for lag in range(2))
    count = np.array([sum(int(np.isfinite(m[:, c]).sum()) for m in flights) for c in range(6)])
    there = (variance > 0.0) & (count >= LEAST_BLOCKS)
    like = np.where(there, shared / np.where(there, variance, 1.0), 0.0).clip(-0.999, 0.999)
    t = like * np.sqrt(count)
    lasting = t >= LEAST_LASTING
    drop = float((-count * np.log(1.0 - like**2))[lasting].sum())
    found = Slow(np.zeros(6), BLOCK_S, float(t.max(initial=0.0)), drop, seconds)
    return replace(found, shared=np.where(lasting, shared, 0.0)).at(BLOCK_S)


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


def _covariances(flights: Sequence[Array], lag: int) -> Array:
    """Mean products (6,) of each mean and the one ``lag`` later, where both are known."""
    found = np.concatenate([means[: len(means) - lag] * means[lag:] for means in flights])
    known = np.isfinite(found)
    return np.asarray(np.where(known, found, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def _parameters(slow: Slow) -> dict[str, Estimate]:
    """With the standard errors of a first-order process that was watched for so long; the pace
    is known to a step of ``PACES_S``."""
    error = math.sqrt(slow.time_s / max(2.0 * slow.seconds, slow.time_s))
    found = {
        one.name: Estimate(spread, error * spread if spread else None, one.unit)
        for one, spread in zip(WIND.sizes, slow.spread.tolist(), strict=True)
    }
    (pace,) = (one for one in WIND.parameters if one.kind == "shape")
    return {
        **found,
        pace.name: Estimate(slow.time_s, max(2.0 * error, 0.5) * slow.time_s, pace.unit),
    }


def _with_term(model: Model, slow: Slow) -> Model:
    import msgspec

    if not slow.spread.any():
        return model
    effects = (*model.effects, EffectTerm(WIND.name, _parameters(slow)))
    return msgspec.structs.replace(model, effects=effects)


def _joined(findings: Findings, slow: Slow, after: Slow, gaps: tuple[float, float]) -> Findings:
    """after: what lasts on held-out rows. gaps: of held-out predictions before and after."""
    model = _with_term(findings.model, slow)
    effect = FoundEffect(
        name=WIND.name,
        order=len(findings.effects) + 1,
        parameters=_parameters(slow),
        evidence={
            "likelihood_ratio": slow.drop,
            "t": slow.t,
            "held_out": after.drop,
            "held_out_expected": slow.drop * after.seconds / slow.seconds,
            "axes": 0.0,
            "recordings": 0.0,
            "whitened_before": gaps[0],
            "whitened_after": gaps[1],
        },
        alternatives=(),
        channels=tuple(CHANNELS[c] for c in np.flatnonzero(slow.spread).tolist()),
        adds=WIND.adds,
        model=model,
    )
    return replace(
        findings,
        verdict=Verdict.EFFECTS_FOUND,
        effects=(*findings.effects, effect),
        model=model,
        candidates=(*findings.candidates, _candidate(slow, after.drop, None)),
    )


def _refused(findings: Findings, slow: Slow, why: Refusal) -> Findings:
    return replace(findings, candidates=(*findings.candidates, _candidate(slow, 0.0, why)))


def _candidate(slow: Slow, held_out: float, why: Refusal | None) -> Candidate:
    return Candidate(WIND.name, _parameters(slow), slow.drop, slow.t, held_out, why is None, why)
