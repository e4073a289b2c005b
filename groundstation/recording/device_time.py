"""Host stamps of files that carry none, made from device time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

RESTART_PAUSE_S = 2.0
"""Silence put before a segment that starts earlier than the one before it ended: long enough
to be taken for a restart when the recording is replayed (1 s of silence declares one)."""

_LATEST_NS = 1 << 61
"""Segments of nonsense (decades each) stop adding up here, below what 64 bits hold."""

SYNTHESISED = {"source": "made from device time"}
"""Metadata record ``host_time`` of a recording whose host stamps were never measured."""


def host_time_from_ticks(
    ticks: NDArray[np.int64], tick_s: float, segment: NDArray[np.int32]
) -> NDArray[np.int64]:
    """Host stamps in ns, shape (n,), that keep every device interval and never run backwards.

    The first segment starts at its own device time (the Unix epoch plus that), so that the
    same file always gives the same stamps. Device time must lie within +-2^62 ns.
    """
    if len(ticks) == 0:
        return np.empty(0, np.int64)
    device_ns = np.rint(ticks.astype(np.float64) * (tick_s * 1e9)).astype(np.int64)
    starts = np.flatnonzero(np.diff(segment, prepend=segment[0] - 1))
    ends = np.append(starts[1:], len(ticks)) - 1
    offset_ns = np.zeros(len(ticks), np.int64)
    earliest_ns = 0
    for start, end in zip(starts, ends, strict=True):
        shift_ns = max(0, earliest_ns - int(device_ns[start]))
        offset_ns[start : end + 1] = shift_ns
        ended_ns = int(device_ns[end]) + shift_ns
        earliest_ns = min(ended_ns + round(RESTART_PAUSE_S * 1e9), _LATEST_NS)
    return device_ns + offset_ns
