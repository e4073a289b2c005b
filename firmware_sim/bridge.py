"""The bridge: a bounded queue between the radio and USB frames of 64 bytes each millisecond."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.compiled import kernel

FRAME_NS = 1_000_000
FRAME_PACKETS = 2


class Bridge:
    """Packets in at the times the radio has them, packets out with the USB frames.

    A frame carries the packets that were queued when it began and reaches the host when it
    ends. A packet that finds the queue full is dropped and counted in ``overflows``.
    """

    def __init__(self, capacity: int, deduplicate: bool) -> None:
        self.overflows = 0
        self._capacity = capacity
        self._deduplicate = deduplicate
        self._frame = 0
        self._queued = 0
        self._packets = np.empty((0, 32), np.uint8)
        self._heard_ns = np.empty(0, np.int64)
        self._last: NDArray[np.uint8] | None = None

    def pass_on(
        self, packets: NDArray[np.uint8], heard_ns: NDArray[np.int64], until_ns: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Take packets (n, 32) heard at host times and give out what frames up to ``until_ns``
        have carried: (packets, arrival ns)."""
        if self._deduplicate and len(packets):
            packets, heard_ns = self._without_repeats(packets, heard_ns)
        if len(packets):
            self._packets = np.concatenate([self._packets, packets])
            self._heard_ns = np.concatenate([self._heard_ns, heard_ns])
        last_frame = until_ns // FRAME_NS  # frames that end by then
        frames = np.empty(len(self._heard_ns), np.int64)
        self._queued = _carry(
            self._heard_ns, self._queued, self._capacity, self._frame, last_frame, frames
        )
        self._frame = max(self._frame, last_frame)
        self.overflows += int(np.count_nonzero(frames == DROPPED))
        sent = frames >= 0
        out = self._packets[sent], (frames[sent] + 1) * FRAME_NS
        waiting = frames == WAITING
        self._packets, self._heard_ns = self._packets[waiting], self._heard_ns[waiting]
        return out

    def _without_repeats(
        self, packets: NDArray[np.uint8], heard_ns: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        first = packets[:1] if self._last is None else self._last
        before = np.concatenate([first, packets[:-1]])
        new = (packets != before).any(axis=1)
        if self._last is None:
            new[0] = True
        self._last = packets[-1:].copy()
        return packets[new], heard_ns[new]


WAITING, DROPPED = -1, -2


@kernel
def _carry(
    heard: Any, queued: int, capacity: int, first_frame: int, last_frame: int, frames: Any
) -> int:
    """Fill ``frames`` with the frame that carries each packet, WAITING or DROPPED."""
    total = len(heard)
    for i in range(total):
        frames[i] = WAITING
    out = 0  # next packet that may leave; those before ``into`` are queued
    into = queued
    waiting = queued
    for frame in range(first_frame, last_frame):
        start = frame * FRAME_NS
        while into < total and heard[into] <= start:
            if waiting < capacity:
                waiting += 1
            else:
                frames[into] = DROPPED
            into += 1
        for _ in range(FRAME_PACKETS):
            while out < into and frames[out] != WAITING:
                out += 1
            if out < into:
                frames[out] = frame
                out += 1
                waiting -= 1
    return waiting
