"""How a craft that holds its height is brought down: level, slowly, motors off at the ground. Pure,
on the clock of whoever uses it."""

from __future__ import annotations

from collections import deque

SINK_M_S = 0.3
"""A craft that meets the ground so fast stays upright; its propellers stay whole."""
LONGEST_S, GROUND_S = 6.0, 0.7
"""The whole landing, at most; how long no height is asked for before it is over at the latest."""
SLOW_M = 0.6
"""From so high on it sinks at ``SINK_M_S``, however high it began."""
FLOOR_M = 0.02
"""A craft that says it is lower than this stands: it falls the rest, and meets the floor with
0.5 m/s; from 5 cm it is 0.8 m/s. Where its sensor says more on the floor, the time ends it."""
CLIMBS_M_S, NEAR_M = 0.1, 0.05
"""One that is as low and climbs has just left the floor: cut there, it would fall from 20 cm. One
that is higher than the second and still moves is not down, whatever was asked for."""
BELOW_M, STANDS_S, STILL_M = 0.25, 0.6, 0.02
"""A craft that is asked for so much less than its height, and for so long has not moved by more
than this, stands on something."""
LOW_M, MET_DPS = 0.15, 150.0
"""Asked for less than this, a craft that turns so fast has met the ground: level flight never
does."""
APART_M = 0.3
"""A height that was asked for and is so far from the measured one is not where it begins."""


class Landing:
    """One landing, begun at ``now_s`` (any monotonic clock, s).

    height_m: that was asked for last; None: the measured one. measured_m: the craft's own, None
    where it does not say. over: why it is, empty while it goes on.
    """

    def __init__(
        self, now_s: float, height_m: float | None = None, measured_m: float | None = None
    ) -> None:
        known_m = 0.0 if measured_m is None else measured_m
        is_there = height_m is not None and (
            measured_m is None or abs(height_m - measured_m) <= APART_M
        )
        self.over = ""
        self._begun_s = now_s
        self._from_m = max(height_m if height_m is not None and is_there else known_m, 0.0)
        self._measured: deque[tuple[float, float]] = deque()

    def asked_m(self, now_s: float) -> float:
        """The height to ask for, m."""
        time_s, high_m = max(now_s - self._begun_s, 0.0), self._from_m
        slow_m = min(high_m, SLOW_M)
        left_s = LONGEST_S - GROUND_S - slow_m / SINK_M_S
        fast_s = min(left_s, (high_m - slow_m) / SINK_M_S)
        if time_s < fast_s:
            return high_m - (high_m - slow_m) * time_s / fast_s
        return max(slow_m - SINK_M_S * (time_s - fast_s), 0.0)

    def tick(
        self,
        now_s: float,
        measured_m: float | None = None,
        turns_dps: float | None = None,
        climb_m_s: float | None = None,
    ) -> float | None:
        """The height to ask for now, m, or None: it is over, and the motors are to stop.

        measured_m: the craft's own height. turns_dps: its fastest rate about any axis. climb_m_s:
        upwards. None where it does not say.
        """
        asked_m = self.asked_m(now_s)
        climbs = climb_m_s is not None and climb_m_s > CLIMBS_M_S
        self.over = self.over or self._ended(now_s, asked_m, measured_m, turns_dps, climbs)
        return None if self.over else asked_m

    def _ended(
        self,
        now_s: float,
        asked_m: float,
        measured_m: float | None,
        turns_dps: float | None,
        climbs: bool,
    ) -> str:
        still = measured_m is not None and self._is_still(now_s, measured_m)
        down_s = now_s - self._begun_s
        if measured_m is not None:
            if measured_m <= FLOOR_M and not climbs:
                return "it is on the floor"
            if asked_m <= measured_m - BELOW_M and still:
                return "it stands on something"
        if turns_dps is not None and turns_dps > MET_DPS and asked_m <= LOW_M:
            return "it has met the ground"
        sinks = measured_m is not None and measured_m > NEAR_M and not still
        is_down = down_s >= GROUND_S and self.asked_m(now_s - GROUND_S) <= 0.0 and not sinks
        return "its time is up" if is_down or down_s >= LONGEST_S else ""

    def _is_still(self, now_s: float, measured_m: float) -> bool:
        """Whether the height has not moved for ``STANDS_S``."""
        kept = self._measured
        kept.append((now_s, measured_m))
        while len(kept) > 1 and kept[1][0] <= now_s - STANDS_S:
            kept.popleft()
        heights = [height_m for _, height_m in kept]
        return kept[0][0] <= now_s - STANDS_S and max(heights) - min(heights) <= STILL_M
