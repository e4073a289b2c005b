"""Made flights for the tests of recordings: every value follows from the sample's number."""

import struct

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from groundstation.recording.recording_file import RecordingFile
from groundstation.telemetry.packet import SAMPLE_TICKS, encode
from groundstation.telemetry.samples import (
    COLUMNS,
    RawBatch,
    SampleBatch,
    empty_samples,
    samples_from_packets,
)

START_NS = 1_700_000_000_000_000_000
COPIES = 4


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
