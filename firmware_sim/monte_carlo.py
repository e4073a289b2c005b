"""Many flights at once: one thread per core, the kernels hold no interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_sim.craft import StandIn, StandInSettings
from groundstation.telemetry.packet import Packets

Result = TypeVar("Result")


def fly_many(
    crafts: Iterable[StandInSettings],
    seconds: float,
    judge: Callable[[StandIn, Packets, NDArray[np.float64]], Result],
    workers: int | None = None,
) -> list[Result]:
    """Fly each craft for ``seconds`` and return what ``judge`` makes of it, in order.

    judge: called with the craft after its flight, its packets (n, 32) and arrival times (s).
    workers: threads, one per core by default.
    """

    def flight(settings: StandInSettings) -> Result:
        craft = StandIn(settings)
        return judge(craft, *craft.advance(seconds))

    settings = list(crafts)
    for one in settings[:1]:
        # msgspec 0.22 crashes where two threads decode a nested type for the first time.
        StandIn(one)
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        return list(pool.map(flight, settings))
