"""An adversarial radio and host for the decoder's tests: it knows the truth and shares no code
with the decoder beyond the packet codec."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import encode
from groundstation.telemetry.samples import RawBatch

PERIOD_NS = 2_000_000
TICKS_PER_PERIOD = 144_000 / 73
EPOCH_NS = 1_800_000_000_000_000_000


@dataclass
class Flight:
    """What the device sent: one row per sample."""

    ticks: NDArray[np.int64]  # true, unwrapped, continuous across silences
    sent_ns: NDArray[np.int64]
    boot: NDArray[np.int64]  # which power-up
    packets: NDArray[np.uint8]


def fly(rng: np.random.Generator, pieces: list[tuple[int, float, bool]]) -> Flight:
    """``pieces``: (samples, silence in seconds before them, whether the device restarted)."""
    ticks: list[NDArray[np.int64]] = []
    sent: list[NDArray[np.int64]] = []
    boots: list[NDArray[np.int64]] = []
    origin = float(rng.integers(0, 1 << 40))
    index, now, boot = 0, 0, 0
    for samples, silence_s, restart in pieces:
        periods = round(silence_s / 0.002)
        now += periods * PERIOD_NS
        index += periods
        if restart:
            boot += 1
            origin = float(rng.integers(0, 1 << 40))
            index = 0
        steps = np.arange(samples)
        jitter = np.clip(rng.normal(0, 4, samples), -14, 14)
        ticks.append(np.rint(origin + (index + steps) * TICKS_PER_PERIOD + jitter).astype(np.int64))
        sent.append(now + steps * PERIOD_NS)
        boots.append(np.full(samples, boot))
        index += samples
        now += samples * PERIOD_NS
    all_ticks = np.concatenate(ticks)
    n = len(all_ticks)
    packets = encode(
        all_ticks,
        rng.integers(3000, 4200, n),
        rng.integers(0, 512, (n, 4)) * 8,
        rng.integers(-32768, 32768, (n, 3)),
        rng.integers(-32768, 32768, (n, 3)),
        rng.integers(-18000, 18001, (n, 3)),
        rng.integers(0, 1 << 32, n),
    )
    return Flight(all_ticks, np.concatenate(sent), np.concatenate(boots), packets)


@dataclass
class Reception:
    """What reached the host: one row per packet, with the sample it came from."""

    batch: RawBatch
    sample: NDArray[np.int64]
    """Row of the flight, or -1 for damaged packets."""


def receive(
    rng: np.random.Generator,
    flight: Flight,
    *,
    copies: int = 4,
    loss: float = 0.0,
    burst: float = 0.0,
    swap: float = 0.0,
    blocks: list[tuple[float, float]] | None = None,
    queue: int | None = None,
    damage: float = 0.0,
) -> Reception:
    """Send every sample ``copies`` times 500 us apart through a bad radio to a slow host.

    loss: independent loss of a copy. burst: chance that a whole sample is lost. swap: chance
    that the last copy of a sample comes after the next sample's first. blocks: (start s,
    length s) during which the host reads nothing and stamps everything at the end. queue: what
    the kernel keeps during a block; later packets are dropped. damage: chance that a copy
    arrives with flipped bytes.
    """
    rows = np.repeat(np.arange(len(flight.ticks)), copies)
    copy = np.tile(np.arange(copies), len(flight.ticks))
    arrival = flight.sent_ns[rows] + copy * 500_000 + 295_000
    late = (copy == copies - 1) & (rng.random(len(rows)) < swap)
    arrival = arrival + np.where(late, 1_000_000 if copies > 1 else 2_300_000, 0)
    keep = (rng.random(len(rows)) >= loss) & (rng.random(len(flight.ticks)) >= burst)[rows]
    rows, arrival = rows[keep], arrival[keep]
    order = np.argsort(arrival, kind="stable")
    rows, arrival = rows[order], arrival[order]
    stamps = arrival + rng.integers(50_000, 400_000, len(arrival))
    for start_s, length_s in blocks or []:
        start, end = round(start_s * 1e9), round((start_s + length_s) * 1e9)
        waiting = np.flatnonzero((stamps >= start) & (stamps < end))
        stamps[waiting] = end
        kept = np.ones(len(rows), bool)
        kept[waiting[queue:] if queue is not None else []] = False
        rows, stamps = rows[kept], stamps[kept]
    stamps = np.maximum.accumulate(stamps)
    packets = flight.packets[rows].copy()
    sample = rows.copy()
    for hit in np.flatnonzero(rng.random(len(rows)) < damage):
        for _ in range(int(rng.integers(1, 4))):
            packets[hit, rng.integers(0, 32)] ^= np.uint8(1 << int(rng.integers(0, 8)))
        sample[hit] = -1
    return Reception(RawBatch(packets, stamps.astype(np.int64) + EPOCH_NS), sample)
