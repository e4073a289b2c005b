"""A stand-in that flies in real time and answers clients of the official library over UDP."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from eventually import PATIENCE_S

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.crtp_server import CrtpServer


class ServedCraft:
    """A stand-in flown by a thread in steps of 10 ms, longer where it is late, served by a loop in
    another."""

    def __init__(self, craft: StandIn) -> None:
        self.craft = craft
        self.loop = asyncio.new_event_loop()
        self.server = CrtpServer(craft, port=0)
        self.each_step: Callable[[], None] = lambda: None
        self.skip_s = 0.0
        """Time that passes for the craft at its next step, for nobody else."""
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self.loop.run_forever),
            threading.Thread(target=self._fly),
        ]

    @property
    def uri(self) -> str:
        return f"udp://127.0.0.1:{self.server.port}"

    def start(self) -> None:
        for thread in self._threads:
            thread.start()
        asyncio.run_coroutine_threadsafe(self.server.start(), self.loop).result(10)

    def stop(self) -> None:
        asyncio.run_coroutine_threadsafe(self.server.close(), self.loop).result(10)
        self._stop.set()
        self.loop.call_soon_threadsafe(self.loop.stop)
        for thread in self._threads:
            thread.join(10)
        self.loop.close()

    def _fly(self) -> None:
        flown_s = self.craft.time_s
        ahead_s = flown_s - time.monotonic()
        while not self._stop.wait(0.009):
            late_s = time.monotonic() + ahead_s - flown_s
            flown_s += min(max(late_s, 0.01), 0.05) + self.skip_s
            ahead_s += self.skip_s
            self.skip_s = 0.0
            self.craft.advance(flown_s)
            self.each_step()

    def wait_for(self, condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> None:
        """Poll a condition of the running craft."""
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, "the condition never came true"
            time.sleep(0.005)


@contextlib.contextmanager
def served(**settings: Any) -> Iterator[ServedCraft]:
    """A craft that has found its gyro's bias; by default it waits on the ground."""
    craft = StandIn(StandInSettings(**{"program": "wait", "resume_s": 1e6, **settings}))
    craft.advance(3.0)
    running = ServedCraft(craft)
    running.start()
    try:
        yield running
    finally:
        running.stop()
