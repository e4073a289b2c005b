"""The serial link on a pseudo-terminal: speed, latency, what the daemon costs, and no loss."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil

from bench.table import Row
from bench.timing import best
from firmware_sim.serial_port import SerialPort
from groundstation.errors import LinkLostError
from groundstation.links.serial import BATCH_S, SerialLink
from groundstation.service.client import ask
from groundstation.telemetry.framing import DELIMITER, Deframer, frame_packets
from groundstation.telemetry.packet import SAMPLE_TICKS, encode

PACKETS = 200_000
NOISE_BYTES = 10_000_000
CHUNK = 4096
LATENCY_S = 8.0
DAEMON_S = 15.0
WARM_UP_S = 4.0
PERIOD_S = 1e-3


def rows() -> Iterator[Row]:
    """Each row's reference is measured beside it, or is the limit it must keep."""
    stream = frame_packets(np.random.default_rng(0).integers(0, 256, (PACKETS, 32), np.uint8))
    yield Row(
        "deframing, 10 frames a read (bytes.split alone)",
        PACKETS / best(lambda: _deframe(stream, 360), 3, warm=False) / 1e6,
        PACKETS / best(lambda: _split(stream, 360), 3, warm=False) / 1e6,
        "million frames/s",
    )
    noise = np.random.default_rng(1).bytes(NOISE_BYTES)
    yield Row(
        "deframing 10 MB of noise (bytes.split alone)",
        best(lambda: _deframe(noise, CHUNK), 1, warm=False),
        best(lambda: _split(noise, CHUNK), 1, warm=False),
        "s",
    )
    latencies_ms, missing, lost_ms = asyncio.run(_latency())
    batch_ms = 1e3 * BATCH_S
    median, worst = np.percentile(latencies_ms, [50, 99])
    yield Row("serial frame to recorder, median (span of a batch)", median, batch_ms, "ms")
    yield Row("serial frame to recorder, 99th percentile (the same)", worst, batch_ms, "ms")
    yield Row("packets missing at 2000/s (sent)", missing, len(latencies_ms) + missing, "packets")
    yield Row("port dies: link lost after", lost_ms, None, "ms", most=1000.0)
    share, lost = _daemon(serve=True)
    yield Row("daemon, 2000 packets/s from a serial line, recording (a core)", share, 1.0, "core")
    yield Row("the same: samples lost (received)", *lost, "samples")
    share, _ = _daemon(serve=False)
    yield Row("daemon waiting for an absent port (a core)", share, 1.0, "core", most=0.01)


def _deframe(stream: bytes, size: int) -> None:
    deframer = Deframer()
    for at in range(0, len(stream), size):
        deframer.feed(stream[at : at + size])


def _split(stream: bytes, size: int) -> None:
    for at in range(0, len(stream), size):
        stream[at : at + size].split(DELIMITER)


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


def _daemon(*, serve: bool) -> tuple[float, tuple[float, float]]:
    """CPU share of the real daemon; samples lost and received."""
    with tempfile.TemporaryDirectory() as folder:
        socket, path = Path(folder, "control.sock"), f"{folder}/line"
        craft = None
        if serve:
            craft = _start_craft(folder, path)
        daemon = subprocess.Popen(
            [
                Path(sys.executable).with_name("groundstation"), "run",
                "--link", f"serial:{path}", "--recordings", f"{folder}/sessions",
            ],
            env={**os.environ, "GROUNDSTATION_SOCKET": str(socket)},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            time.sleep(WARM_UP_S)
            process = psutil.Process(daemon.pid)
            before = process.cpu_times()
            time.sleep(DAEMON_S)
            after = process.cpu_times()
            statistics = ask(socket, "GET", "/status")["statistics"] or {}
        finally:
            for child in filter(None, (daemon, craft)):
                child.terminate()
                child.wait()
    used = after.user + after.system - before.user - before.system
    counts = statistics.get("lost", 0), statistics.get("samples", 0)
    return used / DAEMON_S, counts


def _start_craft(folder: str, path: str) -> subprocess.Popen[str]:
    """The software craft on a pseudo-terminal, with a radio that loses nothing."""
    settings = Path(folder, "craft.toml")
    settings.write_text("[loss]\ngood_loss = 0.0\n")
    craft = subprocess.Popen(
        [
            sys.executable, "-m", "firmware_sim",
            "--serial", f"pty:{path}", "--settings", str(settings),
        ],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert craft.stdout is not None
    craft.stdout.readline()
    return craft
