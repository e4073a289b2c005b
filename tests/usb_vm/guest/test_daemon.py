"""The daemon on a real USB link: recording through everything, and what it costs and loses."""

import asyncio
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from emulated_bridge import OUT, EmulatedBridge, RecordedFlight, rows_of

from groundstation.recording.formats import open_recording
from groundstation.service.config import Config, LinkConfig, RecordingConfig
from groundstation.service.station import Station

FRAMES = 5_000
FRAMES_A_CALL = 100
"""Of pyusb's own read, which loses frames between two calls."""
PATIENCE_S = 100.0
STAMPS_WITHIN_NS = 2_000_000


def station_in(folder):
    return Station(
        Config(link=LinkConfig(name="usb"), recording=RecordingConfig(folder=str(folder)))
    )


async def until(station, condition):
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.02)


@pytest.fixture(scope="module", autouse=True)
def loaded(flight, tmp_path_factory):
    """One short session: modules come from the host, in real time, while time here runs on."""

    async def session():
        with EmulatedBridge(flight) as bridge:
            station = station_in(tmp_path_factory.mktemp("loaded"))
            running = asyncio.create_task(station.run())
            bridge.plug()
            await until(station, lambda: station.receiver.decoder.counts().samples > 200)
            station.stop()
            await running
        for path in Path(station.config.recording.folder).glob("*.mcap"):
            open_recording(path, raw=True)

    asyncio.run(session())


class Blocker:
    """Stops the event loop for a tenth of a second, twice a second."""

    def __init__(self, blocked_s):
        self.blocked_s = blocked_s

    async def run(self):
        while True:
            await asyncio.sleep(0.5 - self.blocked_s)
            time.sleep(self.blocked_s)


@pytest.mark.parametrize("blocked_s", [0.0, 0.1], ids=["running", "blocked"])
def test_no_frame_of_five_thousand_is_lost_while_recording(bridge, flight, tmp_path, blocked_s):
    async def session():
        station = station_in(tmp_path)
        record, seen = station.sessions.raw, []

        def record_and_look(batch):
            record(batch)
            seen.append((station.clock(), batch.host_time_ns))

        station.sessions.raw = record_and_look
        running = asyncio.create_task(station.run())
        bridge.plug()
        await until(station, lambda: station.receiver.link.state.value == "streaming")
        blocking = asyncio.create_task(Blocker(blocked_s).run() if blocked_s else _nothing())
        before_s, start_s = time.process_time(), time.monotonic()
        await until(station, lambda: station.receiver.link.counts.frames > FRAMES)
        share = (time.process_time() - before_s) / (time.monotonic() - start_s)
        blocking.cancel()
        counts = replace(station.receiver.link.counts)
        theirs = bridge.counts()
        station.stop()
        await running
        latency_ns = np.concatenate([now_ns - stamps for now_ns, stamps in seen])
        return share, counts, theirs, latency_ns * 1e-6

    share, ours, theirs, latency_ms = asyncio.run(session())
    (path,) = tmp_path.glob("*.mcap")
    raw = open_recording(path, raw=True).raw
    sent = RecordedFlight(flight)
    rows = rows_of(sent.packets, raw.packets)
    np.testing.assert_array_equal(raw.packets, sent.packets[rows])
    late_ns = raw.host_time_ns - np.rint(sent._arrival_s[rows] * 1e9).astype(np.int64)
    late_ns -= late_ns.min()
    how = ", loop blocked 100 ms twice a second" if blocked_s else ""
    row = {
        "reader": f"ring of transfers, recording{how}",
        "frames": ours.frames,
        "lost": ours.lost,
        "cpu_pct": 100 * share,
        "stamp_spread_ms": float(late_ns.max()) * 1e-6,
        "latency_ms": [float(np.median(latency_ms)), float(np.percentile(latency_ms, 99))],
    }
    _note(row)
    assert ours.lost == theirs.lost == 0
    assert len(raw) >= ours.packets
    assert ours.packets > 1.99 * FRAMES
    assert late_ns.max() < STAMPS_WITHIN_NS


def test_device_read_for_comparison_loses_frames(bridge):
    """What pyusb's own read costs on the same bus: the reason for the ring."""
    from groundstation.links.usb import DEFAULT_DEVICE, BridgeDevice

    async def found():
        wanted = BridgeDevice(DEFAULT_DEVICE, "")
        bridge.plug()
        while (device := wanted.claim()) is None:
            await asyncio.sleep(0.1)
        return device

    device = asyncio.run(found())
    frames, before_s, start_s = 0, time.process_time(), time.monotonic()
    while frames < FRAMES:
        frames += len(device.read(0x81, 64 * FRAMES_A_CALL, 1000)) // 64
    share = (time.process_time() - before_s) / (time.monotonic() - start_s)
    theirs = bridge.counts()
    device.set_interface_altsetting(0, 0)
    _note(
        {
            "reader": f"Device.read, {FRAMES_A_CALL} frames a call",
            "frames": frames,
            "lost": theirs.dry,
            "cpu_pct": 100 * share,
            "stamp_spread_ms": None,
            "latency_ms": None,
        }
    )
    assert theirs.dry >= frames // FRAMES_A_CALL - 1


async def _nothing():
    pass


def _note(row):
    with (OUT / "table.jsonl").open("a") as file:
        file.write(json.dumps(row) + "\n")
