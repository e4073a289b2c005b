"""The covariance of a Kalman filter that has settled, by doubling.

A row takes the covariance P of an error to h + f P (1 + g P)^-1 f^T. Rows after each other are such
a map again, so that 2^k rows take k steps (Anderson and Moore, Optimal Filtering, 1979, section
6.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.telemetry.arrays import Array

DOUBLINGS = 13
"""16 s of rows at 500 Hz: three times that in which a velocity that nothing measures settles."""


@dataclass(frozen=True, slots=True)
class Row:
    """What a filter does in a row: the model moves the error on, and m numbers are measured.

    transition: (e, e). process: (e,) variances that come anew. seen: (m, e), what is measured of
    the error. sensor: (m,) variances of that.
    """

    transition: Array
    process: Array
    seen: Array
    sensor: Array

    def corrected(self, before: Array) -> tuple[Array, Array]:
        """The gain (e, m), and the covariance (e, e) after the row, of the one before it."""
        p = self.transition @ before @ self.transition.T + np.diag(self.process)
        cross = self.seen @ p
        gain = np.linalg.solve(cross @ self.seen.T + np.diag(self.sensor), cross).T
        p = p - gain @ cross
        return np.asarray(gain, np.float64), 0.5 * (p + p.T)


@dataclass(frozen=True, slots=True)
class _Map:
    """Each (e, e)."""

    f: Array
    g: Array
    h: Array

    def then(self, other: _Map) -> _Map:
        size = len(self.f)
        both = np.concatenate([self.f, self.h], axis=1)
        through = np.linalg.solve(np.eye(size) + self.h @ other.g, both)
        f, h = through[:, :size], through[:, size:]
        g = self.g + self.f.T @ other.g @ f
        h = other.h + other.f @ h @ other.f.T
        return _Map(other.f @ f, 0.5 * (g + g.T), 0.5 * (h + h.T))

    def of(self, p: Array) -> Array:
        found = self.h + self.f @ np.linalg.solve(np.eye(len(p)) + p @ self.g, p) @ self.f.T
        return 0.5 * (found + found.T)


def settled(rows: Sequence[Row], start: Array) -> Array:
    """The covariance (e, e) before the first of rows that have repeated many times.

    start: (e, e), that before the very first.
    """
    every = _map_of(rows[0])
    for row in rows[1:]:
        every = every.then(_map_of(row))
    for _ in range(DOUBLINGS - 1):
        every = every.then(every)
    return every.of(start)


def _map_of(row: Row) -> _Map:
    size = len(row.transition)
    moved = _Map(row.transition, np.zeros((size, size)), np.diag(row.process))
    information = row.seen.T @ (row.seen / row.sensor[:, None])
    return moved.then(_Map(np.eye(size), information, np.zeros((size, size))))
