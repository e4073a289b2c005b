"""How often something may happen."""

from __future__ import annotations

import time
from collections.abc import Callable


class RateLimit:
    """A bucket of ``burst`` permissions that refills at ``rate_hz``."""

    def __init__(
        self, rate_hz: float, burst: float, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._left, self._at_s = burst, clock()

    def allows(self) -> bool:
        """Take one permission, if there is one."""
        now_s = self._clock()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._rate_hz)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
