"""A craft that knows its place, stopped and brought back between manoeuvres.

Velocities are what hover setpoints take: ahead and to the left, in the heading's frame.
"""

from __future__ import annotations

import math
from collections import deque

from groundstation.control.flight_watch import Seen

STANDS_M_S = 0.1
"""Slower than this a craft stands still in the air."""
BACK_M_S, BACK_PER_S, NEAR_M = 0.3, 1.0, 0.15
"""It goes back so fast at most, and slower the nearer it is; so near it is there."""
HOLD_MOST_S = 8.0
"""A craft that has not come back by then stays where it is."""
REST_S = 0.5
AHEAD_S = 0.5
"""A craft brakes from 1 m/s within so much of a second's way."""
TRIM_S, FIRST_REST_S = 1.0, 3.0
"""How long the lean of hover is averaged at most; how long it hovers after take-off, for its
estimator learns in flight how its sensors are turned."""


class Holding:
    """From a craft that moves to one that hovers at its place.

    home: where that is. rest_s: how long it hovers there in the end.
    """

    def __init__(self, home: tuple[float, float], now_s: float, rest_s: float = REST_S) -> None:
        self._home, self._rest_s = home, rest_s
        self._until_s = now_s + HOLD_MOST_S
        self._stopped = self._is_back = False
        self._rests_s = math.inf

    @property
    def rests(self) -> bool:
        """Whether it hovers at its place, as it was asked to last."""
        return math.isfinite(self._rests_s)

    def velocity(self, now_s: float, seen: Seen) -> tuple[float, float] | None:
        """What to ask for now, m/s; None: it hovers at its place."""
        slow, late = seen.speed_m_s < STANDS_M_S, now_s >= self._until_s
        away_m = seen.away_m(self._home)
        self._stopped |= slow
        self._is_back |= late or (self._stopped and away_m < NEAR_M)
        if self._is_back:
            self._rests_s = min(self._rests_s, now_s) if slow or late else math.inf
            return None if now_s - self._rests_s >= self._rest_s else (0.0, 0.0)
        if not self._stopped:
            return 0.0, 0.0
        speed = min(BACK_M_S, BACK_PER_S * away_m) / away_m
        ahead, aside = (self._home[0] - seen.x_m) * speed, (self._home[1] - seen.y_m) * speed
        cos, sin = math.cos(seen.heading_rad), math.sin(seen.heading_rad)
        return cos * ahead + sin * aside, cos * aside - sin * ahead


class Hover:
    """What a craft that hovers shows, over the last ``TRIM_S``: lean and thrust."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, Seen]] = deque()

    def add(self, now_s: float, seen: Seen) -> None:
        self._seen.append((now_s, seen))
        while now_s - self._seen[0][0] > TRIM_S:
            self._seen.popleft()

    @property
    def trim_deg(self) -> tuple[float, float]:
        """Mean roll and pitch: what the craft calls the attitude in which it stays."""
        return self._mean("roll_deg"), self._mean("pitch_deg")

    @property
    def thrust(self) -> float:
        """Mean of ``Seen.thrust``."""
        return self._mean("thrust")

    def _mean(self, name: str) -> float:
        return sum(getattr(seen, name) for _, seen in self._seen) / len(self._seen)
