"""What speaks for one effect: likelihood, flights left out, blocks of time, channels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from groundstation.discrepancy.screening import cost_without, sizes_at
from groundstation.errors import BadInputError
from groundstation.identification.body.setup import unseen_delay_s
from groundstation.identification.estimate import inverse
from groundstation.identification.flight import Flight, prepare
from groundstation.identification.likelihood.motion import BODY_KEYS, Variant, value
from groundstation.identification.likelihood.problem import Fit, Problem
from groundstation.identification.likelihood.spectra import (
    Linear,
    Noise,
    Spectrum,
    quadratic,
    white_rows,
)
from groundstation.telemetry.arrays import Array

BLOCK_S = 1.0
"""Longer than any residual is correlated once it is whitened."""
HELD_OUT_SHARE = 0.2
"""Of what an effect promises on flights that are left out, the least that they have to gain: it
may be of another size there, and then gains nothing at half of it."""
TOUCHED = 0.02
"""Share of an effect's power in its strongest channel, from which it touches a channel."""
BANDS_AN_OCTAVE = 3.0
"""In which an effect is weighed against settings that no row shows: wide enough for a mean."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """drop: of -2 log L in the fit, the prior included; held_out: of that of flights that its size
    was not taken from, each left out once, expected: what it is there for an effect of the fitted
    size. t: by blocks. channels: that it touches. beyond: what it does (drop of -2 log L) more
    than settings of the motors that no row shows can do; infinite where rows show all of them."""

    drop: float
    held_out: float
    expected: float
    t: float
    channels: tuple[int, ...]
    beyond: float = math.inf


def gather(
    problem: Problem, folds: Sequence[Flight], fit: Fit, variants: Sequence[Variant]
) -> list[Evidence]:
    """What speaks for each of these effects of a joint fit beside the others. folds: flights each
    of which is left out once (``folds_of``)."""
    linear = problem.linear(fit.point, fit.keys, problem.flights)
    alike = all(one is other for one, other in zip(folds, problem.flights, strict=False))
    there = linear if alike else problem.linear(fit.point, fit.keys, folds)
    covariance = inverse(problem.with_prior(linear).normal)
    found = []
    for variant in variants:
        sizes = sizes_at(variant, fit.point)
        drop = cost_without(variant, fit.point, linear.keys, covariance)
        held, expected = drop, drop
        if folds:
            held, expected = cross_validated(problem, there, variant.keys, sizes)
        effect = separated(problem, linear, variant)
        t, channels = by_blocks(problem, effect), touched(problem, linear, variant)
        beyond = beyond_unseen(problem, effect)
        found.append(Evidence(drop, held, expected, t, channels, beyond))
    return found


def folds_of(flights: Sequence[Flight]) -> list[Flight]:
    """What is left out one by one: each flight, or the thirds of one that is alone; none where
    these are too short to tell anything."""
    if len(flights) > 1:
        return list(flights)
    (flight,) = flights
    ends = np.linspace(flight.first, flight.last, 4).astype(int).tolist()
    parts = [flight.run[a:b] for a, b in pairwise(ends)]
    try:
        found = [one for part in parts for one in prepare([part])]
    except BadInputError:
        return []
    return found if len(found) > 1 else []


def cross_validated(
    problem: Problem, linear: Linear, keys: Sequence[str], sizes: Array
) -> tuple[float, float]:
    """(what -2 log L of each flight of ``linear`` falls by, summed, where ``keys`` are what the
    other flights say, beside where they are absent; what it would fall by, were the fitted sizes
    the truth).

    sizes: (k,) of the first of ``keys``, counted from absent; the others, shapes, stay. All other
    numbers are at their best for the flight that is left out, on either side: flights of one craft
    differ in them (a brushed craft's c2 by a factor of four with the air).
    """
    own = linear.place(keys[: len(sizes)])
    rest = [i for i, key in enumerate(linear.keys) if key not in keys]
    told = [*own, *rest]
    prior = problem.with_prior(replace(linear, spectra=[], verticals=[]))
    whole = problem.with_prior(linear)
    held = expected = 0.0
    for number in sorted({s.flight for s in linear.spectra}):
        spectra = [s for s in linear.spectra if s.flight == number]
        verticals = [row for row in linear.verticals if row.flight == number]
        one = quadratic(spectra, problem.noise, verticals, len(linear.keys))
        left, pushed = whole.normal - one.normal, whole.gradient - one.gradient
        others = (inverse(left[np.ix_(told, told)]) @ pushed[told])[: len(own)]
        normal, gradient = one.normal + prior.normal, one.gradient + prior.gradient
        cross = normal[np.ix_(own, rest)]
        pull = cross @ inverse(normal[np.ix_(rest, rest)])
        inner = normal[np.ix_(own, own)] - pull @ cross.T
        slope = gradient[own] - pull @ gradient[rest]

        def rise(step: Array, inner: Array = inner, slope: Array = slope) -> float:
            return float(step @ inner @ step - 2.0 * slope @ step)

        held += rise(-sizes) - rise(others)
        expected += float(sizes @ inner @ sizes)
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

    linear: of the joint fit. weights: (p,) of all its columns, which make them that one.
    """

    linear: Linear
    weights: Array


def separated(problem: Problem, linear: Linear, variant: Variant) -> Separated:
    """An effect of a joint fit, apart from the rest of it."""
    return Separated(linear, _alone(problem, linear, variant))


def by_blocks(problem: Problem, effect: Separated) -> float:
    """t of the whole effect from scores by blocks of time."""
    linear, weights = effect.linear, effect.weights
    information, variance = 0.0, 0.0
    scores: dict[int, list[Array]] = {}
    for s in linear.spectra:
        if not len(s.place):
            continue
        column = weights[s.place] @ s.columns
        scale = s.weight / problem.noise[s.channel].at(s.hz)
        information += float((scale * column**2).sum())
        scores.setdefault(s.flight, []).append(_block_scores(s, column, problem, s.channel))
    for pieces in scores.values():
        blocks = min(len(p) for p in pieces)
        summed = np.sum([p[:blocks] for p in pieces], axis=0)
        variance += float((summed**2).sum())
    if information <= 0.0:
        return 0.0
    # Scores have mean zero at the optimum: their sum of squares is the variance of their sum.
    return information / max(variance, information) ** 0.5


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
    noise = problem.noise[channel]
    rows = white_rows(s, noise, column) * white_rows(s, noise, s.residual)
    rows *= 0.5 * float(s.weight.sum())
    step = 1.0 / (2.0 * s.hz[-1])
    block = max(1, round(BLOCK_S / step))
    count = len(rows) // block
    return rows[: count * block].reshape(count, block).sum(axis=1)
