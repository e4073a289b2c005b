"""When the next setpoint is due."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """What time it is for the craft, s, and waiting for a setpoint's time."""

    def now_s(self) -> float: ...

    def wait(self) -> None: ...


class SetpointClock:
    """Setpoints every 10 ms; what was missed is not made up for."""

    def __init__(self) -> None:
        self._next = time.monotonic()

    def now_s(self) -> float:
        return time.monotonic()

    def wait(self) -> None:
        self._next = max(self._next + 0.01, time.monotonic() - 0.01)
        time.sleep(max(self._next - time.monotonic(), 0.0))
