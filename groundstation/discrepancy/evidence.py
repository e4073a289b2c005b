"""What speaks for one effect: likelihood, held-out rows, blocks of time, channels, recordings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.discrepancy.screening import sizes_at
from groundstation.dynamics.registry import DELAY
from groundstation.identification.body.certainty import unseen_delay_s
from groundstation.identification.estimate import inverse
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.free_spectra import reweighted, smoothed
from groundstation.identification.likelihood.linearisation import Linear
from groundstation.identification.likelihood.parameters import BODY_KEYS, Variant, value
from groundstation.identification.likelihood.problem import Fit, Problem
from groundstation.identification.likelihood.spectra import Noise, Spectrum, quadratic
from groundstation.identification.speed_noise import tells_up_to_hz

Array = NDArray[np.float64]

BLOCK_S = 1.0
"""Longer than any residual is correlated once it is whitened."""
HELD_OUT_SHARE = 0.2
"""Of what an effect promises on held-out rows, the least that they have to gain: it may be of
another size there, and then gains nothing at half of it."""
LATE_SHARE = 0.4
"""Of a fitted delay, what held-out flights have of their own at least: a sensor's clock starts at
any phase, so flights of one craft are up to a period more or less late (1.5 to 3.5 ms, the 1.0)."""
INFORMED = 0.05
"""Least share of Fisher information for the homogeneity test: where an effect hardly shows, a
small fault of a strong one looks like a disagreement."""
TOUCHED = 0.02
"""Share of an effect's power in its strongest channel, from which it touches a channel."""
BANDS_AN_OCTAVE = 3.0
"""In which an effect is weighed against settings that no row shows: wide enough for a mean."""
LEAST_INFORMATION = 9.0
"""A part that knows the size to a third of it, or better, takes part in the comparison."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """drop: of -2 log L in the fit, the prior included; held_out: of that of held-out rows,
    expected: what it is there, on average, for an effect of the fitted size (a flight may hardly do
    what shows in another, and what was known before the flights promises nothing). information: of
    held-out rows on the size, relative to the fitted one. t: by blocks.
    parts: (flight, channel) -> size relative to the joint fit, and its standard error. gap:
    whitened RMS on held-out rows before and after, over the channels it touches. recordings: names
    by number of the flight. beyond: what it does (drop of -2 log L) more than settings of the
    motors that no row shows can do; infinite where rows show all of them."""

    drop: float
    held_out: float
    expected: float
    information: float
    t: float
    parts: dict[tuple[int, int], tuple[float, float]]
    gap: tuple[float, float]
    channels: tuple[int, ...]
    recordings: tuple[str, ...] = ()
    beyond: float = math.inf

    def sizes(self, by: int) -> dict[int, tuple[float, float]]:
        """(size relative to the joint fit, its weight) as recordings (by 0) or channels (by 1) tell
        it, of those that are informed."""
        groups: dict[int, list[tuple[float, float]]] = {}
        for place, part in self.parts.items():
            groups.setdefault(place[by], []).append(part)
        found = {}
        for key, parts in groups.items():
            weight = sum(error**-2 for _, error in parts)
            found[key] = sum(size * error**-2 for size, error in parts) / weight, weight
        every = sum(weight for _, weight in found.values())
        if by == 0:  # flights that no fit saw may know it by far better
            every += self.information
        return {k: one for k, one in found.items() if len(found) < 2 or one[1] > INFORMED * every}

    def spread(self, by: int) -> list[tuple[float, float]]:
        """(standard errors by which a part's size is away from all parts', share that theirs leaves
        of what the effect explains there) of each part; none where there is only one.

        Where the size is r times theirs, r^2 - (r - 1)^2 of r^2 is explained: at half of it
        nothing, at twice three quarters.
        """
        parts = np.array(list(self.sizes(by).values()))
        if len(parts) < 2:
            return []
        every, trust = parts.T
        away = np.abs(every - float((every * trust).sum() / trust.sum()))
        left = (away / np.maximum(np.abs(every), 1e-300)) ** 2
        return list(zip((away * np.sqrt(trust)).tolist(), left.tolist(), strict=True))

    def apart(self, by: int) -> float:
        """Standard errors by which parts lie apart most."""
        return max((errors for errors, _ in self.spread(by)), default=0.0)


def gather(
    problem: Problem,
    validation: Sequence[Flight],
    before: Fit,
    after: Fit,
    variant: Variant,
    away: Linear | None = None,
) -> Evidence:
    """What speaks for a variant: ``before`` and ``after`` it joined. away: held-out rows as the fit
    before leaves them, where they have been evaluated."""
    held, expected, information = 0.0, 0.0, 0.0
    gap, drop = (1.0, 1.0), before.cost - after.cost
    linear = problem.linear(after.point, after.keys, problem.flights)
    channels = touched(problem, linear, variant)
    if validation:
        if away is None:
            away = problem.linear(before.point, (), validation)
        near = problem.linear(after.point, (), validation)
        one, own, freedom = problem.cost_of(away)
        other, better, _ = problem.cost_of(near)
        held, expected = one - other, problem.apart(away, near)
        information = expected
        if held < HELD_OUT_SHARE * expected:
            free = problem.linear(after.point, BODY_KEYS, validation)
            held, expected = beside_own_constants(away, free, problem.noise)
            information = expected
        if held < HELD_OUT_SHARE * expected and variant.keys == (DELAY,):
            late = problem.linear(after.point, (*BODY_KEYS, DELAY), validation)
            if own_value(late, problem.noise, DELAY) >= LATE_SHARE * value(after.point, DELAY):
                held, expected = beside_own_constants(away, late, problem.noise)
        if held < HELD_OUT_SHARE * expected:
            held, expected = by_own_noise(away, where_speeds_tell(free, validation))
        count = max(sum(freedom.get(c, 0.0) for c in channels), 1.0)
        gap = (
            float(np.sqrt(sum(own.get(c, 0.0) for c in channels) / count)),
            float(np.sqrt(sum(better.get(c, 0.0) for c in channels) / count)),
        )
    effect = separated(problem, linear, variant)
    t, parts = by_parts(problem, effect)
    names = tuple(flight.run.name for flight in problem.flights)
    beyond = beyond_unseen(problem, effect)
    return Evidence(drop, held, expected, information, t, parts, gap, channels, names, beyond)


def beside_own_constants(
    away: Linear, near: Linear, noises: Mapping[int, Noise]
) -> tuple[float, float]:
    """What -2 log L of the same flights falls by from one point to another, and by how much it
    would where the other is the truth, whatever these flights' own c0..c2 and thrust are.

    near: with the columns of these constants. Flights of one craft differ in them (a brushed
    craft's c2 by a factor of four with the air, docs/real_flights.md): an effect that foretells the
    rest is not to be refused for that.
    """

    def least(residuals: Iterable[Array]) -> float:
        spectra = [replace(s, residual=one) for s, one in zip(near.spectra, residuals, strict=True)]
        found = quadratic(spectra, noises, (), len(near.keys))
        return found.value - float(found.gradient @ inverse(found.normal) @ found.gradient)

    before, after = ([s.residual for s in one.spectra] for one in (away, near))
    moved = (one - other for one, other in zip(before, after, strict=True))
    return least(before) - least(after), least(moved)


def own_value(near: Linear, noises: Mapping[int, Noise], key: str) -> float:
    """The value of ``key`` that flights have of their own, beside their own c0..c2 and thrust."""
    found = quadratic(near.spectra, noises, (), len(near.keys))
    change = inverse(found.normal) @ found.gradient
    return value(near.point, key) + float(change[near.keys.index(key)])


def where_speeds_tell(linear: Linear, flights: Sequence[Flight]) -> Linear:
    """The same of flights, where recorded rotor speeds are not mostly noise: a change of the model
    makes more or less of their noise, and is not to be judged by that."""
    return linear.within(0.0, [tells_up_to_hz(one) for one in flights])


def by_own_noise(away: Linear, near: Linear) -> tuple[float, float]:
    """``beside_own_constants`` with noise of these flights' own, free at every frequency, before
    and after; weights are those of ``near``.

    Of flights that are flown otherwise the fitted ones say neither how much slow air they meet nor
    how they shake (a figure of eight beside turns on the spot: docs/real_flights.md). It is the
    last question, for a spectrum that holds what is still missing hides what is small beside it.
    """
    anywhere = np.full(len(near.keys), np.inf)

    def least(residuals: Iterable[Array]) -> list[Array]:
        spectra = [replace(s, residual=one) for s, one in zip(near.spectra, residuals, strict=True)]
        linear = replace(near, spectra=spectra, verticals=[])
        change, _, _ = reweighted(linear, None, -anywhere, anywhere)
        return [s.residual - change[s.place] @ s.columns for s in spectra]

    before, after = (least(s.residual for s in one.spectra) for one in (away, near))
    moved = [one - other for one, other in zip(before, after, strict=True)]
    powers = (smoothed(near.spectra, values) for values in (before, after, moved))
    held = expected = 0.0
    for s, one, other, apart in zip(near.spectra, *powers, strict=True):
        weight = s.weight[: len(one)]
        held += float(weight @ np.log(one / other))
        expected += float(weight @ np.log1p(apart / other))
    return held, expected


def touched(problem: Problem, linear: Linear, variant: Variant) -> tuple[int, ...]:
    """Channels that a variant touches in the first flight of a joint fit."""
    places, power = linear.place(variant.keys), {}
    for s in linear.spectra:
        own = s.columns[np.isin(s.place, places)]
        if s.flight == 0 and len(own):
            scale = s.weight / problem.noise[s.channel].at(s.hz)
            power[s.channel] = float((scale * np.square(own).sum(axis=0)).sum())
    most = max(power.values(), default=0.0)
    return tuple(sorted(c for c, p in power.items() if p > TOUCHED * most))


@dataclass(frozen=True, slots=True)
class Separated:
    """An effect as one column, whose coefficient is 1 in the joint fit, without what the other
    unknowns can imitate of it.

    linear: of the joint fit. own: (k,) places of the effect's columns in it. weights: (p,) of all
    its columns, which make them that one.
    """

    linear: Linear
    own: list[int]
    weights: Array


def separated(problem: Problem, linear: Linear, variant: Variant) -> Separated:
    """An effect of a joint fit, apart from the rest of it."""
    return Separated(linear, linear.place(variant.sizes), _alone(problem, linear, variant))


def by_parts(
    problem: Problem, effect: Separated
) -> tuple[float, dict[tuple[int, int], tuple[float, float]]]:
    """t of the whole effect from scores by blocks of time, and its size by flight and channel."""
    linear, own, weights = effect.linear, effect.own, effect.weights
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
        if strength > LEAST_INFORMATION and np.isin(s.place, own).any():
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


def beyond_unseen(problem: Problem, effect: Separated) -> float:
    """``Evidence.beyond``: summed over flights, channels and bands."""
    unseen = [0.0 if f.rotor_measured else unseen_delay_s(f.run) for f in problem.flights]
    if not any(unseen):
        return math.inf
    linear, weights = effect.linear, effect.weights
    torque = np.array([value(linear.point, k) if k in BODY_KEYS else 0.0 for k in linear.keys])
    return sum(
        power_beyond(
            weights[s.place] @ s.columns,
            torque[s.place] @ s.columns,
            s,
            problem.noise[s.channel],
            unseen[s.flight],
        )
        for s in linear.spectra
        if len(s.place)
    )


def power_beyond(effect: Array, answer: Array, s: Spectrum, noise: Noise, late_s: float) -> float:
    """Power beside noise that an effect (2 m,) has in a channel beyond what a late answer to the
    motors has, summed over bands. answer: (2 m,) of the channel to the motors."""
    scale = s.weight / noise.at(s.hz)
    late = 2.0 * np.pi * s.hz * late_s * answer
    least = s.hz[s.hz > 0.0].min()
    band = (BANDS_AN_OCTAVE * np.log2(np.maximum(s.hz, least) / least)).astype(np.int64)
    powers = (np.bincount(band, scale * column**2) for column in (effect, late))
    own, can_be = powers
    return float(np.maximum(own - can_be, 0.0).sum())


def _alone(problem: Problem, linear: Linear, variant: Variant) -> Array:
    """Weights (p,) of the columns that make an effect one column, without what the other unknowns
    can imitate of it."""
    own = linear.place(variant.sizes)
    rest = [i for i, key in enumerate(linear.keys) if key not in variant.keys]
    sizes = sizes_at(variant, linear.point)
    weights = np.zeros(len(linear.keys))
    weights[own] = sizes
    normal = problem.with_prior(linear).normal
    weights[rest] = -inverse(normal[np.ix_(rest, rest)]) @ (normal[np.ix_(rest, own)] @ sizes)
    return weights


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
