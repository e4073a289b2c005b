"""Which effects are worth a joint fit: screening, evidence, and whether anything is left to
explain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from groundstation.comparison.gap import CHANNELS
from groundstation.discrepancy.proof import Leftover
from groundstation.dynamics.effect import Key
from groundstation.errors import BadInputError
from groundstation.identification.body_setup import unseen_delay_s
from groundstation.identification.estimate import inverse
from groundstation.identification.flight import LEAK_S, LEANING_LEAK_S, Flight, prepare
from groundstation.identification.likelihood.evaluation import generic_signals
from groundstation.identification.likelihood.linear import Linear, Spectrum, transform_channel
from groundstation.identification.likelihood.motion import (
    BODY_KEYS,
    KEYS,
    Frame,
    Point,
    Variant,
    absent,
    spin_rotors,
    value,
)
from groundstation.identification.likelihood.problem import (
    BASE_KEYS,
    Fit,
    Noise,
    Problem,
    Quadratic,
    beside_lasting,
    bounded,
    quadratic,
    white_rows,
)
from groundstation.telemetry.arrays import Array

# Every effect at once: what each would explain at one point.
#
# One Gram matrix of all columns holds what any subset of the effects, fitted jointly, would take
# off -2 log L, to first order.


PENALTY = 8.0
"""For each parameter, in -2 log L: the logarithm of some 3000 independent values (Schwarz 1978)."""
BENT, SETTLINGS = 0.12, 8
"""A body constant so far off (in the logarithm) is not where columns are evaluated; how often it
is moved: by a factor of five at most each time."""
CURVED = {key: one.parameter.near for key, one in KEYS.items() if one.parameter.near is not None}
"""Step beyond which columns are recomputed, of the unknowns on which other columns depend."""
UNDETERMINED = 1e-9
"""Share of a column's power that no other column imitates, below which its size is unknown."""


@dataclass(frozen=True, slots=True)
class Scored:
    """A variant in the screening: drop of -2 log L, and its sizes, counted from absent, with
    their standard errors."""

    variant: Variant
    drop: float
    values: Array
    errors: Array

    @property
    def t(self) -> float:
        return float(np.max(np.abs(self.values) / np.maximum(self.errors, 1e-300)))

    @property
    def penalised(self) -> float:
        return self.drop - PENALTY * len(self.variant.keys)


@dataclass(frozen=True, slots=True)
class Screening:
    """-2 log L around a point as a parabola of every unknown in ``keys`` (p,), with the prior's
    part."""

    point: Point
    keys: tuple[str, ...]
    total: Quadratic

    def place(self, keys: Sequence[str]) -> list[int]:
        return [self.keys.index(key) for key in keys]

    def covariance(self, keys: Sequence[str]) -> Array:
        """Of ``keys`` fitted jointly, (k, k)."""
        at = self.place(keys)
        return inverse(self.total.normal[np.ix_(at, at)])

    def without_effects(self, kept: Sequence[str]) -> Screening:
        """The same parabola seen from where every effect but those behind ``kept`` is absent."""
        point, total = self.point, self.total
        gone = {k: absent(k) for k in self.keys if k not in BASE_KEYS and k in point}
        gone = {k: v for k, v in gone.items() if k not in kept}
        if not gone:
            return self
        step = np.array([gone[k] - point[k] if k in gone else 0.0 for k in self.keys])
        value = total.value - 2.0 * total.gradient @ step + step @ total.normal @ step
        there = {k: v for k, v in point.items() if k not in gone}
        gradient = total.gradient - total.normal @ step
        return Screening(there, self.keys, replace(total, gradient=gradient, value=float(value)))

    def scores(self, base_keys: Sequence[str], variants: Sequence[Variant]) -> list[Scored]:
        """Every variant's drop of -2 log L when it joins ``base_keys``, best first."""
        total = self.total
        variants = self._seen(variants)
        at = self.place(base_keys)
        base = inverse(total.normal[np.ix_(at, at)])
        settled = base @ total.gradient[at]
        scored = []
        for variant in variants:
            own = self.place(variant.sizes)
            cross = total.normal[np.ix_(own, at)]
            normal = total.normal[np.ix_(own, own)]
            left = normal - cross @ base @ cross.T
            gradient = total.gradient[own] - cross @ settled
            alive = np.diag(left) > UNDETERMINED * np.maximum(np.diag(normal), 1e-300)
            values, errors, drop = np.zeros(len(own)), np.full(len(own), np.inf), 0.0
            if alive.any():
                covariance = inverse(left[np.ix_(alive, alive)])
                values[alive] = covariance @ gradient[alive]
                errors[alive] = np.sqrt(np.diag(covariance))
                drop = float(gradient[alive] @ values[alive])
            scored.append(Scored(variant, drop, values, errors))
        return sorted(scored, key=lambda one: one.penalised, reverse=True)

    def _seen(self, variants: Sequence[Variant]) -> list[Variant]:
        """Those whose columns are here."""
        return [one for one in variants if set(one.sizes) <= set(self.keys)]

    def beside_all(self, variants: Sequence[Variant]) -> list[Scored]:
        """Every variant's size and share of -2 log L beside all the others at once."""
        covariance = inverse(self.total.normal)
        change = covariance @ self.total.gradient
        scored = []
        for variant in self._seen(variants):
            own = self.place(variant.sizes)
            values = sizes_at(variant, self.point) + change[own]
            block = covariance[np.ix_(own, own)]
            drop = removal_cost(values, block)
            scored.append(Scored(variant, drop, values, np.sqrt(np.diag(block))))
        return scored


