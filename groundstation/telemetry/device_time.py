"""Where a stamp lies in device time: the 2 ms grid, wraps, and what the host's clock allows."""

from __future__ import annotations

from groundstation.telemetry.packet import SAMPLE_TICKS, TICK_S
from groundstation.telemetry.reassembly_state import (
    MAIN_ENVELOPE,
    MAIN_GRID,
    MAIN_LAST,
    NOWHERE,
    PEND_ENVELOPE,
    PEND_GRID,
    PEND_INDEX,
    PEND_LAST,
    PENDING,
    State,
)

GRID = SAMPLE_TICKS
TICK_NS = TICK_S * 1e9
TOLERANCE = 40.0
"""Ticks off the grid that still count as on it; the real excerpt strays by up to 13."""
REORDER = 3
"""A sample is given out when one this many periods newer has arrived."""
LEAK = 200e-6
"""Rise of the envelope: the two clocks may drift apart by this fraction."""
EARLY_NS = 30e6
BACK = 64


def on_grid(offset: float) -> tuple[int, bool]:
    """Nearest grid index of an offset in ticks, and whether it is on the grid."""
    index = round(offset / GRID)
    return int(index), abs(offset - index * GRID) <= TOLERANCE


def fit_main(s: State, stamp: int, host: int) -> int:
    return _fit(int(s.n[MAIN_LAST]), s.f[MAIN_GRID], _envelope_at(s, host), stamp, host, 1 << 20)


def fit_pending(s: State, stamp: int, host: int) -> int:
    ticks = _fit(int(s.n[PEND_LAST]), s.f[PEND_GRID], s.f[PEND_ENVELOPE], stamp, host, 9)
    return NOWHERE if ticks == NOWHERE or _is_taken(s, ticks) else ticks


def _fit(last: int, grid: float, envelope: float, stamp: int, host: int, furthest: int) -> int:
    """Smallest place on a chain's grid for ``stamp``, in ticks, or NOWHERE.

    Steps back up to BACK samples, then forward; a step beyond one wrap must not be early.
    """
    ahead = (stamp - last) & 0xFFFF
    for wrap in range(-2, 1):
        ticks = last + ahead + wrap * 65536
        index, fits = on_grid(ticks - grid)
        if fits and (wrap == 0 or -BACK < index <= 0):
            return ticks
    for wrap in range(1, furthest + 1):
        ticks = last + ahead + wrap * 65536
        if host - ticks * TICK_NS < envelope - EARLY_NS:
            return NOWHERE
        if on_grid(ticks - grid)[1]:
            return ticks
    return NOWHERE


def _is_taken(s: State, ticks: int) -> bool:
    """Is a place further back than reordering reaches held by another sample already?

    A gap of a little less than 598 ms looks like a step back.
    """
    index = int(s.n[PEND_INDEX]) + on_grid(ticks - s.f[PEND_GRID])[0]
    if index >= s.n[PEND_INDEX] - REORDER:
        return False
    at = int(s.n[PENDING]) - 1
    while at >= 0 and s.place[s.pending[at]] > index:
        at -= 1
    return bool(at >= 0 and s.place[s.pending[at]] == index)


def _envelope_at(s: State, host: float) -> float:
    """The lower envelope of host time minus device time (ns), let drift up to ``host``."""
    arrived = s.n[MAIN_LAST] * TICK_NS + s.f[MAIN_ENVELOPE]
    return float(s.f[MAIN_ENVELOPE] + LEAK * max(0.0, host - arrived))


def lateness_ns(s: State, ticks: int, host: int) -> float:
    return host - ticks * TICK_NS - float(s.f[MAIN_ENVELOPE])


def expected_ticks(s: State, base: int) -> float:
    """Where the host's clock puts the pending group whose relative ticks are ``base``."""
    offset = s.f[PEND_ENVELOPE]
    return float((offset - _envelope_at(s, offset + base * TICK_NS)) / TICK_NS + base)


def silence_ns(s: State) -> float:
    """Host time between the main chain's last arrival and the pending chain's first."""
    first = s.f[PEND_ENVELOPE] + s.ticks[s.pending[0]] * TICK_NS
    return float(first - (s.n[MAIN_LAST] * TICK_NS + s.f[MAIN_ENVELOPE]))


def steps_from_main(s: State) -> float:
    """Periods from the main chain to the pending one if device time simply went on."""
    first = int(s.pending[0])
    ticks = fit_main(s, int(s.stamp[first]), int(s.host[first]))
    if ticks <= s.n[MAIN_LAST]:  # nowhere, or a step back
        return float("inf")
    return float((ticks - s.n[MAIN_LAST]) / GRID)
