"""Groups whose time is certain: placed in order, and given out as samples."""

from __future__ import annotations

import numpy as np

from groundstation.telemetry.copies import (
    copies_of,
    insert,
)
from groundstation.telemetry.device_time import (
    BACK,
    GRID,
    LEAK,
    REORDER,
    TICK_NS,
    lateness_ns,
    on_grid,
)
from groundstation.telemetry.pending_chain import (
    clear_orphans,
)
from groundstation.telemetry.reassembly_state import (
    BUFFERED,
    BURSTS,
    DISAGREED,
    EMIT_SEGMENT,
    EMITTED,
    GIVEN,
    LATE,
    LONGEST,
    LOST,
    MAIN,
    MAIN_ENVELOPE,
    MAIN_GRID,
    MAIN_INDEX,
    MAIN_LAST,
    NOWHERE,
    ORPHAN_AGE,
    ORPHANS,
    OUT,
    PENDING,
    SEGMENT,
    TOO_LATE,
    Output,
    State,
)


def begin(s: State, grid: float, envelope: float) -> None:
    """Start a new grid at its first sample."""
    n, f = s.n, s.f
    n[MAIN] = 1
    f[MAIN_GRID] = grid
    f[MAIN_ENVELOPE] = envelope
    n[MAIN_LAST] = int(grid)
    if n[EMITTED] == NOWHERE:
        n[EMITTED] = -1
    # room for groups from before the first one; the jump is no loss
    n[MAIN_INDEX] = n[EMITTED] + 1 + BACK
    n[EMIT_SEGMENT] = -1


def accept(s: State, out: Output, slot: int, ticks: int) -> None:
    """Place a group on the main chain and give out what is old enough."""
    n, f = s.n, s.f
    step, _ = on_grid(ticks - f[MAIN_GRID])
    index = int(n[MAIN_INDEX]) + step
    host = float(s.host[slot])
    n[ORPHAN_AGE] += 1
    if n[ORPHAN_AGE] > BACK and n[ORPHANS] > 0 and n[PENDING] == 0:
        clear_orphans(s)
    if index <= n[EMITTED]:
        n[LATE] += copies_of(s, slot)
        s.fate[slot] = TOO_LATE
        return
    drift = LEAK * max(0, ticks - int(n[MAIN_LAST])) * TICK_NS
    f[MAIN_ENVELOPE] = min(f[MAIN_ENVELOPE] + drift, host - ticks * TICK_NS)
    s.ticks[slot] = ticks
    s.place[slot] = index
    if index > n[MAIN_INDEX]:
        f[MAIN_GRID] += step * GRID
        f[MAIN_GRID] += (ticks - f[MAIN_GRID]) / 64.0
        n[MAIN_INDEX] = index
        n[MAIN_LAST] = ticks
    if not insert(s, s.buffer, int(n[BUFFERED]), slot):
        return
    n[BUFFERED] += 1
    emit(s, out, int(n[MAIN_INDEX]) - REORDER)


def emit(s: State, out: Output, upto: int) -> None:
    """Give out buffered samples up to grid index ``upto``."""
    n = s.n
    given = 0
    count = int(n[BUFFERED])
    while given < count and s.place[s.buffer[given]] <= upto:
        slot = int(s.buffer[given])
        given += 1
        best = 0
        for v in range(1, int(s.variants[slot])):
            if s.votes[slot, v] >= s.votes[slot, best]:
                best = v
        if n[EMIT_SEGMENT] == n[SEGMENT]:
            gap = int(s.place[slot]) - int(n[EMITTED]) - 1
            if gap > 0:
                n[LOST] += gap
                n[BURSTS] += 1
                n[LONGEST] = max(int(n[LONGEST]), gap)
        n[EMITTED] = s.place[slot]
        n[EMIT_SEGMENT] = n[SEGMENT]
        row = int(n[OUT])
        for k in range(4):
            out.words[row, k] = s.words[slot, best, k]
        # the winner's own stamp, should a damaged copy have opened the group
        own = int(s.words[slot, best, 0] & np.uint64(0xFFFF))
        ticks = int(s.ticks[slot])
        out.ticks[row] = ticks + ((own - ticks + 32768) & 0xFFFF) - 32768
        out.host[row] = s.host[slot]
        out.segment[row] = n[SEGMENT]
        out.copies[row] = min(255, int(s.votes[slot, best]))
        out.lateness[row] = lateness_ns(s, ticks, int(s.host[slot]))
        n[OUT] = row + 1
        n[DISAGREED] += copies_of(s, slot) - s.votes[slot, best]
        s.best[slot] = best
        s.fate[slot] = GIVEN
    if given > 0:
        for k in range(given, count):
            s.buffer[k - given] = s.buffer[k]
        n[BUFFERED] = count - given