def screen(problem: Problem, point: Point, more: Sequence[str] = ()) -> Screening:
    """All columns at a point, and those of ``more`` keys; the noise is learnt anew there."""
    keys = tuple(dict.fromkeys((*problem.every_key, *more)))
    linear = problem.learn_noise(problem.linear(point, keys, problem.flights))
    return Screening(linear.point, linear.keys, problem.with_prior(linear))


def settle(problem: Problem) -> Screening:
    """All columns where a fit of every effect at once says that they mean something.

    A base that was fitted to the affected flights may be bent so far that no column evaluated
    there means anything; delays, lags and the rotors' inertia multiply each other, and yaw
    torque behind a lag looks like the rotors' acceleration. So the body's constants and
    what is far from linear move to what all effects together say, until they stay.
    """
    point = problem.start | problem.near
    for _ in range(SETTLINGS):
        seen = screen(problem, point)
        change = _within_reason(seen, problem.frame.unknowns)
        at = seen.place(BODY_KEYS)
        moved = bounded(point, BODY_KEYS, change[at])
        bent = any(abs(np.log(moved[key] / point[key])) > BENT for key in BODY_KEYS)
        goals = bounded(point, list(CURVED), change[seen.place(list(CURVED))])
        goals |= {key: _possible(KEYS[key], goals[key]) for key in CURVED}
        far = [k for k, near in CURVED.items() if abs(goals[k] - point.get(k, absent(k))) > near]
        if not bent and not far:
            break
        if bent or any(key in point for key in far):
            point = moved
        point |= {key: goals[key] for key in far}
    return seen


def _within_reason(seen: Screening, unknowns: Mapping[str, Key]) -> Array:
    """The change (p,) to the best fit of everything at once, with each effect's range as a weak
    prior: a yaw damping of a thousand times that would bend c2 tenfold to go with it."""
    normal, gradient = seen.total.normal.copy(), seen.total.gradient.copy()
    for i, key in enumerate(seen.keys):
        one = unknowns.get(key)
        if one is not None:
            size = max(abs(end - one.absent) for end in one.plausible)
            normal[i, i] += size**-2
            gradient[i] += (one.absent - seen.point.get(key, one.absent)) / size**2
    return inverse(normal) @ gradient


def tried(
    problem: Problem, point: Point, keys: Sequence[str], variants: Sequence[Variant]
) -> list[list[tuple[Scored, Point]]]:
    """What absent variants would explain beside a fit of ``keys``, and at which values of the shape
    of which several are tried; nothing of variants without such a shape."""
    probes = {
        variant.label: [_probe(variant, shape, number) for number in shape.parameter.tried]
        for variant in variants
        if (shape := variant.tried) is not None
    }
    every = [one for some in probes.values() for one in some]
    if not every:
        return []
    wide = copy(problem)
    wide.frame = replace(problem.frame, own=(*problem.frame.own, *every))
    sizes = (key for one in every for key in one.sizes)
    linear = wide.linear(point, (*keys, *sizes), problem.flights)
    seen = Screening(linear.point, linear.keys, wide.with_prior(linear))
    return [
        [
            (replace(seen.scores(keys, [one])[0], variant=variant), {variant.tried.key: key.absent})
            for one in probes[variant.label]
            if (key := one.tried) is not None
        ]
        for variant in variants
        if variant.tried is not None
    ]


