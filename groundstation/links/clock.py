"""The host clock: Unix time that never steps.

Stamps are CLOCK_MONOTONIC plus a constant taken once, so that a stepped system
clock (NTP, an operator) changes no interval inside a session.
"""

from __future__ import annotations

import time
from collections.abc import Callable

HostClock = Callable[[], int]
"""Returns nanoseconds since the Unix epoch, never running backwards."""


def steady_clock() -> HostClock:
    """A clock anchored to the system's Unix time at this call and monotonic ever after."""
    anchor_ns = time.time_ns() - time.monotonic_ns()
    return lambda: anchor_ns + time.monotonic_ns()
