"""What each name carries: how much worse fitted samples are predicted where it is left out and all
other numbers stay."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from groundstation.discrepancy.proof import LEAST_SHARE, LEFT
from groundstation.telemetry.arrays import Array


@dataclass(frozen=True, slots=True)
class Weight:
    """share: of the given model's squared excess over noise, by what a name takes off; stderr: of
    it, from the spread of seconds. most: of what a channel that it touches is left with without it,
    the share that it takes, the largest over channels."""

    share: float
    stderr: float
    most: float

    @property
    def is_carried(self) -> bool:
        """Whether it takes enough off, and the gap is no smaller without it."""
        return self.share > 0.0 and self.most >= LEAST_SHARE

    @property
    def raises(self) -> bool:
        """Whether the gap is smaller without it by more than seconds scatter."""
        return self.share < -self.stderr


def weight(given_gap: float, now: Array, left: Array, channels: Collection[int]) -> Weight | None:
    """Of one name; None where nothing is left to explain in any channel that it touches.

    now, left: what each second adds to the squared gap with it and without, by channel (s, 9), NaN
    for one that is not there. channels: that it touches.
    """
    count = int(np.isfinite(now).any(axis=0).sum())
    with_it, without = (count * np.nansum(one, axis=0)[list(channels)] for one in (now, left))
    if not (np.maximum(with_it, without) > LEFT**2).any():
        return None
    beyond = without > LEFT**2
    most = np.max((without - with_it)[beyond] / (without[beyond] - 1.0), initial=0.0)
    seconds = np.nansum(left - now, axis=1)
    excess = max(given_gap**2, LEFT**2) - 1.0
    spread = float(seconds.std()) * len(seconds) ** 0.5
    return Weight(float(seconds.sum()) / excess, spread / excess, float(most))
