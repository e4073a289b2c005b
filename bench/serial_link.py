"""The serial link on a pseudo-terminal: latency, and no loss."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator

import numpy as np

from bench.table import Row
from firmware_sim.serial_port import SerialPort
from groundstation.errors import LinkLostError
from groundstation.links.serial import BATCH_S, SerialLink
from groundstation.telemetry.packet import SAMPLE_TICKS, encode

LATENCY_S = 8.0
PERIOD_S = 1e-3


def rows() -> Iterator[Row]:
    """Each row's reference is measured beside it, or is the limit it must keep."""
    latencies_ms, missing, lost_ms = asyncio.run(_latency())
    batch_ms = 1e3 * BATCH_S
    median, worst = np.percentile(latencies_ms, [50, 99])
    yield Row("serial frame to recorder, median (span of a batch)", median, batch_ms, "ms")
    yield Row("serial frame to recorder, 99th percentile (the same)", worst, batch_ms, "ms")
    yield Row("packets missing at 2000/s (sent)", missing, len(latencies_ms) + missing, "packets")
    yield Row("port dies: link lost after", lost_ms, None, "ms", most=1000.0)


async def _latency() -> tuple[list[float], int, float]:
    """Latencies (ms), packets missing, and how long the end of the other process takes (ms).

    Every packet carries its number and, in place of a measurement, when it was sent.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/line"
        writer = multiprocessing.get_context("spawn").Process(target=_write, args=(path,))
        writer.start()
        while not os.path.islink(path):
            await asyncio.sleep(0.01)
        latencies: list[float] = []
        numbers: list[int] = []
        async with SerialLink(path) as link:
            end = time.monotonic() + LATENCY_S
            while time.monotonic() < end:
                batch = await link.read()
                if batch is None:
                    continue
                now_us = time.monotonic_ns() // 1000
                sent_us = batch.packets[:, 28:].copy().view("<u4")[:, 0].astype(np.int64)
                latencies += ((now_us - sent_us) % (1 << 32) / 1e3).tolist()
                numbers += batch.packets[:, 10:14].copy().view("<u4")[:, 0].tolist()
            writer.kill()
            started = time.monotonic()
            try:
                while True:
                    await link.read()
            except LinkLostError:
                lost_ms = 1e3 * (time.monotonic() - started)
        writer.join()
    return latencies, numbers[-1] - numbers[0] + 1 - len(numbers), lost_ms


def _write(path: str) -> None:
    """Two packets every millisecond, as the bridge forwards them."""
    with SerialPort(f"pty:{path}") as line:
        due, number = time.monotonic(), 0
        while True:
            pair = np.arange(number, number + 2)
            gyro = pair.astype("<u4").view("<i2").reshape(2, 2)
            packets = encode(
                pair // 4 * SAMPLE_TICKS, [3700] * 2, np.zeros((2, 4)),
                np.hstack([gyro, [[0], [0]]]), np.zeros((2, 3)), np.zeros((2, 3)),
                [time.monotonic_ns() // 1000 % (1 << 32)] * 2,
            )  # fmt: skip
            line.send(packets)
            number += 2
            due += PERIOD_S
            time.sleep(max(0.0, due - time.monotonic()))
