"""Groups whose time is not certain yet, and orphans: those that fit nowhere."""

from __future__ import annotations

from groundstation.telemetry.copies import (
    break_group,
    insert,
)
from groundstation.telemetry.device_time import (
    BACK,
    GRID,
    TICK_NS,
    fit_main,
    fit_pending,
    on_grid,
)
from groundstation.telemetry.reassembly_state import (
    EVIDENCE,
    FLOOR_HOST,
    FLOOR_TICKS,
    MAIN_ENVELOPE,
    MAIN_SINCE,
    MISSES,
    MODE,
    NONE,
    NOWHERE,
    ORPHAN_AGE,
    ORPHANS,
    PEND_ENVELOPE,
    PEND_FLOOR,
    PEND_GRID,
    PEND_HOST,
    PEND_INDEX,
    PEND_LAST,
    PENDING,
    State,
)

ON_TIME_NS = 60e6
SETTLE_NS = 250e6
FLOOR_NS = 20e6
"""Lateness this close to the lowest one counts as having returned to it."""
FLOOR_VISITS = 4


def start_pending(s: State, slot: int, mode: int) -> None:
    n, f = s.n, s.f
    host = float(s.host[slot])
    n[PENDING] = 1
    n[MODE] = mode
    n[MISSES] = 0
    n[MAIN_SINCE] = 0
    s.pending[0] = slot
    s.ticks[slot] = s.stamp[slot]
    s.place[slot] = 0
    n[PEND_LAST] = s.stamp[slot]
    n[PEND_INDEX] = 0
    f[PEND_GRID] = float(s.stamp[slot])
    f[PEND_ENVELOPE] = host - s.stamp[slot] * TICK_NS
    f[PEND_HOST] = host
    f[PEND_FLOOR] = f[PEND_ENVELOPE]
    f[FLOOR_TICKS] = f[PEND_GRID]
    f[FLOOR_HOST] = host
    n[EVIDENCE] = 0


def join_pending(s: State, slot: int, ticks: int) -> None:
    """Add a group that fits the pending chain; a second group at one place is a copy of it."""
    n, f = s.n, s.f
    host = float(s.host[slot])
    index = int(n[PEND_INDEX]) + on_grid(ticks - f[PEND_GRID])[0]
    n[MISSES] = 0
    offset = host - ticks * TICK_NS
    if host - f[PEND_HOST] > SETTLE_NS:
        # nothing came for long: if that was a silence, how late things were before says nothing
        f[PEND_ENVELOPE] = offset
        f[PEND_FLOOR] = offset + 2 * FLOOR_NS
    f[PEND_HOST] = max(f[PEND_HOST], host)
    f[PEND_ENVELOPE] = min(f[PEND_ENVELOPE], offset)
    if offset < f[PEND_FLOOR] - FLOOR_NS:
        f[PEND_FLOOR] = offset
        f[FLOOR_TICKS] = float(ticks)
        f[FLOOR_HOST] = host
        n[EVIDENCE] = 0
    elif offset < f[PEND_FLOOR] + FLOOR_NS and host - f[FLOOR_HOST] >= FLOOR_NS:
        f[FLOOR_HOST] = host
        n[EVIDENCE] += 1
    s.ticks[slot] = ticks
    s.place[slot] = index
    if not insert(s, s.pending, int(n[PENDING]), slot):
        return
    n[PENDING] += 1
    if index > n[PEND_INDEX]:
        step = index - int(n[PEND_INDEX])
        f[PEND_GRID] += step * GRID
        f[PEND_GRID] += (ticks - f[PEND_GRID]) / 16.0
        n[PEND_INDEX] = index
        n[PEND_LAST] = ticks


def settled(s: State) -> bool:
    """Has the lateness stayed at one floor, as it does after a silence?"""
    span = (s.n[PEND_LAST] - s.f[FLOOR_TICKS]) * TICK_NS
    return bool(s.n[EVIDENCE] >= FLOOR_VISITS and span >= SETTLE_NS)


def on_time_after_all(s: State) -> bool:
    """Did the host merely lag? Then some held group is on time if device time simply went on."""
    first = int(s.pending[0])
    ticks = fit_main(s, int(s.stamp[first]), int(s.host[first]))
    if ticks == NOWHERE:
        return False
    shift = ticks - int(s.ticks[first])
    lateness = s.f[PEND_ENVELOPE] - shift * TICK_NS - s.f[MAIN_ENVELOPE]
    return bool(lateness <= ON_TIME_NS)


def adopt_orphans(s: State) -> None:
    """Groups that fitted nowhere when they came may belong to the chain that came of it."""
    n, f = s.n, s.f
    kept = 0
    for k in range(int(n[ORPHANS])):
        slot = int(s.orphans[k])
        ticks = fit_pending(s, int(s.stamp[slot]), int(s.host[slot]))
        if ticks != NOWHERE and abs(on_grid(ticks - f[PEND_GRID])[0]) <= BACK:
            join_pending(s, slot, ticks)
        else:
            s.orphans[kept] = slot
            kept += 1
    n[ORPHANS] = kept


def drop_pending(s: State) -> None:
    """The pending groups were damaged packets, unless a chain that is resolved next fits them."""
    for k in range(int(s.n[PENDING])):
        orphan(s, int(s.pending[k]))
    s.n[PENDING] = 0
    s.n[MODE] = NONE


def orphan(s: State, slot: int) -> None:
    count = int(s.n[ORPHANS])
    if count == len(s.orphans):
        break_group(s, int(s.orphans[0]))
        for k in range(count - 1):
            s.orphans[k] = s.orphans[k + 1]
        count -= 1
    s.orphans[count] = slot
    s.n[ORPHANS] = count + 1
    s.n[ORPHAN_AGE] = 0


def clear_orphans(s: State) -> None:
    for k in range(int(s.n[ORPHANS])):
        break_group(s, int(s.orphans[k]))
    s.n[ORPHANS] = 0
