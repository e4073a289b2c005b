"""How long a battery lasts, from how those before it went: voltage while flying, curve by curve.

A cell's voltage says little by itself: it sags with the load, stays nearly level for minutes and
then falls at once, differently for every craft. How long this craft flew before from the same
voltage until it was low is an estimate that needs no model of the cell; without a battery that was
flown until it was low there is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.samples import SampleBatch

LOW_V = 3.3
"""Loaded voltage of one lithium-polymer cell from which on one lands."""
WINDOW_S = 5.0
"""Of flying, averaged over: manoeuvres pull the voltage down for moments."""
FLYING_DUTY = 0.1
GAP_S = 0.1
"""Rows further apart are not joined: nobody knows what was flown between them."""
RISE_V, RESTART_RISE_V = 0.15, 0.05
"""By how much the voltage rises when another battery is in, without and with a restart of the
craft; a cell that has rested recovers by less."""
SPREAD_V = 0.02
"""By which windows of the same charge differ."""
FULLER_V = 0.1
"""A battery that much fuller than another ever was is not judged by it."""
_SMOOTHED = 3


class Discharge:
    """The battery that flies at present. volts: means of ``WINDOW_S`` of flying each."""

    def __init__(self) -> None:
        self.volts: list[float] = []
        self.flown_s = 0.0
        self._sum = self._weight = 0.0
        self._before: tuple[int, float] | None = None  # segment and time of the last flying row
        self._segment: int | None = None  # of the last window

    @property
    def is_low(self) -> bool:
        """Whether it has been flown until it was low."""
        return len(self.volts) >= _SMOOTHED and float(_falling(self.volts)[-1]) <= LOW_V

    def feed(self, batch: SampleBatch) -> bool:
        """Take rows; whether another battery is in since."""
        flying = (batch.duty.max(axis=1, initial=0.0) > FLYING_DUTY) & np.isfinite(batch.battery_v)
        changed = False
        rows = zip(
            batch.segment[flying].tolist(),
            batch.time_s[flying].tolist(),
            batch.battery_v[flying].tolist(),
            strict=True,
        )
        for segment, time_s, volts in rows:
            before, self._before = self._before, (segment, time_s)
            if before is None or before[0] != segment or not 0 < time_s - before[1] <= GAP_S:
                continue
            step_s = time_s - before[1]
            self._sum += volts * step_s
            self._weight += step_s
            self.flown_s += step_s
            if self._weight >= WINDOW_S:
                changed |= self._close_window(segment)
        return changed

    def _close_window(self, segment: int) -> bool:
        mean, weight = self._sum / self._weight, self._weight
        self._sum = self._weight = 0.0
        rise_v = RISE_V if segment == self._segment else RESTART_RISE_V
        self._segment = segment
        changed = bool(self.volts) and mean > min(self.volts[-_SMOOTHED:]) + rise_v
        if changed:
            self.volts.clear()
            self.flown_s = weight
        self.volts.append(mean)
        return changed


def left_s(
    volts: Sequence[float], earlier: Iterable[Sequence[float]]
) -> tuple[float, float] | None:
    """Least and most time of flying, s, until a battery is low, as those before it went.

    volts: of ``Discharge``. earlier: the same of batteries that were flown until they were low.
    None where none of them tells.
    """
    if len(volts) < _SMOOTHED:
        return None
    now_v = float(_falling(volts)[-1])
    found: list[float] = []
    for one in earlier:
        curve = _falling(one)
        if len(curve) and now_v <= curve[0] + FULLER_V:
            for level in (now_v - SPREAD_V, now_v + SPREAD_V):
                reached = int(np.argmax(curve <= max(level, float(curve[-1]))))
                found.append((len(curve) - 1 - reached) * WINDOW_S)
    return (min(found), max(found)) if found else None


def _falling(volts: Sequence[float]) -> NDArray[np.float64]:
    """Medians of three, each no higher than the one before; shorter by two."""
    values = np.asarray(volts, np.float64)
    if len(values) < _SMOOTHED:
        return np.empty(0)
    pieces = np.lib.stride_tricks.sliding_window_view(values, _SMOOTHED)
    return np.asarray(np.minimum.accumulate(np.median(pieces, axis=1)))
