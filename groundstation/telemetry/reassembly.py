"""The streaming kernel: copies become samples, 16-bit stamps become device time.

Plain functions over arrays in the subset of Python that numba compiles. The daemon runs them
interpreted (a live batch is a few packets, and importing numba costs 70 MB); bulk decoding runs
the same functions compiled. ``decoder.py`` owns the state and the vectorised part before it.

How it decides
--------------
*Copies.* Packets with the same stamp inside a short window are copies of one sample; the content
that most of them carry wins. A copy is recognised by content for as long as its group is
remembered (``RECENT`` groups), also when it comes late or interleaved with the next packet.

*Time.* Samples lie on a 1972.603-tick grid. One wrap of the stamp is 33.22 samples, so the
fraction tells the number of wraps modulo nine: **the grid alone bridges gaps up to 598 ms**.
Beyond that the host's stamps decide. They may be late but never early, so the lower envelope of
(host time - device time) bounds how far device time can have advanced. Packets whose stamps are
late are held until either a later one is on time after all (a blocked host: device time simply
goes on) or the lateness returns to one floor again and again for ``SETTLE_NS`` of device time (a
real silence: device time jumps).

*Damage.* A group off the grid, or impossibly early, waits until ``CORROBORATE`` groups agree with
each other; otherwise it was a damaged packet. Agreeing groups off the grid are a restart of the
device when the silence before them was at least ``RESTART_NS``, else a slip of its phase.

Odds: a device that restarts during a silence shows a random phase; it is taken for the old one
when that phase falls within +-``TOLERANCE`` ticks of the grid for a wrap count that the host
clock allows (a window of 90 ms, 1.36 wraps): 2 x 40 / 1972.6 x 1.36 = 5.5 %.

All compiled functions are in this one file because the compiler's cache watches only the file of
the entry point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import SAMPLE_TICKS, TICK_S
from groundstation.telemetry.reassembly_state import (
    BROKEN,
    BUFFERED,
    BURSTS,
    COPIES,
    DAMAGED,
    DISAGREED,
    EMIT_SEGMENT,
    EMITTED,
    EVERYTHING,
    EVIDENCE,
    FLOOR_HOST,
    FLOOR_TICKS,
    FORCED,
    GIVEN,
    HEAD,
    HINT,
    HOLD,
    LATE,
    LONGEST,
    LOST,
    MAIN,
    MAIN_ENVELOPE,
    MAIN_GRID,
    MAIN_INDEX,
    MAIN_LAST,
    MAIN_SINCE,
    MERGED,
    MISSES,
    MODE,
    NONE,
    NOWHERE,
    OPEN,
    ORPHAN_AGE,
    ORPHANS,
    OUT,
    PEND_ENVELOPE,
    PEND_FLOOR,
    PEND_GRID,
    PEND_HOST,
    PEND_INDEX,
    PEND_LAST,
    PENDING,
    RESTARTS,
    SEGMENT,
    SLIPS,
    SLOTS,
    SUSPECT,
    TOO_LATE,
    VARIANTS,
    Output,
    State,
)

GRID = SAMPLE_TICKS
TICK_NS = TICK_S * 1e9
TOLERANCE = 40.0
"""Ticks off the grid that still count as on it; the real excerpt strays by up to 13."""
RECENT = 16
"""Groups that are remembered for late copies."""
REORDER = 3
"""A sample is given out when one this many periods newer has arrived."""
CORROBORATE = 3
CONTINUES = 16
"""Steps up to this many periods are device time going on rather than a silence."""
LEAK = 200e-6
"""Rise of the envelope: the two clocks may drift apart by this fraction."""
ON_TIME_NS = 60e6
EARLY_NS = 30e6
SETTLE_NS = 250e6
FLOOR_NS = 20e6
"""Lateness this close to the lowest one counts as having returned to it."""
FLOOR_VISITS = 4
RESTART_NS = 1e9
SAME_COPY_NS = 250e6
"""Equal stamps with different content are copies of one sample only this close together."""
BACK = 64
HELD_MOST = SLOTS - 4096
"""Held groups beyond this are resolved with what is known."""


def reassemble(
    s: State,
    out: Output,
    words: NDArray[np.uint64],
    stamps: NDArray[np.int64],
    counts: NDArray[np.int64],
    host: NDArray[np.int64],
) -> None:
    """Feed runs of identical packets: contents (n, 4), stamps, copies and host times (n,)."""
    for i in range(len(stamps)):
        _take(s, out, words[i], int(stamps[i]), int(counts[i]), int(host[i]))


def idle(s: State, out: Output, host: int) -> None:
    """Nothing has come up to ``host``: give out what waits for its turn, settle what can be."""
    _expire(s, out, host)
    if s.n[MODE] == HOLD and host - s.f[PEND_HOST] > SETTLE_NS:
        _resolve_hold(s, out)
    _emit(s, out, EVERYTHING)


def finish(s: State, out: Output) -> None:
    """Give out everything that is held, with the best decision possible now."""
    if s.n[MODE] == HOLD:
        _resolve_hold(s, out)
    _expire(s, out, EVERYTHING)
    _clear_orphans(s)
    _emit(s, out, EVERYTHING)


def _expire(s: State, out: Output, host: int) -> None:
    """A suspect chain that nothing has joined for long: settle it."""
    if s.n[MODE] == SUSPECT and host - s.f[PEND_HOST] > SETTLE_NS:
        if s.n[MAIN] == 0:
            _promote(s, out)
        elif _silence_ns(s) >= RESTART_NS:
            _resolve_suspect(s, out)
        else:
            _drop_pending(s)


def _take(
    s: State, out: Output, content: NDArray[np.uint64], stamp: int, copies: int, host: int
) -> None:
    n = s.n
    head = int(n[HEAD])
    n[COPIES] += copies
    for back in range(1, min(RECENT, head) + 1):
        slot = (head - back) % SLOTS
        if s.stamp[slot] != stamp:
            continue
        if s.fate[slot] == MERGED:
            slot = int(s.best[slot])
        variant = _variant(s, slot, content)
        if variant >= 0 or abs(host - int(s.host[slot])) < SAME_COPY_NS:
            _add_copies(s, slot, variant, content, copies)
            return
    slot = head % SLOTS
    n[HEAD] = head + 1
    s.stamp[slot] = stamp
    s.host[slot] = host
    s.fate[slot] = OPEN
    s.variants[slot] = 0
    _add_variant(s, slot, content, copies)
    _place(s, out, slot)


def _variant(s: State, slot: int, content: NDArray[np.uint64]) -> int:
    """Which of the group's contents this is, or -1."""
    for v in range(int(s.variants[slot])):
        known = s.words[slot, v]
        if (
            known[0] == content[0]
            and known[1] == content[1]
            and known[2] == content[2]
            and known[3] == content[3]
        ):
            return v
    return -1


