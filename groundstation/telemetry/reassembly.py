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

Parts: ``copies`` (groups of packets), ``device_time`` (grid and wraps), ``main_chain`` (placed and
given out), ``pending_chain`` (not certain yet), ``silence`` (how far a gap went).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.copies import (
    add_copies,
    add_variant,
    variant_of,
)
from groundstation.telemetry.device_time import (
    GRID,
    fit_main,
    fit_pending,
    lateness_ns,
    on_grid,
    silence_ns,
    steps_from_main,
)
from groundstation.telemetry.main_chain import (
    accept,
    emit,
)
from groundstation.telemetry.pending_chain import (
    ON_TIME_NS,
    SETTLE_NS,
    adopt_orphans,
    clear_orphans,
    drop_pending,
    join_pending,
    on_time_after_all,
    orphan,
    settled,
    start_pending,
)
from groundstation.telemetry.reassembly_state import (
    COPIES,
    EVERYTHING,
    HEAD,
    HOLD,
    MAIN,
    MAIN_GRID,
    MAIN_SINCE,
    MERGED,
    MISSES,
    MODE,
    NONE,
    NOWHERE,
    OPEN,
    ORPHANS,
    PEND_HOST,
    PEND_LAST,
    PENDING,
    SLOTS,
    SUSPECT,
    Output,
    State,
)
from groundstation.telemetry.silence import (
    CONTINUES,
    RESTART_NS,
    promote,
    resolve_hold,
    resolve_suspect,
)

RECENT = 16
"""Groups that are remembered for late copies."""
CORROBORATE = 3
SAME_COPY_NS = 250e6
"""Equal stamps with different content are copies of one sample only this close together."""
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
        resolve_hold(s, out)
    emit(s, out, EVERYTHING)


def finish(s: State, out: Output) -> None:
    """Give out everything that is held, with the best decision possible now."""
    if s.n[MODE] == HOLD:
        resolve_hold(s, out)
    _expire(s, out, EVERYTHING)
    clear_orphans(s)
    emit(s, out, EVERYTHING)


def _expire(s: State, out: Output, host: int) -> None:
    """A suspect chain that nothing has joined for long: settle it."""
    if s.n[MODE] == SUSPECT and host - s.f[PEND_HOST] > SETTLE_NS:
        if s.n[MAIN] == 0:
            promote(s, out)
        elif silence_ns(s) >= RESTART_NS:
            resolve_suspect(s, out)
        else:
            drop_pending(s)


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
        variant = variant_of(s, slot, content)
        if variant >= 0 or abs(host - int(s.host[slot])) < SAME_COPY_NS:
            add_copies(s, slot, variant, content, copies)
            return
    slot = head % SLOTS
    n[HEAD] = head + 1
    s.stamp[slot] = stamp
    s.host[slot] = host
    s.fate[slot] = OPEN
    s.variants[slot] = 0
    add_variant(s, slot, content, copies)
    _place(s, out, slot)


def _place(s: State, out: Output, slot: int) -> None:
    """Find the group's place in time, or let it wait."""
    n, f = s.n, s.f
    stamp, host = int(s.stamp[slot]), int(s.host[slot])
    _expire(s, out, host)
    if n[MAIN] == 0:
        if n[PENDING] == 0:
            start_pending(s, slot, SUSPECT)
        else:
            _corroborate(s, out, slot)
        return
    if n[MODE] == HOLD:
        ticks = fit_pending(s, stamp, host)
        paused = host - f[PEND_HOST] > SETTLE_NS
        if paused and (ticks == NOWHERE or ticks - n[PEND_LAST] > CONTINUES * GRID):
            resolve_hold(s, out)  # a second silence; a blocked host would just go on
        elif ticks != NOWHERE:
            join_pending(s, slot, ticks)
            if n[PENDING] == CORROBORATE:
                adopt_orphans(s)
            if settled(s) or on_time_after_all(s) or n[PENDING] >= HELD_MOST:
                resolve_hold(s, out)
            return
        else:
            n[MISSES] += 1
            if n[MISSES] < CORROBORATE:
                orphan(s, slot)
                return
            # three in a row elsewhere: a gap inside what the late host has to catch up with
            if n[PENDING] >= CORROBORATE or steps_from_main(s) <= CONTINUES:
                resolve_hold(s, out)
            else:
                drop_pending(s)
    ticks = fit_main(s, stamp, host)
    if ticks != NOWHERE:
        lateness = lateness_ns(s, ticks, host)
        if lateness <= ON_TIME_NS:
            accept(s, out, slot, ticks)
            if n[ORPHANS] > 0:
                _accept_orphans(s, out)
            n[MAIN_SINCE] += 1
            if n[PENDING] > 0 and n[MAIN_SINCE] >= CORROBORATE:
                drop_pending(s)
                clear_orphans(s)
            return
        if n[MODE] == NONE or fit_pending(s, stamp, host) == NOWHERE:
            if n[PENDING] > 0:
                drop_pending(s)
            start_pending(s, slot, HOLD)
            return
    if n[MODE] == NONE:
        start_pending(s, slot, SUSPECT)
    else:
        _corroborate(s, out, slot)


def _corroborate(s: State, out: Output, slot: int) -> None:
    """A group that does not fit the main chain: does it agree with others that did not?"""
    n = s.n
    ticks = fit_pending(s, int(s.stamp[slot]), int(s.host[slot]))
    if ticks == NOWHERE:
        n[MISSES] += 1
        if n[MISSES] >= n[PENDING]:
            drop_pending(s)
            start_pending(s, slot, SUSPECT)
        else:
            orphan(s, slot)
        return
    join_pending(s, slot, ticks)
    if n[PENDING] >= CORROBORATE:
        if n[MAIN] == 0:
            promote(s, out)
        else:
            resolve_suspect(s, out)


def _accept_orphans(s: State, out: Output) -> None:
    """Groups just before the newest that seemed misplaced while a gap was not understood."""
    kept = 0
    for k in range(int(s.n[ORPHANS])):
        slot = int(s.orphans[k])
        ticks = fit_main(s, int(s.stamp[slot]), int(s.host[slot]))
        steps = on_grid(ticks - s.f[MAIN_GRID])[0] if ticks != NOWHERE else 0
        if -CORROBORATE <= steps < 0:
            accept(s, out, slot, ticks)
        else:
            s.orphans[kept] = slot
            kept += 1
    s.n[ORPHANS] = kept