def _probe(variant: Variant, shape: Key, number: float) -> Variant:
    """A variant with another value of a shape where it is absent, under keys of its own."""
    return replace(
        variant,
        unknowns=tuple(
            replace(
                one,
                key=f"{one.key} at {number:g}",
                parameter=replace(one.parameter, default=number) if one is shape else one.parameter,
            )
            for one in variant.unknowns
        ),
    )


def removal_cost(values: Array, covariance: Array) -> float:
    """What -2 log L gains, to first order, when sizes (k,) with covariance (k, k) leave and the
    others settle."""
    return float(values @ inverse(covariance) @ values)


def beside_shapes(variant: Variant, keys: Sequence[str], covariance: Array) -> Array:
    """Covariance of a variant's sizes (k, k) with its shapes as they are: a size may be as little
    known as the form of the effect is, but without a size a form says nothing. covariance: of
    ``keys``."""
    own = [keys.index(key) for key in variant.sizes]
    shapes = [keys.index(key) for key in variant.keys if key not in variant.sizes]
    pull = covariance[np.ix_(own, shapes)] @ inverse(covariance[np.ix_(shapes, shapes)])
    return covariance[np.ix_(own, own)] - pull @ covariance[np.ix_(shapes, own)]


def cost_without(variant: Variant, point: Point, keys: Sequence[str], covariance: Array) -> float:
    """What -2 log L gains, to first order, when a variant leaves a fit at ``point``. covariance: of
    ``keys``."""
    return removal_cost(sizes_at(variant, point), beside_shapes(variant, keys, covariance))


def sizes_at(variant: Variant, point: Point) -> Array:
    """A variant's sizes at a point, counted from absent, (k,)."""
    return np.array([point.get(key, absent(key)) - absent(key) for key in variant.sizes])