def _add_copies(
    s: State, slot: int, variant: int, content: NDArray[np.uint64], copies: int
) -> None:
    """Count further copies of a group, as what became of it says."""
    n = s.n
    fate = s.fate[slot]
    if fate == OPEN:
        if variant >= 0:
            s.votes[slot, variant] += copies
        else:
            _add_variant(s, slot, content, copies)
    elif fate == GIVEN:
        if variant != s.best[slot]:
            n[DISAGREED] += copies
    elif fate == BROKEN:
        n[DAMAGED] += copies
    else:
        n[LATE] += copies


def _add_variant(s: State, slot: int, content: NDArray[np.uint64], copies: int) -> None:
    v = int(s.variants[slot])
    if v == VARIANTS:
        s.n[DISAGREED] += copies
        return
    s.variants[slot] = v + 1
    s.votes[slot, v] = copies
    for k in range(4):
        s.words[slot, v, k] = content[k]


def _place(s: State, out: Output, slot: int) -> None:
    """Find the group's place in time, or let it wait."""
    n, f = s.n, s.f
    stamp, host = int(s.stamp[slot]), int(s.host[slot])
    _expire(s, out, host)
    if n[MAIN] == 0:
        if n[PENDING] == 0:
            _start_pending(s, slot, SUSPECT)
        else:
            _corroborate(s, out, slot)
        return
    if n[MODE] == HOLD:
        ticks = _fit_pending(s, stamp, host)
        paused = host - f[PEND_HOST] > SETTLE_NS
        if paused and (ticks == NOWHERE or ticks - n[PEND_LAST] > CONTINUES * GRID):
            _resolve_hold(s, out)  # a second silence; a blocked host would just go on
        elif ticks != NOWHERE:
            _join_pending(s, slot, ticks)
            if n[PENDING] == CORROBORATE:
                _adopt_orphans(s)
            if _settled(s) or _on_time_after_all(s) or n[PENDING] >= HELD_MOST:
                _resolve_hold(s, out)
            return
        else:
            n[MISSES] += 1
            if n[MISSES] < CORROBORATE:
                _orphan(s, slot)
                return
            # three in a row elsewhere: a gap inside what the late host has to catch up with
            if n[PENDING] >= CORROBORATE or _steps_from_main(s) <= CONTINUES:
                _resolve_hold(s, out)
            else:
                _drop_pending(s)
    ticks = _fit_main(s, stamp, host)
    if ticks != NOWHERE:
        lateness = _lateness_ns(s, ticks, host)
        if lateness <= ON_TIME_NS:
            _accept(s, out, slot, ticks)
            if n[ORPHANS] > 0:
                _accept_orphans(s, out)
            n[MAIN_SINCE] += 1
            if n[PENDING] > 0 and n[MAIN_SINCE] >= CORROBORATE:
                _drop_pending(s)
                _clear_orphans(s)
            return
        if n[MODE] == NONE or _fit_pending(s, stamp, host) == NOWHERE:
            if n[PENDING] > 0:
                _drop_pending(s)
            _start_pending(s, slot, HOLD)
            return
    if n[MODE] == NONE:
        _start_pending(s, slot, SUSPECT)
    else:
        _corroborate(s, out, slot)


