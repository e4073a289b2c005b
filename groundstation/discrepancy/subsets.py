"""The subset of effects with the least penalised -2 log L, on one Gram matrix."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np

from groundstation.discrepancy.acceptance import DROP_PER_PARAMETER, LEAST_DROP, plausible
from groundstation.discrepancy.screening import UNDETERMINED
from groundstation.identification.likelihood.motion import Point, Variant, absent
from groundstation.telemetry.arrays import Array

RIDGE = 1e-9
"""Share of a column's power that is added to it: two that are alike have an inverse."""
MOST_MOVES = 60


class Subsets:
    """Subsets of variants beside a base that is always there, under one likelihood.

    normal: (p, p), gradient: (p,), the base's columns first, then the variants' sizes in their
    order, as seen from where all variants are absent. A subset is worth what it takes off -2 log L
    less a price for each variant, that of joining a search (``LEAST_DROP``).
    """

    def __init__(
        self, variants: Sequence[Variant], point: Point, normal: Array, gradient: Array
    ) -> None:
        """point: with the shapes of the variants."""
        self._variants, self._point = variants, point
        self._scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        self._normal = normal * np.outer(self._scale, self._scale) + RIDGE * np.eye(len(gradient))
        self._gradient = gradient * self._scale
        count = np.array([len(one.sizes) for one in variants])
        base = len(gradient) - int(count.sum())
        self._base = list(range(base))
        ends = np.cumsum([base, *count]).tolist()
        self._own = [list(range(a, b)) for a, b in pairwise(ends)]
        self._price = LEAST_DROP + DROP_PER_PARAMETER * (count - 1.0)
        self._alone, self._several = np.flatnonzero(count == 1), np.flatnonzero(count > 1).tolist()
        self._at = np.array(ends[:-1])[self._alone]

    def best(self, start: frozenset[int]) -> frozenset[int]:
        """The best that adding, dropping and exchanging reach, from ``start`` and from nothing."""
        ends = (self._settled(start), self._settled(frozenset()))
        return max(ends, key=self.worth)

    def worth(self, chosen: Collection[int]) -> float:
        """Of a subset."""
        at = self._places(chosen)
        own = self._gradient[at]
        taken = float(own @ np.linalg.solve(self._normal[np.ix_(at, at)], own))
        return taken - float(self._price[list(chosen)].sum())

    def beside(self, chosen: Collection[int]) -> Array:
        """What each variant (v,) is worth as one more; -inf for those that are of the same effect
        as one of ``chosen``, or of a size or sign that no craft has."""
        worth, sizes = self._joining(chosen)
        for n in np.flatnonzero(np.isfinite(worth)).tolist():
            if not self._possible(n, sizes[n]):
                worth[n] = -np.inf
        return worth

    def _settled(self, chosen: frozenset[int]) -> frozenset[int]:
        for _ in range(MOST_MOVES):
            gain, more = self._addition(chosen)
            if gain <= 0.0:
                now = self.worth(chosen)
                rests = [(self.worth(chosen - {one}) - now, chosen - {one}) for one in chosen]
                gain, more = max(rests, default=(0.0, chosen), key=lambda option: option[0])
                if gain <= 0.0:
                    joined = ((loss, *self._addition(rest)) for loss, rest in rests)
                    options = [(loss + gain, other) for loss, gain, other in joined]
                    gain, more = max(options, default=(0.0, chosen), key=lambda option: option[0])
            if gain <= 1e-6:
                break
            chosen = more
        return chosen

    def _addition(self, chosen: frozenset[int]) -> tuple[float, frozenset[int]]:
        """(what the variant that is worth most adds, the subset with it)."""
        worth, sizes = self._joining(chosen)
        for n in np.argsort(-worth).tolist():
            if not np.isfinite(worth[n]):
                break
            if worth[n] <= 0.0 or self._possible(n, sizes[n]):
                return float(worth[n]), chosen | {n}
        return -np.inf, chosen

    def _joining(self, chosen: Collection[int]) -> tuple[Array, dict[int, Array]]:
        """(what each variant (v,) is worth beside these, whatever its size; these sizes)."""
        at = self._places(chosen)
        cross = self._normal[:, at]
        imitated = np.linalg.solve(self._normal[np.ix_(at, at)], cross.T).T
        slope = self._gradient - imitated @ self._gradient[at]
        own = np.diag(self._normal)[self._at]
        left = own - np.einsum("ij,ij->i", imitated[self._at], cross[self._at])
        left = np.where(left > UNDETERMINED * own, left, np.inf)
        worth = np.empty(len(self._variants))
        worth[self._alone] = slope[self._at] ** 2 / left
        sizes = dict(zip(self._alone.tolist(), (slope[self._at] / left)[:, None], strict=True))
        for n in self._several:
            mine = self._own[n]
            inner = self._normal[np.ix_(mine, mine)] - imitated[mine] @ cross[mine].T
            sizes[n] = np.linalg.solve(inner + RIDGE * np.eye(len(mine)), slope[mine])
            worth[n] = slope[mine] @ sizes[n]
        taken = {self._variants[n].effect for n in chosen}
        out = [n for n, one in enumerate(self._variants) if one.effect in taken]
        worth -= self._price
        worth[out] = -np.inf
        return worth, sizes

    def _places(self, chosen: Collection[int]) -> list[int]:
        return [*self._base, *(place for one in sorted(chosen) for place in self._own[one])]

    def _possible(self, n: int, size: Array) -> bool:
        one = self._variants[n]
        counted = (size * self._scale[self._own[n]]).tolist()
        sizes = {key: absent(key) + s for key, s in zip(one.sizes, counted, strict=True)}
        return plausible(one, {**self._point, **sizes})
