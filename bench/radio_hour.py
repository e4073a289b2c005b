"""An hour of telemetry of today's craft through the stock log protocol, in fast time.

``python -m bench.radio_hour --hours 1 --speed 6``: the stand-in of a 2.1 in a process of its own,
``speed`` times as fast as it would fly, read by cflib over UDP at 250 rows a second in two blocks.
Every row must come, 4 ms after the one before. Ends with status 1 where one did not.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import sys
import time
from multiprocessing.connection import Connection

import numpy as np

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.crtp_server import CrtpServer
from groundstation.links.crazyflie_log import CrazyflieTelemetry
from groundstation.telemetry.samples import SampleBatch

RATE_HZ = 250
TICK_S = 0.005


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.radio_hour")
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--speed", type=float, default=6.0)
    chosen = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    craft = context.Process(target=_fly, args=(there, chosen.speed), daemon=True)
    craft.start()
    try:
        told = asyncio.run(_received(f"udp://127.0.0.1:{here.recv()}", 3600.0 * chosen.hours))
    finally:
        craft.kill()
    print(json.dumps(told))
    return int(told["lost"] > 0 or told["late_steps"] > 0)


def _fly(pipe: Connection, speed: float) -> None:
    async def served() -> None:
        craft = StandIn(StandInSettings(craft="crazyflie21", supply_v=4.0))
        craft.advance(3.0)
        server = CrtpServer(craft, port=0)
        await server.start()
        pipe.send(server.port)
        last_s, flown_s = time.monotonic(), craft.time_s
        while True:
            await asyncio.sleep(TICK_S)
            now_s = time.monotonic()
            # a stall of this process is not made up for at once: no radio sends so many together
            flown_s += speed * min(now_s - last_s, 2.0 * TICK_S)
            last_s = now_s
            craft.advance(flown_s)

    asyncio.run(served())


async def _received(uri: str, wanted_s: float) -> dict[str, float]:
    """Counts of rows, and of steps between them that are not one period."""
    rows, off, begun, last = 0, 0, time.monotonic(), np.nan
    first = np.nan
    async with CrazyflieTelemetry(uri, rate_hz=RATE_HZ) as link:
        while rows < wanted_s * RATE_HZ:
            batch = await link.read()
            if not isinstance(batch, SampleBatch) or not len(batch):
                continue
            first = batch.time_s[0] if np.isnan(first) else first
            steps = np.diff(batch.time_s, prepend=[last] if rows else batch.time_s[0] - 0.004)
            off += int(np.sum(np.abs(steps * RATE_HZ - 1.0) > 0.25))
            last, rows = float(batch.time_s[-1]), rows + len(batch)
            if not rows % 50_000 < len(batch):
                continue
            print(f"{(last - first) / 60.0:.0f} min, {rows} rows, {off} off", file=sys.stderr)
        counts = link.sample_counts()
        assert counts is not None
    return {
        "flown_s": round(last - first, 3),
        "rows": rows,
        "lost": counts.lost,
        "late_steps": off,
        "wall_s": round(time.monotonic() - begun, 1),
    }


if __name__ == "__main__":
    sys.exit(main())
