"""From packets to samples, and what the daemon costs at line rate."""

from __future__ import annotations

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
from groundstation.telemetry.decoder import Decoder, decode_all
from groundstation.telemetry.packet import SAMPLE_TICKS, decode, encode
from groundstation.telemetry.samples import RawBatch

SAMPLES = 250_000
LIVE_BATCH = 16
LIVE_SPAN_S = LIVE_BATCH * 0.5e-3
DAEMON_S = 20.0
WARM_UP_S = 4.0


def rows() -> Iterator[Row]:
    """Each row's reference is measured beside it; ratios, not seconds, travel."""
    raw = _packets(SAMPLES, loss=0.05)
    decode_all(raw)  # compiles, or loads what was compiled
    yield Row(
        "decode, unwrap, remove copies: large batch (numpy view, equal neighbours dropped)",
        len(raw) / best(lambda: decode_all(raw), 5, warm=False) / 1e6,
        len(raw) / best(lambda: _bare(raw), 5, warm=False) / 1e6,
        "million packets/s",
    )
    yield Row(
        f"live batch of {LIVE_BATCH} packets (the time it spans)",
        _live_batch_s(raw) * 1e3,
        LIVE_SPAN_S * 1e3,
        "ms",
    )
    yield Row(
        "groundstation --help (bare interpreter start)",
        _start_s([_script("groundstation"), "--help"]),
        _start_s([sys.executable, "-c", "pass"]),
        "s",
    )
    share, memory = _daemon()
    what = "daemon, 2000 packets/s replayed, recorder, viewer"
    yield Row(f"{what}: processor (a core)", share, 1.0, "core")
    yield Row(f"{what}: resident memory", memory, None, "MB", most=150.0)


def _packets(samples: int, loss: float) -> RawBatch:
    rng = np.random.default_rng(0)
    ticks = np.rint(np.arange(samples) * SAMPLE_TICKS + rng.normal(0, 3, samples))
    packets = encode(
        ticks.astype(np.int64),
        rng.integers(3300, 4100, samples),
        rng.integers(0, 512, (samples, 4)) * 8,
        rng.integers(-3000, 3000, (samples, 3)),
        rng.integers(-8000, 8000, (samples, 3)),
        rng.integers(-9000, 9000, (samples, 3)),
        rng.integers(0, 1 << 32, samples),
    )
    rows = np.repeat(np.arange(samples), 4)
    host = rows * 2_000_000 + np.tile(np.arange(4), samples) * 500_000 + 1_700_000_000 * 10**9
    keep = rng.random(len(rows)) >= loss
    return RawBatch(packets[rows[keep]], host[keep])


def _bare(raw: RawBatch) -> int:
    words = raw.packets.view(np.uint64)
    new = np.ones(len(words), bool)
    new[1:] = (words[1:] != words[:-1]).any(axis=1)
    return len(decode(raw.packets[new]))


def _live_batch_s(raw: RawBatch) -> float:
    """Median time of a batch as a live link delivers it."""
    decoder = Decoder()
    spans = []
    for at in range(0, 1000 * LIVE_BATCH, LIVE_BATCH):
        rows = slice(at, at + LIVE_BATCH)
        batch = RawBatch(raw.packets[rows], raw.host_time_ns[rows])
        start = time.perf_counter()
        decoder.decode(batch)
        spans.append(time.perf_counter() - start)
    return float(np.median(spans))


def _script(name: str) -> str:
    return str(Path(sys.executable).with_name(name))


def _start_s(command: list[str]) -> float:
    def start() -> None:
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    start()
    return float(np.median([best(start, 1, warm=False) for _ in range(7)]))


def _daemon() -> tuple[float, float]:
    """CPU share and memory of the real daemon, everything on."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "GROUNDSTATION_SOCKET": f"{folder}/control.sock"}
        flight = [_script("groundstation"), "run", "--recordings", f"{folder}/flight"]
        subprocess.run(
            [*flight, "--speed", "max", "--for", "4"],
            env=environment, check=True, capture_output=True,
        )  # fmt: skip
        recording = next(Path(folder, "flight").glob("*.mcap"))
        daemon = subprocess.Popen(
            [
                _script("groundstation"), "run", "--link", f"replay:{recording}",
                "--recordings", f"{folder}/replayed", "--viewer", "serve",
                "--viewer-port", "19876", "--web-port", "19090",
                "--for", str(WARM_UP_S + DAEMON_S + 3),
            ],
            env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            process = psutil.Process(daemon.pid)
            time.sleep(WARM_UP_S)
            before = process.cpu_times()
            time.sleep(DAEMON_S)
            after = process.cpu_times()
            memory = process.memory_info().rss / 1e6
        finally:
            daemon.terminate()
            daemon.wait()
    used = after.user + after.system - before.user - before.system
    return used / DAEMON_S, memory
