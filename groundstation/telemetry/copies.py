"""Copies of one sample: groups of packets with one stamp, and which content most of them carry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.reassembly_state import (
    BROKEN,
    DAMAGED,
    DISAGREED,
    GIVEN,
    LATE,
    MERGED,
    OPEN,
    VARIANTS,
    State,
)


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
