"""How far device time went on over a gap, and what became of the groups behind it."""

from __future__ import annotations

from groundstation.telemetry.device_time import (
    EARLY_NS,
    TICK_NS,
    expected_ticks,
    fit_main,
    on_grid,
    silence_ns,
    steps_from_main,
)
from groundstation.telemetry.main_chain import (
    accept,
    begin,
    emit,
)
from groundstation.telemetry.pending_chain import (
    FLOOR_NS,
    ON_TIME_NS,
    adopt_orphans,
    on_time_after_all,
    settled,
)
from groundstation.telemetry.reassembly_state import (
    EMITTED,
    EVERYTHING,
    EVIDENCE,
    FORCED,
    HINT,
    MAIN_ENVELOPE,
    MAIN_GRID,
    MAIN_LAST,
    MODE,
    NONE,
    NOWHERE,
    ORPHAN_AGE,
    PEND_ENVELOPE,
    PENDING,
    RESTARTS,
    SEGMENT,
    SLIPS,
    Output,
    State,
)

CONTINUES = 16
"""Steps up to this many periods are device time going on rather than a silence."""
RESTART_NS = 1e9


def resolve_hold(s: State, out: Output) -> None:
    """Decide how far device time advanced over the gap before the held groups, or inside them."""
    n, f = s.n, s.f
    lag = on_time_after_all(s)
    if not lag and not settled(s):
        # no more to come and no proof: device time that simply goes on is the likelier case,
        # unless the lateness has come back to its floor
        lag = bool(steps_from_main(s) <= CONTINUES and n[EVIDENCE] < 2)
    late = int(n[PENDING]) if lag else _late_before_silence(s)
    first = int(s.pending[0])
    nearest = fit_main(s, int(s.stamp[first]), int(s.host[first]))
    if late == n[PENDING]:
        _append(s, out, nearest - int(s.ticks[first]))
        return
    if late > 0:
        _append_first(s, out, late, nearest - int(s.ticks[first]))
        first = int(s.pending[0])
        nearest = fit_main(s, int(s.stamp[first]), int(s.host[first]))
    # constant lateness: a silence. The host's clock gives the place, the grid its exact value.
    base = int(s.ticks[first])
    last = int(n[MAIN_LAST])
    ahead = (int(s.stamp[first]) - last) & 0xFFFF
    expected = expected_ticks(s, base)
    wrap = int((expected + EARLY_NS / TICK_NS - last - ahead) // 65536)
    while wrap >= 0:
        ticks = last + ahead + wrap * 65536
        if (expected - ticks) * TICK_NS > ON_TIME_NS:
            break
        if on_grid(ticks - f[MAIN_GRID])[1]:
            _append(s, out, ticks - base)
            return
        wrap -= 1
    if silence_ns(s) < RESTART_NS and nearest != NOWHERE:
        # no silence worth the name: the way to the host became slower for good
        _append_slower(s, out, nearest - base)
        return
    resolve_suspect(s, out)


def _append_slower(s: State, out: Output, shift: int) -> None:
    """Device time goes on, and the envelope is what it is from now on."""
    _append(s, out, shift)
    s.f[MAIN_ENVELOPE] = s.f[PEND_ENVELOPE] - shift * TICK_NS


def _late_before_silence(s: State) -> int:
    """How many held groups came before the silence, and were only stamped late.

    None when the first one's lateness is on the floor already; else the largest step before
    the floor is reached is where device time jumped.
    """
    f = s.f
    largest = steps_from_main(s)
    at = 0
    for k in range(int(s.n[PENDING])):
        slot = int(s.pending[k])
        if k > 0:
            step = float(s.place[slot] - s.place[s.pending[k - 1]])
            if step > largest:
                largest = step
                at = k
        offset = s.host[slot] - s.ticks[slot] * TICK_NS
        if abs(offset - f[PEND_ENVELOPE]) <= FLOOR_NS:
            break
    return at


def resolve_suspect(s: State, out: Output) -> None:
    """Groups that agree with each other but not with the main chain."""
    n, f = s.n, s.f
    first = int(s.pending[0])
    base = int(s.ticks[first])
    last = int(n[MAIN_LAST])
    ahead = (int(s.stamp[first]) - last) & 0xFFFF
    if silence_ns(s) < RESTART_NS:
        for wrap in range(9):
            ticks = last + ahead + wrap * 65536
            if on_grid(ticks - f[MAIN_GRID])[1]:
                _append(s, out, ticks - base)
                return
        n[SLIPS] += 1
    else:
        n[RESTARTS] += 1
        n[FORCED] = 1
    _anchor(s, out, last, ahead, base)


def promote(s: State, out: Output) -> None:
    """The first chain of a stream, or of a new segment, becomes the main one."""
    n, f = s.n, s.f
    first = int(s.pending[0])
    stamp = int(s.stamp[first])
    if n[EMITTED] == NOWHERE:
        ticks = stamp
        if n[HINT] >= 0:
            start = int(n[HINT]) - 32768
            ticks = start + ((stamp - start) & 0xFFFF)
        begin(s, float(ticks), f[PEND_ENVELOPE] + (int(s.ticks[first]) - ticks) * TICK_NS)
        _append(s, out, ticks - int(s.ticks[first]))
        return
    last = int(n[MAIN_LAST])
    _anchor(s, out, last, (stamp - last) & 0xFFFF, int(s.ticks[first]))


def _anchor(s: State, out: Output, last: int, ahead: int, base: int) -> None:
    """Put a chain without a grid in common where the host's clock says, after ``last``."""
    n, f = s.n, s.f
    expected = expected_ticks(s, base)
    wrap = max(0, int((expected - last - ahead) // 65536))
    ticks = last + ahead + wrap * 65536
    emit(s, out, EVERYTHING)
    if n[FORCED] == 1:
        n[SEGMENT] += 1
        n[FORCED] = 0
    begin(s, float(ticks), f[PEND_ENVELOPE] + (base - ticks) * TICK_NS)
    _append(s, out, ticks - base)


def _append(s: State, out: Output, shift: int) -> None:
    """Move the pending chain to the main one, ``shift`` ticks later, with orphans that fit."""
    adopt_orphans(s)
    _append_first(s, out, int(s.n[PENDING]), shift)
    s.n[MODE] = NONE
    s.n[ORPHAN_AGE] = 0  # what comes next may be what they belong to


def _append_first(s: State, out: Output, count: int, shift: int) -> None:
    """Move the first ``count`` groups of the pending chain to the main one."""
    for k in range(count):
        slot = int(s.pending[k])
        accept(s, out, slot, int(s.ticks[slot]) + shift)
    for k in range(count, int(s.n[PENDING])):
        s.pending[k - count] = s.pending[k]
    s.n[PENDING] -= count
