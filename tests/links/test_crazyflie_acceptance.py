"""A stock craft over a bad link: loss is told exactly, silence of any length is survived."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import numpy as np
import pytest

from groundstation.links.base import LinkState
from groundstation.links.crazyflie import CrazyflieTelemetry
from groundstation.links.log_rows import LogPlan, LogRows
from groundstation.recording.formats import open_recording
from groundstation.service.config import RadioConfig
from groundstation.telemetry.samples import SampleBatch
from support.crafts import ServedCraft, served
from support.waiting import eventually
from support.worlds import running, station_on

PATIENCE_S = 90.0
LOG_DATA = 0x52
"""Port 5, channel 2: what a block holds."""
MS_NS = 1_000_000


@pytest.fixture
def craft() -> Iterator[ServedCraft]:
    with served(craft="crazyflie21", plant="reduced") as running:
        yield running


class Air:
    """Between the craft and its client: loses log packets, or everything.

    stamps: block -> stamp -> whether it was let through. dropped: log packets that were not.
    """

    def __init__(self, craft: ServedCraft, loss: float = 0.0) -> None:
        self.silent, self.dropped = False, 0
        self.stamps: dict[int, dict[int, bool]] = {}
        self._send, self._loss = craft.server._send, loss
        self._draws = np.random.default_rng(1)
        craft.server._send = self.send

    def send(self, packet: bytes, addr: object) -> None:
        through = not self.silent
        if packet[0] == LOG_DATA:
            through &= self._draws.random() >= self._loss
            stamp = int.from_bytes(packet[2:5], "little")
            self.stamps.setdefault(packet[1], {})[stamp] = through
            self.dropped += not through
        if through:
            self._send(packet, addr)


async def received(link: CrazyflieTelemetry, rows: int) -> SampleBatch:
    """So many rows at least."""
    parts: list[SampleBatch] = []
    while sum(map(len, parts)) < rows:
        batch = await link.read()
        if isinstance(batch, SampleBatch):
            parts.append(batch)
    return SampleBatch.concatenate(parts)


async def test_four_per_cent_of_lost_packets_are_told_to_the_row(craft: ServedCraft) -> None:
    air = Air(craft, loss=0.04)

    async with asyncio.timeout(PATIENCE_S), CrazyflieTelemetry(craft.uri, rate_hz=100) as link:
        samples = await received(link, 800)
        counts = link.sample_counts()
        assert counts is not None
        told, lost = counts.samples, counts.lost
    times = np.rint(samples.time_s * 1000).astype(int)
    first, second = (air.stamps[block] for block in sorted(air.stamps))
    # what came before its period was set is in another one's step
    steps = np.unique(np.diff([stamp for stamp in sorted(first) if stamp >= times[0]])).tolist()
    assert steps == [10]
    apart = min(second, key=lambda stamp: abs(stamp - times[0])) - times[0]
    whole = [
        stamp
        for stamp in range(times[0], times[-1] + 1, 10)
        if first[stamp] and _is_read(second, stamp + apart, apart)
    ]
    assert times.tolist() == whole
    assert told == len(whole)
    assert lost == (times[-1] - times[0]) // 10 + 1 - len(whole)
    assert 0.02 < lost / len(whole) < 0.2


def _is_read(second: dict[int, bool], stamp: int, apart: int) -> bool:
    """Whether the other block is known at a row: of the same moment, or on both sides of it."""
    if abs(apart) <= 1:
        return second.get(stamp, False)
    other = stamp - 10 if apart > 0 else stamp + 10
    return second.get(stamp, False) and second.get(other, False)


def test_an_hour_of_two_blocks_250_times_a_second_is_whole() -> None:
    """The stamps of 24 bits run over in it."""
    first = tuple((f"gyro.{axis}", "float") for axis in "xyz")
    second = tuple((f"acc.{axis}", "float") for axis in "xyz")
    rows = LogRows(LogPlan((first, second), {name: name for name, _ in first + second}, ()), 4)
    start, hour_ms, part_ms = (1 << 24) - 1_800_000, 3_600_000, 60_000
    found, last = 0, 0
    for begin in range(start, start + hour_ms, part_ms):
        samples = rows.add(
            (block, time_ms % (1 << 24), (float(block), 0.0, time_ms % 97), time_ms * MS_NS)
            for time_ms in range(begin, begin + part_ms, 4)
            for block in (0, 1)
        )
        times = np.rint(samples.time_s * 1000).astype(np.int64)
        assert np.array_equal(times, np.arange(begin, begin + part_ms, 4))
        assert np.allclose(np.degrees(samples.gyro[:, 2]), times % 97, atol=1e-3)
        found, last = found + len(samples), int(times[-1])
    assert (found, rows.counts().lost, rows.counts().restarts) == (900_000, 0, 0)
    assert last == start + hour_ms - 4
    assert rows.segment == 0


@pytest.mark.parametrize(("silent_s", "segments"), [(0.5, 1), (60.0, 2)])
async def test_a_silence_of_the_radio_is_survived(craft, tmp_path, monkeypatch, silent_s, segments):
    """The craft's clock goes on by as much while nothing is heard, without that anybody waits."""
    patience = "groundstation.links.crazyflie.SILENT_S"
    monkeypatch.setattr(patience, PATIENCE_S)  # a slow machine is no silent craft
    station = station_on(craft.uri, tmp_path, radio=RadioConfig(rate_hz=100))
    air = Air(craft)

    async def heard() -> None:
        before = station.statistics
        await eventually(lambda: station.receiver.state is LinkState.STREAMING)
        await eventually(lambda: station.statistics not in (None, before))

    async with running(station), asyncio.timeout(PATIENCE_S):
        await heard()
        air.silent = True
        from_s = craft.craft.time_s
        if segments > 1:
            monkeypatch.setattr(patience, 0.1)
            await eventually(lambda: station.receiver.state is LinkState.LOST)
            monkeypatch.setattr(patience, PATIENCE_S)
        craft.skip_s = max(silent_s - (craft.craft.time_s - from_s), 0.0)
        await eventually(lambda: craft.craft.time_s - from_s >= silent_s)
        if segments == 1:  # what was due in it is not sent behind it
            await eventually(lambda: air.dropped > 90)
        air.silent = False
        await heard()
        await heard()
    (path,) = tmp_path.glob("*.mcap")
    samples = open_recording(path).samples
    assert len(np.unique(samples.segment)) == segments
    steps = np.diff(samples.time_s)
    assert (steps > 0).all()
    assert steps.max() >= silent_s - 0.05
    assert np.sum(steps > 0.4) == 1
    lost = [event for event in station.journal.events if event.kind == "lost"]
    assert bool(lost) == (segments > 1)
    if segments == 1:
        counted = station.receiver.link.sample_counts().lost
        assert counted == pytest.approx(steps.max() / 0.01 - 1, abs=2)


async def test_the_blocks_of_a_slow_row_come_half_a_period_apart(craft: ServedCraft) -> None:
    """The motors are set every 2 ms, and rows that come every 4 hold both settings."""

    async with asyncio.timeout(PATIENCE_S), CrazyflieTelemetry(craft.uri, rate_hz=250) as link:
        samples = await received(link, 200)
        assert link._rows is not None
        apart_ms = link._rows.apart_ms
    assert apart_ms == 2
    assert np.median(np.diff(samples.ticks)) == 4000
    assert np.isfinite(samples.duty).all()
