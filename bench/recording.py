"""How fast recordings are read and how little recording costs, with references beside them."""

from __future__ import annotations

import os
import tempfile
import threading
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.writer import Writer

from bench.table import Row
from groundstation.recording.mcap_reader import read_mcap
from groundstation.recording.mcap_records import RECORD
from groundstation.recording.mcap_scan import McapScan
from groundstation.recording.mcap_schemas import TOPICS
from groundstation.recording.mcap_writer import McapRecorder
from groundstation.recording.recording_file import RecordingFile, session_metadata
from groundstation.telemetry.packet import SAMPLE_TICKS, encode
from groundstation.telemetry.samples import RawBatch, SampleBatch, samples_from_packets

HOUR_SAMPLES = 1_800_000
COPIES = 4
_BLOCK = 25
"""Samples in 50 ms."""
_START_NS = 1_700_000_000_000_000_000
_LIVE_S = 20.0
_LIVE_STEP_S = 0.01
_FLUSH_NS = 200_000_000
_CHUNK_HEAD_BYTES = 40


def rows() -> list[Row]:
    """What, measured, reference in the same run, unit."""
    with tempfile.TemporaryDirectory() as folder:
        return [*_reading(Path(folder)), *_recording(Path(folder))]


def write_hour(path: Path, samples: int = HOUR_SAMPLES) -> None:
    """A recording as the daemon makes it: 50 ms messages, a chunk every 0.2 s."""
    out = RecordingFile(path, {"session": session_metadata("bench")})
    for number, (raw, decoded) in enumerate(_stream(samples, _BLOCK)):
        out.raw(raw)
        out.samples(decoded)
        if number % 4 == 3:
            out.file.flush()
    out.finish()


def _reading(folder: Path) -> Iterator[Row]:
    path = folder / "hour.mcap"
    write_hour(path)
    read_mcap(path)  # both readings below find the file in the page cache
    reference_s = _timed(lambda: _decompress_all(path))
    yield Row(
        "one hour read, decoded channel (bare decompression and checksums)",
        _timed(lambda: read_mcap(path)),
        reference_s,
        "s",
    )
    yield Row(
        "one hour read, packets too (the same)",
        _timed(lambda: read_mcap(path, raw=True)),
        reference_s,
        "s",
    )
    yield Row(
        "one hour on disk (its bare packets)",
        path.stat().st_size / 1e6,
        HOUR_SAMPLES * COPIES * 32 / 1e6,
        "MB",
    )


def _recording(folder: Path) -> Iterator[Row]:
    batches = list(_stream(round(_LIVE_S * 500), round(_LIVE_STEP_S * 500)))
    recorder = McapRecorder(folder / "live.mcap", {"session": session_metadata("bench")})
    thread = next(t for t in threading.enumerate() if t.name == "recorder")
    clock = time.pthread_getcpuclockid(thread.ident or 0)
    started_s, own_s, due_s = time.clock_gettime(clock), 0.0, time.monotonic()
    for raw, decoded in batches:
        before_s = time.thread_time()
        recorder.raw(raw)
        recorder.samples(decoded)
        own_s += time.thread_time() - before_s
        due_s += _LIVE_STEP_S
        time.sleep(max(0.0, due_s - time.monotonic()))
    writer_s = time.clock_gettime(clock) - started_s
    recorder.finish()
    reference_s = _bare_writer(folder / "live.mcap", folder / "bare.mcap")
    yield Row(
        "recorder thread at line rate (mcap's own writer)",
        100 * writer_s / _LIVE_S,
        100 * reference_s / _LIVE_S,
        "% of a core",
    )
    yield Row(
        "recorder in its caller (its thread)",
        100 * own_s / _LIVE_S,
        100 * writer_s / _LIVE_S,
        "% of a core",
    )


def _bare_writer(recorded: Path, path: Path) -> float:
    """CPU seconds of mcap's own writer for the same payloads, flushed as often."""
    with McapScan(recorded) as scan:
        messages = [
            (channel, log_ns, bytes(payload)) for channel, log_ns, _, payload in scan.messages()
        ]
    before_s = time.thread_time()
    with path.open("xb") as file:
        writer = Writer(file, chunk_size=256 * 1024, enable_data_crcs=True)
        writer.start()
        for topic in TOPICS.values():
            writer.register_channel(topic.name, topic.message_encoding, 0)
        flushed_ns = messages[0][1]
        for channel, log_ns, payload in messages:
            if log_ns - flushed_ns > _FLUSH_NS:
                writer.flush()
                os.fdatasync(file.fileno())
                flushed_ns = log_ns
            writer.add_message(channel, log_ns, payload, log_ns)
        writer.finish()
    return time.thread_time() - before_s


def _decompress_all(path: Path) -> None:
    """The least any checked reader does: decompress each chunk, CRC it, drop it."""
    decompress = zstandard.ZstdDecompressor().decompress
    data = path.read_bytes()
    view = memoryview(data)
    offset, total = 8, 0
    while offset < len(data) - 8:
        opcode, length = RECORD.unpack_from(data, offset)
        offset += RECORD.size
        if opcode == Opcode.CHUNK:
            content = decompress(view[offset + _CHUNK_HEAD_BYTES + 4 : offset + length])
            assert zlib.crc32(content) == int.from_bytes(view[offset + 24 : offset + 28], "little")
            total += len(content)
        offset += length
    assert total


def _stream(samples: int, block: int) -> Iterator[tuple[RawBatch, SampleBatch]]:
    """A flight's entropy: slow signals with the sensors' noise, four copies of each packet."""
    random = np.random.default_rng(3)
    for first in range(0, samples, block):
        index = np.arange(first, min(first + block, samples))
        rows = len(index)
        slow = np.sin(index[:, None] * np.array([0.003, 0.004, 0.005]))
        ticks = np.rint(index * SAMPLE_TICKS).astype(np.int64)
        packets = encode(
            ticks,
            3700 + random.integers(-5, 5, rows),
            (380 + random.integers(-30, 30, (rows, 4))) * 8,
            np.rint(400 * slow + random.normal(0, 30, (rows, 3))).astype(int),
            np.rint(500 * slow + random.normal(0, 400, (rows, 3))).astype(int),
            np.rint(900 * slow + random.normal(0, 3, (rows, 3))).astype(int),
            np.zeros(rows, int),
        )
        host = _START_NS + index * 2_000_000
        stamps = (host[:, None] + np.arange(COPIES) * 500_000).reshape(-1)
        decoded = samples_from_packets(
            packets, ticks, host, np.zeros(rows, np.int32), np.full(rows, COPIES, np.uint8)
        )
        yield RawBatch(np.repeat(packets, COPIES, axis=0), stamps), decoded


def _timed(work: object) -> float:
    assert callable(work)
    before_s = time.perf_counter()
    work()
    return time.perf_counter() - before_s


if __name__ == "__main__":
    for what, measured, reference, unit in rows():
        print(f"{what:28} {measured:10.3f} {reference:10.3f} {unit}")
