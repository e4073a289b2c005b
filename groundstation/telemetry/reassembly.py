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

In this file, each after what it uses: groups of copies, device time, groups that wait for their
time, groups that have it, silences, and last the kernel that a packet enters by.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import SAMPLE_TICKS, TICK_S

# What the reassembly kernel remembers, as arrays that Python and compiled code share.


SLOTS = 16384
"""Groups in the ring: what can be held while device time is uncertain, and more."""
VARIANTS = 4
"""Different contents remembered for one sample."""

# indices into State.n (int64)
(
    HEAD,
    SEGMENT,
    MAIN,
    MAIN_LAST,
    MAIN_INDEX,
    EMITTED,
    BUFFERED,
    PENDING,
    MODE,
    PEND_LAST,
    PEND_INDEX,
    EVIDENCE,
    MISSES,
    MAIN_SINCE,
    ORPHANS,
    ORPHAN_AGE,
    FORCED,
    HINT,
    OUT,
    COPIES,
    DISAGREED,
    DAMAGED,
    LATE,
    LOST,
    BURSTS,
    LONGEST,
    SLIPS,
    RESTARTS,
    EMIT_SEGMENT,
    INTEGERS,
) = range(30)
# indices into State.f (float64): grid position (ticks), envelope (ns), stamps (ns)
(
    MAIN_GRID,
    MAIN_ENVELOPE,
    PEND_GRID,
    PEND_ENVELOPE,
    PEND_HOST,
    PEND_FLOOR,
    FLOOR_TICKS,
    FLOOR_HOST,
    FLOATS,
) = range(9)
NONE, HOLD, SUSPECT = 0, 1, 2
"""Modes of the pending chain."""
OPEN, GIVEN, BROKEN, TOO_LATE, MERGED = 0, 1, 2, 3, 4
"""Fates of a group: waiting, given out, damaged, overtaken, part of another."""
NOWHERE = -(1 << 62)
EVERYTHING = 1 << 62


class State(NamedTuple):
    """Everything the kernel remembers between batches."""

    n: NDArray[np.int64]
    f: NDArray[np.float64]
    stamp: NDArray[np.int64]  # (SLOTS,) 16-bit stamp of the group
    host: NDArray[np.int64]  # (SLOTS,) host time of its first copy, ns from the origin
    ticks: NDArray[np.int64]  # (SLOTS,) unwrapped; relative while pending
    place: NDArray[np.int64]  # (SLOTS,) index on the grid
    fate: NDArray[np.int64]  # (SLOTS,) what became of the group
    best: NDArray[np.int64]  # (SLOTS,) the content that won, or the group merged into
    variants: NDArray[np.int64]  # (SLOTS,) how many contents were seen
    votes: NDArray[np.int64]  # (SLOTS, VARIANTS) copies of each
    words: NDArray[np.uint64]  # (SLOTS, VARIANTS, 4) the contents
    buffer: NDArray[np.int64]  # (SLOTS,) groups placed but not given out, by index
    pending: NDArray[np.int64]  # (SLOTS,) groups whose time is not certain yet
    orphans: NDArray[np.int64]  # (64,) groups that fitted nowhere when they came


class Output(NamedTuple):
    """Where finished samples go; State.n[OUT] counts the rows used."""

    words: NDArray[np.uint64]  # (rows, 4)
    ticks: NDArray[np.int64]
    host: NDArray[np.int64]
    segment: NDArray[np.int64]
    copies: NDArray[np.int64]
    lateness: NDArray[np.float64]  # ns above the envelope


def new_state() -> State:
    """The state before the first packet."""
    state = State(
        n=np.zeros(INTEGERS, np.int64),
        f=np.zeros(FLOATS),
        stamp=np.zeros(SLOTS, np.int64),
        host=np.zeros(SLOTS, np.int64),
        ticks=np.zeros(SLOTS, np.int64),
        place=np.zeros(SLOTS, np.int64),
        fate=np.zeros(SLOTS, np.int64),
        best=np.zeros(SLOTS, np.int64),
        variants=np.zeros(SLOTS, np.int64),
        votes=np.zeros((SLOTS, VARIANTS), np.int64),
        words=np.zeros((SLOTS, VARIANTS, 4), np.uint64),
        buffer=np.zeros(SLOTS, np.int64),
        pending=np.zeros(SLOTS, np.int64),
        orphans=np.zeros(64, np.int64),
    )
    state.n[HINT] = -1
    state.n[EMITTED] = NOWHERE
    return state


# Copies of one sample: groups of packets with one stamp, and which content most of them carry.


def variant_of(s: State, slot: int, content: NDArray[np.uint64]) -> int:
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


def add_copies(s: State, slot: int, variant: int, content: NDArray[np.uint64], copies: int) -> None:
    """Count further copies of a group, as what became of it says."""
    n = s.n
    fate = s.fate[slot]
    if fate == OPEN:
        if variant >= 0:
            s.votes[slot, variant] += copies
        else:
            add_variant(s, slot, content, copies)
    elif fate == GIVEN:
        if variant != s.best[slot]:
            n[DISAGREED] += copies
    elif fate == BROKEN:
        n[DAMAGED] += copies
    else:
        n[LATE] += copies


def add_variant(s: State, slot: int, content: NDArray[np.uint64], copies: int) -> None:
    v = int(s.variants[slot])
    if v == VARIANTS:
        s.n[DISAGREED] += copies
        return
    s.variants[slot] = v + 1
    s.votes[slot, v] = copies
    for k in range(4):
        s.words[slot, v, k] = content[k]


def copies_of(s: State, slot: int) -> int:
    total = 0
    for v in range(int(s.variants[slot])):
        total += int(s.votes[slot, v])
    return total


def break_group(s: State, slot: int) -> None:
    """The group was a damaged packet."""
    s.n[DAMAGED] += copies_of(s, slot)
    s.fate[slot] = BROKEN


def insert(s: State, order: NDArray[np.int64], count: int, slot: int) -> bool:
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
        add_variant(s, kept, s.words[slot, v], int(s.votes[slot, v]))
    s.fate[slot] = MERGED
    s.best[slot] = kept


# Where a stamp lies in device time: the 2 ms grid, wraps, and what the host's clock allows.


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


# Groups whose time is not certain yet, and orphans: those that fit nowhere.


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


# Groups whose time is certain: placed in order, and given out as samples.


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


# How far device time went on over a gap, and what became of the groups behind it.


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
