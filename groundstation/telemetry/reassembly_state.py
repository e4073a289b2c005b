"""What the reassembly kernel remembers, as arrays that Python and compiled code share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
