"""Where a craft says that it is, by a log block of its own: for whoever lands it, at once, and as a
table for the recording."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

import numpy as np

from groundstation.links.clock import HostClock
from groundstation.links.crazyflie_connection import Connection
from groundstation.links.log_rows import WRAP_MS
from groundstation.links.supervisor import LEAN, PLACE, Place
from groundstation.telemetry.samples import LogTable

PLACE_MS = 40
"""Between two of them: 25 a second, 18 bytes each."""
TABLE = "state"
"""The series of a recording that holds them."""
THRUST = "stabilizer.thrust"
"""What the controller asks of the motors: beside their duty it shows how thrust becomes voltage."""


async def watch_place(
    connection: Connection,
    clock: HostClock,
    on_place: Callable[[Place], None],
    on_table: Callable[[LogTable], None],
) -> None:
    """Let the craft say where it is, where its firmware lists that. Raises LinkError where it
    refuses.

    on_place: told at once, from cflib's thread, so that a landing needs no event loop.
    on_table: told on this loop.
    """
    listed = connection.variables()
    if not set(PLACE) <= listed.keys():
        return
    loop, time_ms = asyncio.get_running_loop(), -1

    def take(stamp: int, said: dict[str, float]) -> None:
        nonlocal time_ms
        time_ms = stamp if time_ms < 0 else time_ms + (stamp - time_ms) % WRAP_MS
        on_place(Place.of(said, time.monotonic()))
        columns = {name: np.array([value], np.float64) for name, value in said.items()}
        rows = LogTable(TABLE, np.array([clock()]), np.array([1e-3 * time_ms]), columns)
        with contextlib.suppress(RuntimeError):  # cflib's threads may outlast the loop
            loop.call_soon_threadsafe(on_table, rows)

    halves = [(name, "FP16") for name in (*PLACE, *LEAN, THRUST) if name in listed]
    await connection.blocks.watch("place", halves, PLACE_MS, take)
