"""Which rows hold a new attitude: firmware computes it every few rows and repeats it in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array

Mask = NDArray[np.bool_]

LONGEST = 20
"""Rows from one attitude to the next: 25 Hz at 500 rows a second."""
ON, OFF = 0.2, 0.25
"""A rhythm is one where the comb's rows are new in more than this share (a resting craft repeats
its angles), and the others in less than this share of that."""


@dataclass(frozen=True, slots=True)
class Rhythm:
    """New values come ``stride`` rows apart, the first in row ``phase``.

    regular: whether rows beside the comb hold none; otherwise the comb is the best there is.
    """

    stride: int
    phase: int
    regular: bool

    def rows(self, count: int) -> NDArray[np.int64]:
        """The comb's rows among ``count``."""
        return np.arange(self.phase, count, self.stride, dtype=np.int64)


EVERY_ROW = Rhythm(1, 0, regular=True)


def rhythm_of(changed: Mask) -> Rhythm:
    """The comb that most of the changed rows (n,) lie on."""
    rows = np.flatnonzero(changed)
    if len(rows) < 2:
        return EVERY_ROW
    stride = int(np.clip(np.rint(np.median(np.diff(rows))), 1, LONGEST))
    if stride == 1:
        return EVERY_ROW
    phase = int(np.bincount(rows % stride, minlength=stride).argmax())
    comb = np.zeros(len(changed), np.bool_)
    comb[phase::stride] = True
    on, off = float(changed[comb].mean()), float(changed[~comb].mean())
    return Rhythm(stride, phase, regular=on > ON and off < OFF * on)


def changed_rows(attitude: Array) -> Mask:
    """Rows whose angles (n, 3) differ from those of the row before; across a lost row (NaN) that
    tells nothing."""
    known = np.asarray(np.isfinite(attitude).all(axis=1))
    found = np.zeros(len(attitude), np.bool_)
    differs = (attitude[1:] != attitude[:-1]).any(axis=1)
    found[1:] = differs & known[1:] & known[:-1]
    return found


def fresh_rhythm(attitude: Array) -> Rhythm:
    """The rhythm of angles (n, 3) whose held values are repeated, or left out (NaN).

    Where they tell none, every row counts as new.
    """
    for told in (changed_rows(attitude), np.asarray(np.isfinite(attitude).all(axis=1))):
        rhythm = rhythm_of(told)
        if rhythm.stride > 1 and rhythm.regular:
            return rhythm
    return EVERY_ROW


def fresh_rows(attitude: Array) -> Mask:
    """Rows (n,) in which the attitude (n, 3) was computed anew."""
    fresh = np.zeros(len(attitude), np.bool_)
    fresh[fresh_rhythm(attitude).rows(len(attitude))] = True
    return fresh
