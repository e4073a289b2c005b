"""How fast the stand-in flies, how punctual it is, and what its first start costs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.table import Row
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.monte_carlo import fly_many

FLIGHT_S = 60.0
FLIGHTS, FLIGHTS_S, BATCHES = 1000, 10.0, 8
JITTER_S, RELEASE_S = 10.0, 0.01


def rows() -> Iterator[Row]:
    """Each speed beside its reference in the same run."""
    for plant in ("reduced", "faithful"):
        settings = StandInSettings(plant=plant)
        StandIn(settings).advance(1.0)
        seconds = min(_seconds(lambda s=settings: StandIn(s).advance(FLIGHT_S)) for _ in range(3))
        yield Row(
            f"{plant}: 60 s of flight with radio and packets (real time)",
            FLIGHT_S / seconds,
            1.0,
            "x",
            least=60.0,
        )
    yield _monte_carlo()
    lateness_ms = _release_lateness_ms()
    yield Row("real time: release lateness, 99th percentile", lateness_ms, None, "ms", most=2.0)
    cold, warm = _start_up_s()
    yield Row("first start ever, which compiles (later starts)", cold, warm, "s")


def _monte_carlo() -> Row:
    def settings(count: int) -> list[StandInSettings]:
        return [StandInSettings(seed=seed, copies=1) for seed in range(count)]

    def bytes_of(craft: StandIn, packets: Any, arrivals: Any) -> int:
        return len(packets)

    # In turns, and the best of each: the machine may have other things to do.
    alone, together = [], []
    for _ in range(BATCHES):
        few, many = settings(FLIGHTS // BATCHES // 4), settings(FLIGHTS // BATCHES)
        alone.append(len(few) / _seconds(lambda f=few: fly_many(f, FLIGHTS_S, bytes_of, workers=1)))
        together.append(len(many) / _seconds(lambda m=many: fly_many(m, FLIGHTS_S, bytes_of)))
    return Row(
        f"1000 flights of 10 s on {os.cpu_count()} cores (one core)",
        FLIGHTS_S * max(together),
        FLIGHTS_S * max(alone),
        "flight s/s",
    )


def _release_lateness_ms() -> float:
    craft = StandIn(StandInSettings())
    craft.advance(5.0)
    start, late = time.monotonic(), []
    for step in range(1, int(JITTER_S / RELEASE_S) + 1):
        due = start + step * RELEASE_S
        time.sleep(max(due - time.monotonic(), 0.0))
        craft.advance(5.0 + step * RELEASE_S)
        late.append(time.monotonic() - due)
    return float(np.percentile(late, 99)) * 1e3


def _start_up_s() -> tuple[float, float]:
    code = "from firmware_sim.craft import StandIn; StandIn().advance(1.0)"
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-c", code]
        cold = _seconds(lambda: subprocess.run(command, env=environment, check=True))
        warm = _seconds(lambda: subprocess.run(command, env=environment, check=True))
    return cold, warm


def _seconds(action: Any) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start
