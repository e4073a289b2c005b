"""Every effect at once: what each would explain at one point.

One Gram matrix of all columns holds what any subset of the effects, fitted jointly, would take
off -2 log L, to first order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.effect import Key
from groundstation.identification.estimate import inverse
from groundstation.identification.likelihood.motion import BODY_KEYS, KEYS, Point, Variant, absent
from groundstation.identification.likelihood.problem import BASE_KEYS, Problem, bounded
from groundstation.identification.likelihood.spectra import Quadratic
from groundstation.telemetry.arrays import Array

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

    def best(self) -> Array:
        """The change (p,) of every unknown to the joint optimum."""
        return inverse(self.total.normal) @ self.total.gradient

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
    found = []
    for variant in variants:
        shape = variant.tried
        if shape is None:
            continue
        probes = [_probe(variant, shape, number) for number in shape.parameter.tried]
        wide = copy(problem)
        wide.frame = replace(problem.frame, own=(*problem.frame.own, *probes))
        sizes = (key for one in probes for key in one.sizes)
        linear = wide.linear(point, (*keys, *sizes), problem.flights)
        seen = Screening(linear.point, linear.keys, wide.with_prior(linear))
        found.append(
            [
                (replace(seen.scores(keys, [one])[0], variant=variant), {shape.key: key.absent})
                for one in probes
                if (key := one.tried)
            ]
        )
    return found


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
