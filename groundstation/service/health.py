"""Whether the daemon does what it is there for, measured, with reasons where it does not."""

from __future__ import annotations

import asyncio
import itertools
import os
from collections import deque
from collections.abc import Callable
from typing import Any

from groundstation.allocator import give_back
from groundstation.service.stalls import Witness

PERIOD_S = 0.25
WINDOW_S = 60.0
LAG_TOLD_S, LAG_MOST_S = 0.5, 1.0
"""Delays of the event loop: from which on one is told, and from which on the daemon is not healthy
for a minute."""
RELEASE_EVERY = 80
"""So often (20 s) what the C library keeps for later is given back: with its recorder's and
readers' threads it would otherwise keep 20 MB more after some hours."""


class Health:
    """Watches the event loop; judges the rest when asked.

    note: told (kind, text) when the loop was held up, and by what.
    """

    def __init__(self, note: Callable[[str, str], None] = lambda kind, text: None) -> None:
        self._note = note
        self._lags: deque[tuple[float, str]] = deque(maxlen=round(WINDOW_S / PERIOD_S))

    async def watch(self) -> None:
        """Measure by how much the event loop is late, for as long as the daemon runs."""
        loop = asyncio.get_running_loop()
        with Witness() as witness:
            for turn in itertools.count(1):
                if turn % RELEASE_EVERY == 0:
                    await asyncio.to_thread(give_back)
                witness.beat()
                due_s = loop.time() + PERIOD_S
                await asyncio.sleep(PERIOD_S)
                late_s = loop.time() - due_s
                self._lags.append((late_s, ""))
                if late_s >= LAG_TOLD_S:
                    why = witness.why(late_s)
                    self._lags[-1] = late_s, why
                    self._note("held up", f"the event loop, for {late_s:.1f} s: {why}")

    @property
    def lag_s(self) -> float:
        """The worst delay of the event loop in the last minute."""
        return max(self._lags, default=(0.0, ""))[0]

    @property
    def held_up_by(self) -> str:
        """What caused it, where it is worth telling."""
        return max(self._lags, default=(0.0, ""))[1]

    def status(self, problems: list[str]) -> dict[str, Any]:
        """healthy, and why not; what the process uses. problems: those that others see."""
        if self.lag_s > LAG_MOST_S:
            held_up = f"the event loop was held up for {self.lag_s:.1f} s: {self.held_up_by}"
            problems = [*problems, held_up]
        return {
            "healthy": not problems,
            "problems": problems,
            "loop_lag_ms": round(1e3 * self.lag_s, 1),
            "held_up_by": self.held_up_by,
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
