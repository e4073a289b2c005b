"""Framing on a byte stream: what was sent, or nothing."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from groundstation.telemetry.packet import DELIMITER, STUFFED_BYTES, Deframer, crc16, frame_packets
from groundstation.telemetry.packet import SERIAL_FRAME_BYTES as FRAME_BYTES

packets_of_any_content = hnp.arrays(
    np.uint8,
    st.tuples(st.integers(1, 20), st.just(32)),
    elements=st.one_of(st.just(0), st.integers(0, 255)),
)
LARGE = 10_000_000
DOCUMENT = Path(__file__).parents[2] / "docs" / "hardware.md"


def same(got, expected):
    np.testing.assert_array_equal(got, expected)


def cobs_by_the_paper(block):
    """The encoder of the paper's listing, byte by byte."""
    out, code_at, code = bytearray(1), 0, 1
    for byte in block:
        if byte == 0:
            out[code_at] = code
            code_at, code = len(out), 1
            out.append(0)
        else:
            out.append(byte)
            code += 1
    out[code_at] = code
    return bytes(out)


def crc_by_its_definition(data):
    """One bit at a time."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x1021 if crc & 0x8000 else 0)
            crc &= 0xFFFF
    return crc


def random_packets(rng, count):
    """Half of the bytes are zero, as in packets where little happens."""
    return rng.integers(0, 256, (count, 32), np.uint8) * rng.integers(0, 2, (count, 32), np.uint8)


def test_the_checksum_has_the_catalogues_check_value():
    assert crc16(b"123456789") == 0x29B1


@given(st.binary(max_size=64))
def test_the_checksum_is_the_one_of_the_definition(data):
    assert crc16(data) == crc_by_its_definition(data)


def test_a_frame_typed_by_hand():
    packet = np.zeros((1, 32), np.uint8)
    packet[0, :3] = 0x11, 0x00, 0x22
    crc = crc_by_its_definition(packet.tobytes())
    low, high = crc & 0xFF, crc >> 8
    expected = bytes([2, 0x11, 2, 0x22, *[1] * 28, 1 + 2, low, high, 0])
    assert low
    assert high
    assert frame_packets(packet) == expected


def test_the_packet_and_frame_printed_in_the_documentation_belong_together():
    blocks = DOCUMENT.read_text().split("```\n")
    (packet,) = [block for block in blocks if block.startswith("06 24")]
    (frame,) = [block for block in blocks if block.endswith(" 00\n")]
    packets = np.frombuffer(bytes.fromhex(packet), np.uint8).reshape(1, 32)
    assert frame_packets(packets) == bytes.fromhex(frame)


@given(packets_of_any_content)
def test_frames_are_cobs_of_the_packet_and_its_checksum(packets):
    stream = frame_packets(packets)
    assert len(stream) == len(packets) * FRAME_BYTES
    expected = b"".join(
        cobs_by_the_paper(packet.tobytes() + crc16(packet.tobytes()).to_bytes(2, "little"))
        + DELIMITER
        for packet in packets
    )
    assert stream == expected


@given(packets_of_any_content, st.lists(st.integers(0, 720), max_size=12))
def test_packets_come_back_however_the_stream_is_cut(packets, cuts):
    stream = frame_packets(packets)
    deframer = Deframer()
    edges = [0, *sorted(cuts), len(stream)]
    parts = [deframer.feed(stream[a:b]) for a, b in itertools.pairwise(edges)]
    same(np.concatenate(parts), packets)
    assert (deframer.frames, deframer.damaged) == (len(packets), 0)


def test_a_packet_is_given_out_with_its_last_byte_and_not_before():
    stream = frame_packets(np.full((1, 32), 7, np.uint8))
    deframer = Deframer()
    for byte in stream[:-1]:
        assert len(deframer.feed(bytes([byte]))) == 0
    assert len(deframer.feed(stream[-1:])) == 1


@given(packets_of_any_content, st.integers(0, FRAME_BYTES))
def test_a_reader_that_comes_in_the_middle_misses_what_was_under_way_only(packets, missed):
    deframer = Deframer()
    got = deframer.feed(frame_packets(packets)[missed:])
    same(got, packets[0 if missed == 0 else 1 :])
    assert deframer.damaged == 0


@example(np.full((1, 32), 7, np.uint8), 40, 3)
@given(packets_of_any_content, st.integers(0, 1 << 30), st.integers(0, 7))
def test_any_single_flipped_bit_costs_its_frame_and_at_most_the_next(packets, at, bit):
    before, after = np.full((2, 32), 9, np.uint8), np.full((2, 32), 5, np.uint8)
    packets = np.concatenate([before, packets, after])
    stream = bytearray(frame_packets(packets))
    at = at % (len(stream) - 2 * FRAME_BYTES) + FRAME_BYTES
    stream[at] ^= 1 << bit
    hit = at // FRAME_BYTES
    lost = [hit, hit + 1] if at % FRAME_BYTES == STUFFED_BYTES else [hit]
    deframer = Deframer()
    same(deframer.feed(bytes(stream)), np.delete(packets, lost, axis=0))
    assert deframer.damaged >= 1


@given(st.lists(st.binary(max_size=200)))
def test_any_bytes_are_taken_and_what_waits_is_bounded(parts):
    deframer = Deframer()
    for part in parts:
        assert deframer.feed(part).shape[1] == 32
        assert len(deframer._rest) <= FRAME_BYTES
    sound = np.full((1, 32), 3, np.uint8)
    same(deframer.feed(DELIMITER + frame_packets(sound))[-1:], sound)


def test_a_flood_without_a_delimiter_is_one_damaged_stretch():
    deframer = Deframer()
    deframer.feed(DELIMITER)
    for _ in range(100):
        deframer.feed(b"\x01" * 10_000)
        assert len(deframer._rest) <= FRAME_BYTES
    deframer.feed(DELIMITER)
    assert (deframer.frames, deframer.damaged) == (0, 1)


def test_zeros_in_a_row_are_no_damage():
    packets = np.full((3, 32), 3, np.uint8)
    deframer = Deframer()
    same(deframer.feed(DELIMITER * 5 + frame_packets(packets) + DELIMITER * 50), packets)
    assert deframer.damaged == 0


def test_ten_megabytes_of_noise_hold_no_packet():
    noise = np.random.default_rng(1).bytes(LARGE)
    deframer = Deframer()
    for at in range(0, LARGE, 4096):
        deframer.feed(noise[at : at + 4096])
    candidates = sum(len(part) == STUFFED_BYTES for part in noise.split(DELIMITER))
    assert candidates > 50  # of which 1 in 65536 would pass
    assert deframer.frames == 0
    assert deframer.damaged > LARGE / 300


def flip_a_bit(rng, data, at):
    data[at] ^= 1 << rng.integers(8)
    return data


def drop_a_byte(rng, data, at):
    return data[:at] + data[at + 1 :]


def insert_a_byte(rng, data, at):
    return data[:at] + rng.bytes(1) + data[at:]


def overwrite_a_burst(rng, data, at):
    length = int(rng.integers(1, 20))
    return data[:at] + rng.bytes(length) + data[at + length :]


def cut_a_burst_out(rng, data, at):
    return data[:at] + data[at + int(rng.integers(1, 20)) :]


@pytest.mark.parametrize(
    "damage", [flip_a_bit, drop_a_byte, insert_a_byte, overwrite_a_burst, cut_a_burst_out]
)
def test_two_megabytes_with_damage_give_every_frame_that_is_whole_and_no_other(damage):
    """Five kinds of 2 MB: 10 MB. Each damage is in a block of its own, with what it may reach.

    Every packet carries its number, so one that was never sent is known.
    """
    rng = np.random.default_rng(2)
    per_block, blocks = 12, LARGE // 5 // FRAME_BYTES // 12
    packets = random_packets(rng, blocks * per_block)
    packets[:, 28:] = np.arange(len(packets), dtype="<u4")[:, None].view(np.uint8)
    stream = []
    expected = np.ones(len(packets), bool)
    for block in range(blocks):
        rows = slice(block * per_block, (block + 1) * per_block)
        data = bytearray(frame_packets(packets[rows]))
        at = int(rng.integers(4 * FRAME_BYTES, 7 * FRAME_BYTES))
        changed = damage(rng, data.copy(), at)
        stream.append(bytes(changed))
        # of the frames a damage reaches, those stay whose bytes still stand between zeros
        stretches = bytes(changed).split(DELIMITER)
        for row in range(4, 9):
            frame = bytes(data[row * FRAME_BYTES : row * FRAME_BYTES + STUFFED_BYTES])
            expected[rows.start + row] = frame in stretches
    assert expected.mean() > 0.85  # resynchronised within a frame
    lost_at_once = np.diff(np.flatnonzero(np.diff(np.r_[1, expected, 1])))[::2]
    assert lost_at_once.max() <= 2

    data = b"".join(stream)
    deframer = Deframer()
    got = np.concatenate([deframer.feed(data[at : at + 4096]) for at in range(0, len(data), 4096)])
    numbers = got[:, 28:].copy().view("<u4")[:, 0]
    same(numbers, np.flatnonzero(expected))
    same(got, packets[expected])
    assert deframer.damaged >= blocks * 0.9