# -- chains -------------------------------------------------------------------------------


def _on_grid(offset: float) -> tuple[int, bool]:
    """Nearest grid index of an offset in ticks, and whether it is on the grid."""
    index = round(offset / GRID)
    return int(index), abs(offset - index * GRID) <= TOLERANCE


def _fit(last: int, grid: float, envelope: float, stamp: int, host: int, furthest: int) -> int:
    """Smallest place on a chain's grid for ``stamp``, in ticks, or NOWHERE.

    Steps back up to BACK samples, then forward; a step beyond one wrap must not be early.
    """
    ahead = (stamp - last) & 0xFFFF
    for wrap in range(-2, 1):
        ticks = last + ahead + wrap * 65536
        index, fits = _on_grid(ticks - grid)
        if fits and (wrap == 0 or -BACK < index <= 0):
            return ticks
    for wrap in range(1, furthest + 1):
        ticks = last + ahead + wrap * 65536
        if host - ticks * TICK_NS < envelope - EARLY_NS:
            return NOWHERE
        if _on_grid(ticks - grid)[1]:
            return ticks
    return NOWHERE


def _fit_main(s: State, stamp: int, host: int) -> int:
    return _fit(int(s.n[MAIN_LAST]), s.f[MAIN_GRID], _envelope_at(s, host), stamp, host, 1 << 20)


def _fit_pending(s: State, stamp: int, host: int) -> int:
    ticks = _fit(int(s.n[PEND_LAST]), s.f[PEND_GRID], s.f[PEND_ENVELOPE], stamp, host, 9)
    return NOWHERE if ticks == NOWHERE or _is_taken(s, ticks) else ticks


def _is_taken(s: State, ticks: int) -> bool:
    """Is a place further back than reordering reaches held by another sample already?

    A gap of a little less than 598 ms looks like a step back.
    """
    index = int(s.n[PEND_INDEX]) + _on_grid(ticks - s.f[PEND_GRID])[0]
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


def _lateness_ns(s: State, ticks: int, host: int) -> float:
    return host - ticks * TICK_NS - float(s.f[MAIN_ENVELOPE])


def _expected_ticks(s: State, base: int) -> float:
    """Where the host's clock puts the pending group whose relative ticks are ``base``."""
    offset = s.f[PEND_ENVELOPE]
    return float((offset - _envelope_at(s, offset + base * TICK_NS)) / TICK_NS + base)


