"""Made flights for the tests of recordings, whose every value follows from the sample's number; and
an adversarial radio and host for the decoder's: it knows the truth and shares no code with the
decoder beyond the packet codec.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from groundstation.recording.mcap_file import RecordingFile
from groundstation.recording.session import Recording
from groundstation.telemetry.packet import (
    ACCELEROMETER_M_S2,
    ANGLE_RAD,
    GYRO_RAD_S,
    SAMPLE_TICKS,
    encode,
)
from groundstation.telemetry.samples import (
    COLUMNS,
    RawBatch,
    SampleBatch,
    empty_samples,
    samples_from_packets,
)

START_NS = 1_700_000_000_000_000_000
COPIES = 4
STEADY = {
    "battery": 3700,
    "motors": [2400, 2408, 2416, 2424],
    "gyro": [16, -8, 4],
    "accelerometer": [20, -30, 4096],
    "angles": [100, -200, 300],
    "debug": 0,
}
WOBBLING_NS = 1_760_000_000_000_000_000


def flight(first, rows):
    """Samples ``first`` .. ``first + rows`` of a flight: packets in four copies, and decoded."""
    index = np.arange(first, first + rows)
    ticks = np.rint(index * SAMPLE_TICKS).astype(np.int64)
    noise = (index[:, None] * np.array([7919, 104729, 1299709, 15485863])) % 1999 - 1000
    packets = encode(
        ticks,
        3700 - index // 500 % 700,
        (noise + 2000) // 8 * 8,
        noise[:, :3],
        noise[:, 1:4] * 3,
        noise[:, :3] // 2,
        index,
    )
    host = START_NS + index * 2_000_000
    raw_host = (host[:, None] + np.arange(COPIES) * 500_000).reshape(-1)
    decoded = samples_from_packets(
        packets, ticks, host, np.zeros(rows, np.int32), np.full(rows, COPIES, np.uint8)
    )
    return RawBatch(np.repeat(packets, COPIES, axis=0), raw_host), decoded


def record_flight(recorder, rows, batch=5, first=0):
    """Give ``rows`` samples to a recorder in batches as a live link would deliver them."""
    for start in range(first, first + rows, batch):
        raw, decoded = flight(start, min(batch, first + rows - start))
        recorder.raw(raw)
        recorder.samples(decoded)


def assert_same_samples(got, expected):
    """Equal to the last bit, NaN included."""
    assert len(got) == len(expected)
    assert got.tick_s == expected.tick_s
    for name in COLUMNS:
        one, other = getattr(got, name), getattr(expected, name)
        assert one.dtype == other.dtype, name
        np.testing.assert_array_equal(one, other, err_msg=name)


def assert_same_packets(got, expected):
    np.testing.assert_array_equal(got.packets, expected.packets)
    np.testing.assert_array_equal(got.host_time_ns, expected.host_time_ns)


@st.composite
def sample_batches(draw, max_rows=40, tick_s=None):
    """Any samples, also ones that no packet could carry."""
    rows = draw(st.integers(1, max_rows))
    batch = empty_samples(
        rows, draw(st.sampled_from([1e-6, 73e-6 / 72])) if tick_s is None else tick_s
    )
    columns = {}
    for name in COLUMNS:
        like = getattr(batch, name)
        if like.dtype == np.int64:
            elements = st.integers(0, 2**62)
        elif like.dtype.kind in "iu":
            limits = np.iinfo(like.dtype)
            elements = st.integers(int(limits.min), int(limits.max))
        else:
            elements = st.floats(width=32)
        columns[name] = draw(hnp.arrays(like.dtype, like.shape, elements=elements))
    if draw(st.booleans()):
        columns["rotor_rev_s"] = np.full((rows, 4), np.nan, np.float32)
        columns["duty_step"] = np.full((rows, 4), np.nan, np.float32)
    return SampleBatch(**columns, tick_s=batch.tick_s)


@st.composite
def raw_batches(draw, max_rows=40):
    rows = draw(st.integers(1, max_rows))
    return RawBatch(
        draw(hnp.arrays(np.uint8, (rows, 32))),
        draw(hnp.arrays(np.int64, rows, elements=st.integers(0, 2**62))),
    )


def write_flight(path, rows, *, metadata=None, chunk_rows=25, finish=True):
    """A recording of ``rows`` samples in chunks of ``chunk_rows``, finished or as if killed."""
    out = RecordingFile(path, {"session": {"link": "made"}} if metadata is None else metadata)
    for start in range(0, rows, chunk_rows):
        raw, decoded = flight(start, min(chunk_rows, rows - start))
        out.raw(raw)
        out.samples(decoded)
        out.entry("/link/events", {"time_ns": int(raw.host_time_ns[0]), "number": start})
        out.file.flush()
    if finish:
        out.finish()
    else:
        out.file.abandon()


def records(data):
    """Offset, opcode and end of every record of an undamaged MCAP file."""
    offset = len(MCAP0_MAGIC)
    while offset < len(data) - len(MCAP0_MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        yield offset, opcode, offset + 9 + length
        offset += 9 + length


def chunks(data):
    """Start and end of every chunk of an MCAP file that is whole up to its end."""
    whole = data if data.endswith(MCAP0_MAGIC) else data + MCAP0_MAGIC
    return [(start, end) for start, opcode, end in records(whole) if opcode == Opcode.CHUNK]


def packet_recording(ticks, *, host_time_ns=None, segment=None, kind="csv", **counts) -> Recording:
    """One packet per tick; ``counts`` replace fields of ``STEADY``, broadcast over the rows."""
    ticks = np.asarray(ticks, np.int64)
    fields = {}
    for name, value in {**STEADY, **counts}.items():
        value = np.asarray(value)
        width = () if name in ("battery", "debug") else value.shape[-1:]
        fields[name] = np.broadcast_to(value, (len(ticks), *width))
    packets = encode(timestamp=ticks, **fields)
    host = np.zeros(len(ticks), np.int64) if host_time_ns is None else host_time_ns
    samples = samples_from_packets(
        packets,
        ticks,
        host,
        np.zeros(len(ticks), np.int32) if segment is None else np.asarray(segment, np.int32),
        np.ones(len(ticks), np.uint8),
    )
    return Recording(Path("made.csv"), kind, samples, RawBatch(packets, host))


@st.composite
def packet_recordings(draw, max_rows=30):
    """Any packets with unwrapped timestamps that may run backwards."""
    rows = draw(st.integers(1, max_rows))
    raw = draw(hnp.arrays(np.uint8, (rows, 32)))
    wraps = draw(hnp.arrays(np.int64, rows, elements=st.integers(0, 2**30)))
    ticks = raw[:, :2].copy().view("<u2")[:, 0].astype(np.int64) + wraps * 65536
    host = np.zeros(rows, np.int64)
    samples = samples_from_packets(
        raw, ticks, host, np.zeros(rows, np.int32), np.ones(rows, np.uint8)
    )
    return Recording(Path("any.csv"), "csv", samples, RawBatch(raw, host))


def _wobble(rows: int, first: int = 0) -> SampleBatch:
    """A craft that rolls, pitches and yaws, in whole counts of the packet, four copies each."""
    number = np.arange(first, first + rows)
    time_s = number * 0.002
    samples = empty_samples(rows)
    samples.ticks[:] = np.rint(number * 1972.603) + 700
    samples.host_time_ns[:] = WOBBLING_NS + number * 2_000_000
    samples.copies[:] = 4
    samples.debug[:] = number * 7919
    angles = np.stack([20 * np.sin(2 * time_s), 12 * np.cos(1.3 * time_s), 60 * np.sin(time_s)], 1)
    samples.attitude[:] = np.rint(angles * 100) * np.float32(ANGLE_RAD)
    rates = np.gradient(angles, 0.002, axis=0) if rows > 1 else np.zeros((rows, 3))
    samples.gyro[:] = np.rint(rates * 16.384) * np.float32(GYRO_RAD_S)
    pulls = np.stack([0.1 * np.sin(time_s), 0.1 * np.cos(time_s), 1 + 0.1 * np.sin(3 * time_s)], 1)
    samples.accelerometer[:] = np.rint(pulls * 4096) * np.float32(ACCELEROMETER_M_S2)
    samples.duty[:] = np.rint(512 * (0.6 + 0.1 * np.sin(time_s[:, None] + np.arange(4)))) / 512
    samples.battery_v[:] = np.float32(3.9) - np.rint(10 * time_s).astype(np.float32) / 1000
    return samples


@pytest.fixture
def wobble() -> Callable[..., SampleBatch]:
    """wobble(rows, first=0): that part of an endless flight at 500 Hz."""
    return _wobble


@pytest.fixture(name="flight")
def wobbling_flight() -> Recording:
    """Eight seconds with two segments, events, statistics, a command and a table."""
    samples = _wobble(4000)
    samples.segment[2500:] = 1
    samples.ticks[2500:] -= samples.ticks[2500] - 40  # the craft restarted: its clock did too
    samples.host_time_ns[2500:] += 1_500_000_000
    return Recording(
        path=Path("flight.mcap"),
        kind="mcap",
        samples=samples,
        events=[
            {"time_ns": WOBBLING_NS - 10**8, "link": "usb", "kind": "opening", "text": "opening"},
            {"time_ns": WOBBLING_NS + 10**9, "link": "usb", "kind": "lost", "text": "unplugged"},
        ],
        statistics=[
            {
                "time_ns": WOBBLING_NS + second * 10**9,
                "loss_pct": 0.5 * second,
                "latency_ms": 8.25 - second,
                "rate_hz": 500.0 - second % 3,
            }
            for second in range(9)
        ]
        + [{"time_ns": WOBBLING_NS + 9 * 10**9, "loss_pct": 0.0, "bursts": [1, 4]}],
        commands=[{"time_ns": WOBBLING_NS + 10**9, "roll_deg": 2.5, "direction": "out"}],
        metadata={"session": {"link": "usb"}, "vehicle": {"name": "crazyflie1"}},
    )


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
