"""Tasks that must not die silently: begun anew with growing pauses, counted and told."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

BACK_OFF_S = (0.5, 1.0, 2.0, 4.0, 8.0)
SETTLED_S = 30.0
"""A task that ran for so long begins its back-off anew."""

Work = Callable[[], Awaitable[None]]


@dataclass(slots=True)
class TaskCount:
    """How a supervised task fares. state: running, waiting (to be begun anew) or ended."""

    state: str = "running"
    restarts: int = 0


class Supervisor:
    """Runs tasks until ``close``. fault: told (text, name) of each failure."""

    def __init__(self, fault: Callable[[str, str], None]) -> None:
        self._fault = fault
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._counts: dict[str, TaskCount] = {}
        self._adopted: dict[str, asyncio.Task[None]] = {}

    def start(self, name: str, work: Work) -> None:
        """Run ``work``; where it raises it is begun anew, where it returns it has ended."""
        self._counts[name] = TaskCount()
        self._tasks[name] = asyncio.create_task(self._keep(name, work), name=name)

    def adopt(self, name: str, task: asyncio.Task[None]) -> None:
        """Watch a task that somebody else ends: should it fail, that is told."""
        self._adopted[name] = task

        def look(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and task.exception() is not None:
                self._fault(f"{name} has failed: {task.exception()!r}", name)

        task.add_done_callback(look)

    @property
    def restarts(self) -> int:
        return sum(count.restarts for count in self._counts.values())

    def dead(self) -> list[str]:
        """Tasks that are not there any more although nobody closed them."""
        own = [
            name
            for name, task in self._tasks.items()
            if task.done() and self._counts[name].state != "ended"
        ]
        return own + [name for name, task in self._adopted.items() if task.done()]

    def status(self) -> dict[str, Any]:
        return {
            name: {"state": count.state, "restarts": count.restarts}
            for name, count in self._counts.items()
        }

    async def close(self) -> None:
        """End every task."""
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    async def _keep(self, name: str, work: Work) -> None:
        loop, count, failures = asyncio.get_running_loop(), self._counts[name], 0
        while True:
            began_s = loop.time()
            try:
                count.state = "running"
                await work()
            except Exception as error:
                failures = 0 if loop.time() - began_s > SETTLED_S else failures
                wait_s = BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)]
                failures += 1
                count.restarts += 1
                count.state = "waiting"
                self._fault(f"{name} failed: {error!r}; begun anew in {wait_s:g} s", name)
                await asyncio.sleep(wait_s)
            else:
                count.state = "ended"
                return