def started(point: Point, one: Scored, shapes: Mapping[str, float] | None = None) -> Point:
    """Where a joint fit with a variant begins: its screened sizes, kept plausible, and the shapes
    that they were screened at."""
    start = dict(point)
    variant = one.variant
    if variant.start:
        start.update(zip(variant.keys, variant.start[len(variant.start) // 2], strict=True))
        return start
    start.update({key: (shapes or {}).get(key, absent(key)) for key in variant.keys})
    for unknown, size in zip(variant.unknowns, one.values.tolist(), strict=False):
        start[unknown.key] = _possible(unknown, unknown.absent + size)
    return start


def _possible(unknown: Key, number: float) -> float:
    """The nearest plausible value of an unknown, or where its effect is absent."""
    low, high = unknown.plausible
    return float(np.clip(number, min(low, unknown.absent), high))


def without(point: Point, variant: Variant) -> Point:
    """The point with a variant absent."""
    return {key: number for key, number in point.items() if key not in variant.keys}


# What speaks for one effect: likelihood, flights left out, blocks of time, channels.


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
    """What speaks for an effect of a joint fit, which is at ``point``.

    drop: of -2 log L in the fit, the prior included; held_out: of that of flights that its size
    was not taken from, each left out once, expected: what it is there for an effect of the fitted
    size. t: by blocks. channels: that it touches. beyond: what it does (drop of -2 log L) more
    than settings of the motors that no row shows can do; infinite where rows show all of them."""

    variant: Variant
    point: Point
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
    whole = problem.with_prior(linear)
    covariance = inverse(whole.normal)
    parts = Parts.of(problem, there) if folds else None
    found = []
    for variant in variants:
        sizes = sizes_at(variant, fit.point)
        drop = cost_without(variant, fit.point, linear.keys, covariance)
        held, expected = drop, drop
        if parts is not None:
            held, expected = cross_validated(there, parts, variant.keys, sizes)
        alone = separated(linear, whole, variant)
        t, beyond = by_blocks(problem, linear, alone), beyond_unseen(problem, linear, alone)
        channels = touched(problem, linear, variant)
        found.append(Evidence(variant, fit.point, drop, held, expected, t, channels, beyond))
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


@dataclass(frozen=True, slots=True)
class Parts:
    """-2 log L around a linearisation: the prior's part, the whole, and that of each flight without
    the prior."""

    prior: Quadratic
    whole: Quadratic
    flights: list[Quadratic]

    @classmethod
    def of(cls, problem: Problem, linear: Linear) -> Parts:
        flights = []
        for number in sorted({s.flight for s in linear.spectra}):
            spectra = [s for s in linear.spectra if s.flight == number]
            verticals = [row for row in linear.verticals if row.flight == number]
            flights.append(quadratic(spectra, problem.noise, verticals, len(linear.keys)))
        prior = problem.with_prior(replace(linear, spectra=[], verticals=[]))
        return cls(prior, problem.with_prior(linear), flights)


def cross_validated(
    linear: Linear, parts: Parts, keys: Sequence[str], sizes: Array
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
    prior, whole = parts.prior, parts.whole
    held = expected = 0.0
    for one in parts.flights:
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


def separated(linear: Linear, whole: Quadratic, variant: Variant) -> Array:
    """Weights (p,) of the columns of a joint fit that make an effect one column, whose coefficient
    is 1, without what the other unknowns can imitate of it. whole: -2 log L around it."""
    own = linear.place(variant.sizes)
    rest = [i for i, key in enumerate(linear.keys) if key not in variant.keys]
    sizes = sizes_at(variant, linear.point)
    weights = np.zeros(len(linear.keys))
    weights[own] = sizes
    normal = whole.normal
    weights[rest] = -inverse(normal[np.ix_(rest, rest)]) @ (normal[np.ix_(rest, own)] @ sizes)
    return weights


def by_blocks(problem: Problem, linear: Linear, weights: Array) -> float:
    """t of a whole effect (``separated``) from scores by blocks of time."""
    information, variance = 0.0, 0.0
    scores: dict[int, list[Array]] = {}
    for s in linear.spectra:
        if not len(s.place):
            continue
        column = weights[s.place] @ s.columns
        scale = s.weight / problem.noise[s.channel].at(s.hz)
        information += float((scale * column**2).sum())
        scores.setdefault(s.flight, []).append(_block_scores(s, column, problem.noise[s.channel]))
    for pieces in scores.values():
        blocks = min(len(p) for p in pieces)
        summed = np.sum([p[:blocks] for p in pieces], axis=0)
        variance += float((summed**2).sum())
    if information <= 0.0:
        return 0.0
    # Scores have mean zero at the optimum: their sum of squares is the variance of their sum.
    return information / max(variance, information) ** 0.5


def beyond_unseen(problem: Problem, linear: Linear, weights: Array) -> float:
    """``Evidence.beyond``: summed over flights, channels and bands."""
    unseen = [0.0 if f.rotor_measured else unseen_delay_s(f.run) for f in problem.flights]
    if not any(unseen):
        return math.inf
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


def _block_scores(s: Spectrum, column: Array, noise: Noise) -> Array:
    """Scores of whitened rows, summed over blocks of a second."""
    rows = white_rows(s, noise, column) * white_rows(s, noise, s.residual)
    rows *= 0.5 * float(s.weight.sum())
    step = 1.0 / (2.0 * s.hz[-1])
    block = max(1, round(BLOCK_S / step))
    count = len(rows) // block
    return rows[: count * block].reshape(count, block).sum(axis=1)


# What no effect explains: whether residuals are structured, where, and what they go with.
#
# Two tests, because each is blind to what the other sees. A scan regresses every channel's residual
# on generic signals (rates, their products, rotor sums, velocity, tilt); a resonance or a push from
# outside goes with none of them, but rises above the smooth spectrum of coloured noise.


SCAN_DROP = 45.0
"""Drop of -2 log L from which a generic signal counts: 6.7 standard deviations."""
FINE_HZ = 0.25
BASELINE_SHARE, BASELINE_HZ = 0.35, 4.0
"""The smooth spectrum is a running median over this share of the frequency, or this far."""
EXCESS, FAR = 1.7, 5.8
"""Rises count from this ratio and this many standard deviations: 1 in 10^8 each."""

VELOCITY_DOUBT, LEANING_DOUBT, HEIGHT_DOUBT = 0.015, 0.1, 0.15
"""Shares of the power of what goes with velocity or height that reckoning them costs, beside what
the leak of a velocity takes; the most that was seen against the stand-in's truth."""
APART_HZ, APART_SHARE = 1.0, 0.02
"""Frequencies nearer to each other are one."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A generic signal that shows in a channel: drop of -2 log L."""

    channel: int
    words: str
    drop: float


def leftover(problem: Problem, fit: Fit) -> Leftover:
    """Judge what a fit leaves."""
    signals = [s for s in scan(problem, fit) if s.drop > SCAN_DROP]
    known = problem.frame.unknowns
    sizes = [key for key in fit.keys if key in known and known[key].parameter.kind == "size"]
    reckoned = [key for key in sizes if known[key].effect.unmeasured]
    linear = problem.linear(fit.point, reckoned, problem.flights)
    peaks = rises(linear, [excused(s, linear, problem.frame) for s in linear.spectra])
    if not signals and not peaks:
        return Leftover()
    by_channel: dict[int, float] = {}
    for signal in signals:
        by_channel[signal.channel] = max(by_channel.get(signal.channel, 0.0), signal.drop)
    for channel, _, ratio, freedom in peaks:
        gained = freedom * (ratio - 1.0 - np.log(ratio))
        by_channel[channel] = max(by_channel.get(channel, 0.0), gained)
    worst = max(by_channel, key=lambda c: by_channel[c])
    mine = sorted((p for p in peaks if p[0] == worst), key=lambda p: -p[2])
    best = max((s for s in signals if s.channel == worst), key=lambda s: s.drop, default=None)
    words = best.words if best is not None else ""
    period = problem.flights[0].period_s
    rotors = [spin_rotors(f, fit.point, problem.frame).end[f.rows] for f in problem.flights]
    rotor_hz = float(np.mean([speeds.mean() for speeds in rotors]))
    # Vibration is told by its fold at the sample rate.
    fold = abs(rotor_hz - round(rotor_hz * period) / period)
    if mine and abs(mine[0][1] - fold) < 0.08 * rotor_hz:
        words = words or "the rotors' speed, folded at the sample rate: a propeller out of balance"
    elif mine and not words:
        words = "an oscillation that no recorded signal goes with"
    return Leftover(
        CHANNELS[worst],
        tuple(round(hz, 2) for hz in _apart([p[1] for p in mine])[:5]),
        words,
        max((p[2] for p in mine), default=1.0),
    )


def scan(problem: Problem, fit: Fit) -> list[Signal]:
    """Every generic signal against every channel's residual, best first.

    What the fitted unknowns can imitate is taken out by fitting them along, channel by channel.
    """
    linear, names = _with_signals(problem, fit, problem.flights)
    found, known = [], len(fit.keys)
    for channel in sorted({s.channel for s in linear.spectra}):
        own = [s for s in linear.spectra if s.channel == channel]
        normal, gradient = _sums(problem, own, known + len(names))
        # A little of the diagonal, for unknowns that one channel alone does not show.
        diagonal = np.diag(normal)[:known]
        little = np.where(diagonal > 0, 1e-9 * diagonal, 1.0)
        inner = inverse(normal[:known, :known] + np.diag(little))
        cross = normal[known:, :known]
        left = np.diag(normal)[known:] - np.einsum("ij,jk,ik->i", cross, inner, cross)
        slope = gradient[known:] - cross @ (inner @ gradient[:known])
        alive = left > 1e-6 * np.maximum(np.diag(normal)[known:], 1e-300)
        drops = np.where(alive, slope**2 / np.where(alive, left, 1.0), 0.0)
        found += [Signal(channel, *one) for one in zip(names, drops.tolist(), strict=True)]
    return sorted(found, key=lambda s: -s.drop)


def excused(spectrum: Spectrum, linear: Linear, frame: Frame) -> Array:
    """Power (2 m,) that effects of velocity and height leave when they are exactly right.

    Neither is measured. A leaky integral of velocity lacks (1 + 1/(j w T))^2 - 1 of the true one
    at low frequency; an attitude that leans costs more than one that does not.
    """
    acting = frame.acting(linear.point).values()
    leaning = any(one.effect.stage == "attitude" and one.law()[0] > 0.0 for one in acting)
    leak, doubt = (LEANING_LEAK_S, LEANING_DOUBT) if leaning else (LEAK_S, VELOCITY_DOUBT)
    slow = 2.0 * (2.0 / (leak * 2.0 * np.pi * np.maximum(spectrum.hz, 1e-3))) ** 2
    share = {"velocity": np.minimum(slow + doubt, 1.0), "height": np.full_like(slow, HEIGHT_DOUBT)}
    power = np.zeros(len(spectrum.hz))
    for place, column in zip(spectrum.place, spectrum.columns, strict=True):
        one = frame.unknowns[linear.keys[place]]
        size = (linear.point[one.key] - one.absent) * column
        for what in one.effect.unmeasured:
            power += share[what] * size**2
    return power


def _apart(hz: Sequence[float]) -> list[float]:
    """Frequencies, strongest first, without those that are near a stronger one."""
    kept: list[float] = []
    for one in hz:
        if all(abs(one - other) > max(APART_HZ, APART_SHARE * other) for other in kept):
            kept.append(one)
    return kept


def rises(linear: Linear, known: Sequence[Array]) -> list[tuple[int, float, float, float]]:
    """(channel, Hz, power over that of smooth coloured noise, degrees of freedom) of what rises
    above it. known: power (2 m,) of each spectrum that is no surprise beside the noise."""
    found = []
    for channel in sorted({s.channel for s in linear.spectra}):
        own = [(s, k) for s, k in zip(linear.spectra, known, strict=True) if s.channel == channel]
        top = max(s.hz.max() for s, _ in own)
        edges = np.arange(0.0, top + FINE_HZ, FINE_HZ)
        power, excuse, freedom = np.zeros((3, len(edges) - 1))
        for s, expected in own:
            band = np.minimum((s.hz / FINE_HZ).astype(np.int64), len(power) - 1)
            power += np.bincount(band, s.weight * s.residual**2, len(power))
            excuse += np.bincount(band, s.weight * expected, len(power))
            freedom += 0.5 * np.bincount(band, s.weight, len(power))
        middle = edges[:-1] + 0.5 * FINE_HZ
        full = freedom > 0.5 * np.median(freedom)
        middle, level = middle[full], (power / np.maximum(freedom, 1e-9))[full]
        beside = (excuse / np.maximum(freedom, 1e-9))[full]
        count = float(np.median(freedom))
        # The median of chi-squared and its far quantile, over its mean (Wilson and Hilferty).
        step = 2.0 / (9.0 * count)
        limit = max(EXCESS, float((1.0 - step + FAR * np.sqrt(step)) ** 3))
        reach = np.maximum(BASELINE_SHARE * middle, BASELINE_HZ)
        first = np.searchsorted(middle, middle - reach)
        last = np.searchsorted(middle, middle + reach)
        for i in range(len(level)):
            smooth = median_of(level[first[i] : last[i]]) / (1.0 - step) ** 3
            ratio = float(level[i] / (smooth + beside[i]))
            if ratio > limit:
                found.append((channel, float(middle[i]), ratio, count))
    return found


def median_of(values: Array) -> float:
    """numpy's, for finite values, at a third of its time on a few hundred."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1].tolist()
    return float(0.5 * (low + high))


def _with_signals(
    problem: Problem, fit: Fit, flights: Sequence[Flight]
) -> tuple[Linear, list[str]]:
    """The fit's linearisation with the generic signals as more columns of every channel."""
    linear = problem.linear(fit.point, fit.keys, flights)
    words: list[str] = []
    wider: list[Spectrum] = []
    for number, flight in enumerate(flights):
        signals = generic_signals(flight, problem.frame, fit.point)
        words = list(signals)
        places = np.arange(len(fit.keys), len(fit.keys) + len(words))
        for s in linear.spectra:
            if s.flight == number:
                columns = transform_channel(signals, s.channel, flight)
                columns = columns / problem.root(flight, s.channel, s.hz)
                columns = beside_lasting(s, columns, problem.noise[s.channel])
                wider.append(
                    replace(
                        s,
                        columns=np.concatenate([s.columns, columns]),
                        place=np.concatenate([s.place, places]),
                    )
                )
    return replace(linear, spectra=wider), words


def _sums(problem: Problem, spectra: Sequence[Spectrum], count: int) -> tuple[Array, Array]:
    normal, gradient = np.zeros((count, count)), np.zeros(count)
    for s in spectra:
        root = np.sqrt(s.weight / problem.noise[s.channel].at(s.hz))
        white = s.columns * root
        normal[np.ix_(s.place, s.place)] += white @ white.T
        gradient[s.place] += white @ (s.residual * root)
    return normal, gradient
