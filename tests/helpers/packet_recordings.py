"""Recordings made of packets, for the tests of files and reports."""

from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from groundstation.recording.session import Recording
from groundstation.telemetry.packet import encode
from groundstation.telemetry.samples import RawBatch, samples_from_packets

STEADY = {
    "battery": 3700,
    "motors": [2400, 2408, 2416, 2424],
    "gyro": [16, -8, 4],
    "accelerometer": [20, -30, 4096],
    "angles": [100, -200, 300],
    "debug": 0,
}


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