def _silence_ns(s: State) -> float:
    """Host time between the main chain's last arrival and the pending chain's first."""
    first = s.f[PEND_ENVELOPE] + s.ticks[s.pending[0]] * TICK_NS
    return float(first - (s.n[MAIN_LAST] * TICK_NS + s.f[MAIN_ENVELOPE]))


def _start_pending(s: State, slot: int, mode: int) -> None:
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


def _join_pending(s: State, slot: int, ticks: int) -> None:
    """Add a group that fits the pending chain; a second group at one place is a copy of it."""
    n, f = s.n, s.f
    host = float(s.host[slot])
    index = int(n[PEND_INDEX]) + _on_grid(ticks - f[PEND_GRID])[0]
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
    if not _insert(s, s.pending, int(n[PENDING]), slot):
        return
    n[PENDING] += 1
    if index > n[PEND_INDEX]:
        step = index - int(n[PEND_INDEX])
        f[PEND_GRID] += step * GRID
        f[PEND_GRID] += (ticks - f[PEND_GRID]) / 16.0
        n[PEND_INDEX] = index
        n[PEND_LAST] = ticks


def _corroborate(s: State, out: Output, slot: int) -> None:
    """A group that does not fit the main chain: does it agree with others that did not?"""
    n = s.n
    ticks = _fit_pending(s, int(s.stamp[slot]), int(s.host[slot]))
    if ticks == NOWHERE:
        n[MISSES] += 1
        if n[MISSES] >= n[PENDING]:
            _drop_pending(s)
            _start_pending(s, slot, SUSPECT)
        else:
            _orphan(s, slot)
        return
    _join_pending(s, slot, ticks)
    if n[PENDING] >= CORROBORATE:
        if n[MAIN] == 0:
            _promote(s, out)
        else:
            _resolve_suspect(s, out)


def _settled(s: State) -> bool:
    """Has the lateness stayed at one floor, as it does after a silence?"""
    span = (s.n[PEND_LAST] - s.f[FLOOR_TICKS]) * TICK_NS
    return bool(s.n[EVIDENCE] >= FLOOR_VISITS and span >= SETTLE_NS)


def _on_time_after_all(s: State) -> bool:
    """Did the host merely lag? Then some held group is on time if device time simply went on."""
    first = int(s.pending[0])
    ticks = _fit_main(s, int(s.stamp[first]), int(s.host[first]))
    if ticks == NOWHERE:
        return False
    shift = ticks - int(s.ticks[first])
    lateness = s.f[PEND_ENVELOPE] - shift * TICK_NS - s.f[MAIN_ENVELOPE]
    return bool(lateness <= ON_TIME_NS)


def _steps_from_main(s: State) -> float:
    """Periods from the main chain to the pending one if device time simply went on."""
    first = int(s.pending[0])
    ticks = _fit_main(s, int(s.stamp[first]), int(s.host[first]))
    if ticks <= s.n[MAIN_LAST]:  # nowhere, or a step back
        return float("inf")
    return float((ticks - s.n[MAIN_LAST]) / GRID)


