"""Whether a fitted effect is believed: the tests that every name has to pass.

Held-out rows must be predicted better by it, as much as the fitted ones promise; its size must
be many standard errors, reckoned from blocks of time; it must be one that a small craft can
have; and axes and recordings must agree on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.flight import Flight
from groundstation.discrepancy.problem import Fit, Problem
from groundstation.discrepancy.spectra import Spectrum
from groundstation.discrepancy.unknowns import Variant, absent, estimates_of
from groundstation.identification.estimate import inverse

Array = NDArray[np.float64]

LEAST_T = 4.5
"""Standard errors, from scores by blocks: about one false alarm in 100 000 trials."""
LEAST_DROP, DROP_PER_PARAMETER = 20.0, 6.0
LEAST_HELD_OUT, HELD_OUT_SHARE = 3.0, 0.2
BLOCK_S = 1.0
LEAST_GYRO_BIAS_DPS = 0.16
DISAGREE, DISAGREE_SHARE = 5.0, 0.4
"""Parts disagree where they lie this many standard errors and this share of the size apart."""
HEARD = 0.05
"""Share of what all know of the size, from which a channel or recording is heard on it: where an
effect hardly shows, a small fault of a strong one looks like a disagreement."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """drop: of -2 log L in the fit; held_out: of the same on held-out rows, expected: what the
    fitted ones promise for it. t: by blocks. parts: (flight, channel) -> size relative to the
    joint fit, and its standard error. gap: whitened RMS on held-out rows before and after, over
    the channels it touches."""

    drop: float
    held_out: float
    expected: float
    t: float
    parts: dict[tuple[int, int], tuple[float, float]]
    gap: tuple[float, float]
    channels: tuple[int, ...]

    def spread(self, by: int) -> tuple[float, float]:
        """(standard deviations, share of the size) by which parts disagree most, recordings
        (by 0) or channels (by 1)."""
        groups: dict[int, list[tuple[float, float]]] = {}
        for key, part in self.parts.items():
            groups.setdefault(key[by], []).append(part)
        sizes, weights = [], []
        for parts in groups.values():
            weight = sum(error**-2 for _, error in parts)
            sizes.append(sum(size * error**-2 for size, error in parts) / weight)
            weights.append(weight)
        if len(sizes) < 2:
            return 0.0, 0.0
        every, trust = np.array(sizes), np.array(weights)
        heard = trust > HEARD * trust.sum()
        every, trust = every[heard], trust[heard]
        away = np.abs(every - float((every * trust).sum() / trust.sum()))
        worst = int(np.argmax(away * np.sqrt(trust)))
        return float(away[worst] * np.sqrt(trust[worst])), float(away[worst])


def judge(
    problem: Problem, validation: Sequence[Flight], before: Fit, after: Fit, variant: Variant
) -> Evidence:
    """Gather what speaks for a variant: ``before`` and ``after`` it joined."""
    held, expected, gap, channels = 0.0, 0.0, (1.0, 1.0), _channels(problem, after, variant)
    drop = before.cost - after.cost
    if validation:
        one, own, freedom = problem.cost(before.point, validation)
        other, better, _ = problem.cost(after.point, validation)
        held = one - other
        rows = sum(f.last - f.first for f in problem.flights)
        expected = drop * sum(f.last - f.first for f in validation) / rows
        count = max(sum(freedom.get(c, 0.0) for c in channels), 1.0)
        gap = (
            float(np.sqrt(sum(own.get(c, 0.0) for c in channels) / count)),
            float(np.sqrt(sum(better.get(c, 0.0) for c in channels) / count)),
        )
    t, parts = by_parts(problem, after, variant)
    return Evidence(drop, held, expected, t, parts, gap, channels)


def refusal(variant: Variant, fit: Fit, evidence: Evidence) -> str:
    """Why a variant is not believed; empty where it is."""
    least = LEAST_DROP + DROP_PER_PARAMETER * (len(variant.keys) - 1)
    if not plausible(variant, fit.point):
        values = ", ".join(
            f"{name} {estimate.value:.3g} {estimate.unit}".strip()
            for name, estimate in estimates_of(variant, fit.point, {}).items()
        )
        return f"not plausible: {values}"
    if evidence.drop < least or evidence.t < LEAST_T:
        return f"not significant: {evidence.t:.1f} standard errors"
    if evidence.held_out < max(LEAST_HELD_OUT, HELD_OUT_SHARE * evidence.expected):
        return "does not predict held-out rows better"
    return ""


def disagreement(evidence: Evidence) -> str:
    """Whether channels or recordings tell different sizes; empty where they agree.

    To be asked of the final fit: as long as something else is missing, its traces make any
    effect's parts disagree.
    """
    for by, what in ((1, "channels"), (0, "recordings")):
        errors, share = evidence.spread(by)
        if errors > DISAGREE and share > DISAGREE_SHARE:
            return f"{what} disagree on its size by {errors:.0f} standard errors"
    return ""


def negligible(variant: Variant, point: Mapping[str, float]) -> bool:
    """Whether a parameter that is surely not zero is too small to be called an effect.

    The firmware subtracts a whole number of counts as the gyro's bias, from 128 noisy samples:
    up to two counts, 0.122 deg/s, always lie between the gyro and the attitude.
    """
    if variant.effect != "gyro_bias":
        return False
    return float(np.linalg.norm([point[key] for key in variant.keys])) < LEAST_GYRO_BIAS_DPS


def plausible(variant: Variant, point: Mapping[str, float]) -> bool:
    """Whether the values are ones that a small craft can have."""
    values = estimates_of(variant, point, {})
    return variant.definition.plausible({k: e.value for k, e in values.items()})


def _channels(problem: Problem, fit: Fit, variant: Variant) -> tuple[int, ...]:
    linear = problem.linear(fit.point, variant.keys, problem.flights[:1])
    power = {
        s.channel: float(
            (
                s.weight * (np.abs(s.columns) ** 2).sum(axis=0) / problem.noise[s.channel].at(s.hz)
            ).sum()
        )
        for s in linear.spectra
        if len(s.columns)
    }
    most = max(power.values(), default=0.0)
    return tuple(sorted(c for c, p in power.items() if p > 0.02 * most))


def by_parts(
    problem: Problem, fit: Fit, variant: Variant
) -> tuple[float, dict[tuple[int, int], tuple[float, float]]]:
    """t of the whole effect from scores by blocks of time, and its size by flight and channel.

    The effect's columns, weighted with its values, are one column whose coefficient is 1 in the
    joint fit; what the other unknowns can imitate of it is taken out.
    """
    linear = problem.linear(fit.point, fit.keys, problem.flights)
    total = problem.with_prior(linear)
    own = linear.place(variant.keys)
    rest = [i for i in range(len(linear.keys)) if i not in own]
    sizes = np.array([linear.point[key] - absent(key) for key in variant.keys])
    if variant.effect == "ground_effect":
        sizes[1] = 0.0
    weights = np.zeros(len(linear.keys))
    weights[own] = sizes
    normal = total.normal
    imitated = inverse(normal[np.ix_(rest, rest)]) @ (normal[np.ix_(rest, own)] @ sizes)
    weights[rest] = -imitated
    information, variance = 0.0, 0.0
    parts: dict[tuple[int, int], tuple[float, float]] = {}
    scores: dict[int, list[Array]] = {}
    for s in linear.spectra:
        if not len(s.place):
            continue
        column = weights[s.place] @ s.columns
        scale = s.weight / problem.noise[s.channel].at(s.hz)
        strength = float((scale * column**2).sum())
        score = float((scale * column * s.residual).sum())
        information += strength
        if strength > 9.0 and np.isin(s.place, own).any():
            parts[s.flight, s.channel] = (1.0 + score / strength, strength**-0.5)
        scores.setdefault(s.flight, []).append(_block_scores(s, column, problem, s.channel))
    for pieces in scores.values():
        blocks = min(len(p) for p in pieces)
        summed = np.sum([p[:blocks] for p in pieces], axis=0)
        variance += float((summed**2).sum())
    if information <= 0.0:
        return 0.0, parts
    # Scores have mean zero at the optimum: their sum of squares is the variance of their sum.
    return information / max(variance, information) ** 0.5, parts


def _block_scores(s: Spectrum, column: Array, problem: Problem, channel: int) -> Array:
    """Scores of whitened rows, summed over blocks of a second."""
    from scipy.fft import irfft

    root = 1.0 / np.sqrt(problem.noise[channel].at(s.hz))
    bins = len(s.hz) // 2
    size = 2 * (bins - 1)

    def rows_of(values: Array) -> Array:
        white = values * root
        return np.asarray(irfft(white[:bins] + 1j * white[bins:], size))

    rows = rows_of(column) * rows_of(s.residual) * 0.5 * float(s.weight.sum())
    step = 1.0 / (2.0 * s.hz[bins - 1])
    block = max(1, round(BLOCK_S / step))
    count = len(rows) // block
    return np.asarray(rows[: count * block].reshape(count, block).sum(axis=1))
