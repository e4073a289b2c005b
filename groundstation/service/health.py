"""Whether the daemon does what it is there for, measured, with reasons where it does not."""

from __future__ import annotations

import asyncio
import itertools
import os
from collections import deque
from typing import Any

from groundstation.allocator import give_back

PERIOD_S = 0.5
WINDOW_S = 60.0
LAG_MOST_S = 1.0
"""An event loop that was held up for so long lately is not healthy."""


RELEASE_EVERY = 40
"""So often (20 s) what the C library keeps for later is given back: with its recorder's and
readers' threads it would otherwise keep 20 MB more after some hours."""


class Health:
    """Watches the event loop; judges the rest when asked."""

    def __init__(self) -> None:
        self._lags_s: deque[float] = deque(maxlen=round(WINDOW_S / PERIOD_S))

    async def watch(self) -> None:
        """Measure by how much the event loop is late, for as long as the daemon runs."""
        loop = asyncio.get_running_loop()
        for turn in itertools.count(1):
            if turn % RELEASE_EVERY == 0:
                await asyncio.to_thread(give_back)
            due_s = loop.time() + PERIOD_S
            await asyncio.sleep(PERIOD_S)
            self._lags_s.append(loop.time() - due_s)

    @property
    def lag_s(self) -> float:
        """The worst delay of the event loop in the last minute."""
        return max(self._lags_s, default=0.0)

    def status(self, problems: list[str]) -> dict[str, Any]:
        """healthy, and why not; what the process uses. problems: those that others see."""
        if self.lag_s > LAG_MOST_S:
            problems = [*problems, f"the event loop was held up for {self.lag_s:.1f} s"]
        return {
            "healthy": not problems,
            "problems": problems,
            "loop_lag_ms": round(1e3 * self.lag_s, 1),
            **usage(),
        }


def usage() -> dict[str, Any]:
    """What this process uses: processor seconds, resident memory, descriptors, threads."""
    times = os.times()
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[1])
    return {
        "cpu_s": round(times.user + times.system, 2),
        "memory_mb": round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": len(os.listdir("/proc/self/task")),
    }