def _resolve_hold(s: State, out: Output) -> None:
    """Decide how far device time advanced over the gap before the held groups, or inside them."""
    n, f = s.n, s.f
    lag = _on_time_after_all(s)
    if not lag and not _settled(s):
        # no more to come and no proof: device time that simply goes on is the likelier case,
        # unless the lateness has come back to its floor
        lag = bool(_steps_from_main(s) <= CONTINUES and n[EVIDENCE] < 2)
    late = int(n[PENDING]) if lag else _late_before_silence(s)
    first = int(s.pending[0])
    nearest = _fit_main(s, int(s.stamp[first]), int(s.host[first]))
    if late == n[PENDING]:
        _append(s, out, nearest - int(s.ticks[first]))
        return
    if late > 0:
        _append_first(s, out, late, nearest - int(s.ticks[first]))
        first = int(s.pending[0])
        nearest = _fit_main(s, int(s.stamp[first]), int(s.host[first]))
    # constant lateness: a silence. The host's clock gives the place, the grid its exact value.
    base = int(s.ticks[first])
    last = int(n[MAIN_LAST])
    ahead = (int(s.stamp[first]) - last) & 0xFFFF
    expected = _expected_ticks(s, base)
    wrap = int((expected + EARLY_NS / TICK_NS - last - ahead) // 65536)
    while wrap >= 0:
        ticks = last + ahead + wrap * 65536
        if (expected - ticks) * TICK_NS > ON_TIME_NS:
            break
        if _on_grid(ticks - f[MAIN_GRID])[1]:
            _append(s, out, ticks - base)
            return
        wrap -= 1
    if _silence_ns(s) < RESTART_NS and nearest != NOWHERE:
        # no silence worth the name: the way to the host became slower for good
        _append_slower(s, out, nearest - base)
        return
    _resolve_suspect(s, out)


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
    largest = _steps_from_main(s)
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


def _resolve_suspect(s: State, out: Output) -> None:
    """Groups that agree with each other but not with the main chain."""
    n, f = s.n, s.f
    first = int(s.pending[0])
    base = int(s.ticks[first])
    last = int(n[MAIN_LAST])
    ahead = (int(s.stamp[first]) - last) & 0xFFFF
    if _silence_ns(s) < RESTART_NS:
        for wrap in range(9):
            ticks = last + ahead + wrap * 65536
            if _on_grid(ticks - f[MAIN_GRID])[1]:
                _append(s, out, ticks - base)
                return
        n[SLIPS] += 1
    else:
        n[RESTARTS] += 1
        n[FORCED] = 1
    _anchor(s, out, last, ahead, base)


def _promote(s: State, out: Output) -> None:
    """The first chain of a stream, or of a new segment, becomes the main one."""
    n, f = s.n, s.f
    first = int(s.pending[0])
    stamp = int(s.stamp[first])
    if n[EMITTED] == NOWHERE:
        ticks = stamp
        if n[HINT] >= 0:
            start = int(n[HINT]) - 32768
            ticks = start + ((stamp - start) & 0xFFFF)
        _begin(s, float(ticks), f[PEND_ENVELOPE] + (int(s.ticks[first]) - ticks) * TICK_NS)
        _append(s, out, ticks - int(s.ticks[first]))
        return
    last = int(n[MAIN_LAST])
    _anchor(s, out, last, (stamp - last) & 0xFFFF, int(s.ticks[first]))


def _anchor(s: State, out: Output, last: int, ahead: int, base: int) -> None:
    """Put a chain without a grid in common where the host's clock says, after ``last``."""
    n, f = s.n, s.f
    expected = _expected_ticks(s, base)
    wrap = max(0, int((expected - last - ahead) // 65536))
    ticks = last + ahead + wrap * 65536
    _emit(s, out, EVERYTHING)
    if n[FORCED] == 1:
        n[SEGMENT] += 1
        n[FORCED] = 0
    _begin(s, float(ticks), f[PEND_ENVELOPE] + (base - ticks) * TICK_NS)
    _append(s, out, ticks - base)


def _begin(s: State, grid: float, envelope: float) -> None:
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


def _append(s: State, out: Output, shift: int) -> None:
    """Move the pending chain to the main one, ``shift`` ticks later, with orphans that fit."""
    _adopt_orphans(s)
    _append_first(s, out, int(s.n[PENDING]), shift)
    s.n[MODE] = NONE
    s.n[ORPHAN_AGE] = 0  # what comes next may be what they belong to


def _adopt_orphans(s: State) -> None:
    """Groups that fitted nowhere when they came may belong to the chain that came of it."""
    n, f = s.n, s.f
    kept = 0
    for k in range(int(n[ORPHANS])):
        slot = int(s.orphans[k])
        ticks = _fit_pending(s, int(s.stamp[slot]), int(s.host[slot]))
        if ticks != NOWHERE and abs(_on_grid(ticks - f[PEND_GRID])[0]) <= BACK:
            _join_pending(s, slot, ticks)
        else:
            s.orphans[kept] = slot
            kept += 1
    n[ORPHANS] = kept


def _accept_orphans(s: State, out: Output) -> None:
    """Groups just before the newest that seemed misplaced while a gap was not understood."""
    kept = 0
    for k in range(int(s.n[ORPHANS])):
        slot = int(s.orphans[k])
        ticks = _fit_main(s, int(s.stamp[slot]), int(s.host[slot]))
        steps = _on_grid(ticks - s.f[MAIN_GRID])[0] if ticks != NOWHERE else 0
        if -CORROBORATE <= steps < 0:
            _accept(s, out, slot, ticks)
        else:
            s.orphans[kept] = slot
            kept += 1
    s.n[ORPHANS] = kept


def _append_first(s: State, out: Output, count: int, shift: int) -> None:
    """Move the first ``count`` groups of the pending chain to the main one."""
    for k in range(count):
        slot = int(s.pending[k])
        _accept(s, out, slot, int(s.ticks[slot]) + shift)
    for k in range(count, int(s.n[PENDING])):
        s.pending[k - count] = s.pending[k]
    s.n[PENDING] -= count


def _drop_pending(s: State) -> None:
    """The pending groups were damaged packets, unless a chain that is resolved next fits them."""
    for k in range(int(s.n[PENDING])):
        _orphan(s, int(s.pending[k]))
    s.n[PENDING] = 0
    s.n[MODE] = NONE


def _orphan(s: State, slot: int) -> None:
    count = int(s.n[ORPHANS])
    if count == len(s.orphans):
        _break(s, int(s.orphans[0]))
        for k in range(count - 1):
            s.orphans[k] = s.orphans[k + 1]
        count -= 1
    s.orphans[count] = slot
    s.n[ORPHANS] = count + 1
    s.n[ORPHAN_AGE] = 0


def _clear_orphans(s: State) -> None:
    for k in range(int(s.n[ORPHANS])):
        _break(s, int(s.orphans[k]))
    s.n[ORPHANS] = 0


def _break(s: State, slot: int) -> None:
    """The group was a damaged packet."""
    s.n[DAMAGED] += _copies(s, slot)
    s.fate[slot] = BROKEN


def _copies(s: State, slot: int) -> int:
    total = 0
    for v in range(int(s.variants[slot])):
        total += int(s.votes[slot, v])
    return total


# -- the main chain -----------------------------------------------------------------------


def _accept(s: State, out: Output, slot: int, ticks: int) -> None:
    """Place a group on the main chain and give out what is old enough."""
    n, f = s.n, s.f
    step, _ = _on_grid(ticks - f[MAIN_GRID])
    index = int(n[MAIN_INDEX]) + step
    host = float(s.host[slot])
    n[ORPHAN_AGE] += 1
    if n[ORPHAN_AGE] > BACK and n[ORPHANS] > 0 and n[PENDING] == 0:
        _clear_orphans(s)
    if index <= n[EMITTED]:
        n[LATE] += _copies(s, slot)
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
    if not _insert(s, s.buffer, int(n[BUFFERED]), slot):
        return
    n[BUFFERED] += 1
    _emit(s, out, int(n[MAIN_INDEX]) - REORDER)


def _insert(s: State, order: NDArray[np.int64], count: int, slot: int) -> bool:
    """Insert a group into a list ordered by place; False when one there took it in instead."""
    at = count
    while at > 0 and s.place[order[at - 1]] > s.place[slot]:
        at -= 1
    if at > 0 and s.place[order[at - 1]] == s.place[slot]:
        _merge(s, int(order[at - 1]), slot)
        return False
    for k in range(count, at, -1):
        order[k] = order[k - 1]
    order[at] = slot
    return True


def _merge(s: State, kept: int, slot: int) -> None:
    """Two groups at one place: copies of one sample that disagree in their stamp."""
    for v in range(int(s.variants[slot])):
        _add_variant(s, kept, s.words[slot, v], int(s.votes[slot, v]))
    s.fate[slot] = MERGED
    s.best[slot] = kept


def _emit(s: State, out: Output, upto: int) -> None:
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
        out.lateness[row] = _lateness_ns(s, ticks, int(s.host[slot]))
        n[OUT] = row + 1
        n[DISAGREED] += _copies(s, slot) - s.votes[slot, best]
        s.best[slot] = best
        s.fate[slot] = GIVEN
    if given > 0:
        for k in range(given, count):
            s.buffer[k - given] = s.buffer[k]
        n[BUFFERED] = count - given
