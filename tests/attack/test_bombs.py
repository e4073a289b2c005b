"""Small recordings that unpack to gigabytes: bounded in memory and time, and told as damage."""

import asyncio
import struct
import threading
import tracemalloc
import zlib

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import MCAP0_MAGIC

from groundstation.links.base import LinkState
from groundstation.links.replay import FAST, PIECE, ReplayLink
from groundstation.recording import mcap_reader
from groundstation.recording.mcap_file import McapRecorder
from groundstation.recording.mcap_scan import McapScan
from groundstation.telemetry.packet import PACKET_BYTES
from groundstation.telemetry.samples import RawBatch

pytestmark = pytest.mark.timeout(60)
PACK = {
    b"lz4": lz4.frame.compress,
    b"zstd": zstandard.ZstdCompressor().compress,
}
TINY = struct.pack("<BQHIQQ", 5, 22, 1, 0, 7, 7)
"""A message of no bytes on channel 1."""


def record(kind, body):
    return struct.pack("<BQ", kind, len(body)) + body


def chunk(name, content, *, claimed=None):
    packed = PACK[name](content)
    size = len(content) if claimed is None else claimed
    head = struct.pack("<QQQI", 7, 7, size, zlib.crc32(content))
    return record(6, head + struct.pack("<I", len(name)) + name
                  + struct.pack("<Q", len(packed)) + packed)  # fmt: skip


def write(path, *chunks):
    header = record(1, struct.pack("<I", 0) + struct.pack("<I", 0))
    path.write_bytes(MCAP0_MAGIC + header + b"".join(chunks))
    return path


def read(path):
    """Messages and damage of a file, and the most memory taken in MiB."""
    tracemalloc.start()
    with McapScan(path) as scan:
        messages = sum(1 for _ in scan.messages())
    most = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    return messages, [damage.reason for damage in scan.damage], most


def test_lz4_gives_no_more_than_the_file_declares(tmp_path):
    path = write(tmp_path / "bomb.mcap", chunk(b"lz4", b"\0" * (64 << 20), claimed=100))
    _, damage, most_mb = read(path)
    assert "a chunk's checksum does not match" in damage
    assert most_mb < 32


@pytest.mark.parametrize("name", PACK)
def test_chunks_that_unpack_to_thousands_of_times_the_file_are_damage(tmp_path, name):
    path = write(tmp_path / "bomb.mcap", chunk(name, TINY * (64 * 2**20 // len(TINY))))
    messages, damage, most_mb = read(path)
    assert messages == 0
    assert any("times the file" in reason for reason in damage)
    assert most_mb < 32


def test_a_file_of_many_small_bombs_is_bounded_too(tmp_path):
    bomb = chunk(b"zstd", TINY * (2**20 // len(TINY)))
    path = write(tmp_path / "bombs.mcap", *[bomb] * 100)
    messages, damage, most_mb = read(path)
    assert any("times the file" in reason for reason in damage)
    assert most_mb < 32
    assert messages * len(TINY) < 5 * 2**20 + 64 * path.stat().st_size


def test_a_constant_signal_is_no_bomb(tmp_path):
    path = tmp_path / "constant.mcap"
    times = np.arange(60_000) * 2_000_000 + 1_700_000_000_000_000_000
    with McapRecorder(path, {}, low_space_bytes=0) as recorder:
        recorder.raw(RawBatch(np.zeros((len(times), PACKET_BYTES), np.uint8), times))
    assert read(path)[1] == []


def test_a_replay_unpacks_where_it_holds_up_nobody(tmp_path, monkeypatch):
    path = tmp_path / "long.mcap"
    times = np.arange(3 * PIECE) * 500_000 + 1_700_000_000_000_000_000
    packets = np.random.default_rng(0).integers(0, 255, (len(times), PACKET_BYTES), np.uint8)
    with McapRecorder(path, {}, low_space_bytes=0) as recorder:
        recorder.raw(RawBatch(packets, times))
    threads = set()

    class Watched(McapScan):
        def messages(self):
            for message in super().messages():
                threads.add(threading.current_thread())
                yield message

    monkeypatch.setattr(mcap_reader, "McapScan", Watched)

    async def replay():
        link, received = ReplayLink(path, speed=FAST), 0
        async with link:
            while link.state is not LinkState.ENDED and received < len(times):
                batch = await link.read()
                received += 0 if batch is None else len(batch)
        return received

    assert asyncio.run(replay()) == len(times)
    assert threads
    assert threading.main_thread() not in threads
