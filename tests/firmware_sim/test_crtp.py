"""CRTP without a network: what each packet is answered with."""

from __future__ import annotations

import errno
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim.contents import PARAMETERS, VARIABLES
from firmware_sim.crtp import MAX_DATA, Conversation
from support.plant import craft_after


@pytest.fixture(scope="module")
def craft():
    stand_in = craft_after(3.0, program="wait", plant="reduced")
    return stand_in


@pytest.fixture
def client(craft):
    return Conversation(craft)


def identity(name: str) -> int:
    return [n for n, *_ in (*PARAMETERS,)].index(name)


def variable(name: str) -> int:
    return [n for n, *_ in VARIABLES].index(name)


@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=80))
def test_no_datagram_raises_and_every_answer_is_a_packet(craft, datagram):
    for answer in Conversation(craft).answer(datagram):
        assert 1 <= len(answer) <= MAX_DATA + 1


@settings(max_examples=200, deadline=None)
@given(st.sampled_from([0x2C, 0x2D, 0x2E, 0x5C, 0x5D, 0x4C, 0xFC, 0xFD]), st.binary(max_size=30))
def test_no_body_of_a_known_header_raises(craft, header, body):
    client = Conversation(craft)
    for _ in range(2):
        for answer in client.answer(bytes([header]) + body):
            assert 1 <= len(answer) <= MAX_DATA + 1
    client.due(craft.uptime_ms + 300)


def test_the_link_service_marks_protocol_1_with_zeros(client):
    source = client.answer(b"\xfd\x00")[0]
    assert source == b"\xfd" + bytes(30)
    assert client.answer(b"\xfc\x00\x01\x02") == [b"\xfc\x00\x01\x02"]


def test_a_scan_finds_the_craft(client):
    assert client.answer(b"\xff") == [b"\xff"]


@pytest.mark.parametrize(("port", "which", "tail"), [(0x2C, "parameter", 0), (0x5C, "log", 2)])
def test_a_table_of_contents_lists_every_item(client, port, which, tail):
    items = getattr(client.contents, f"{which}_items")
    (info,) = client.answer(bytes([port, 1]))
    assert info[1:3] == bytes([1, len(items)])
    assert len(info) == 1 + 2 + 4 + tail
    for number, item in enumerate(items):
        (answer,) = client.answer(bytes([port, 0, number]))
        assert answer == bytes([port, 0, number]) + item
    assert client.answer(bytes([port, 0, 200])) == [bytes([port, 0])]


def test_every_gain_can_be_read_and_written(client):
    for number, (name, kind) in enumerate(PARAMETERS):
        value = struct.pack("<B", 17) if kind == 8 else struct.pack("<f", 1.5)
        assert client.answer(bytes([0x2E, number]) + value) == [bytes([0x2E, number]) + value], name
        assert client.answer(bytes([0x2D, number])) == [bytes([0x2D, number]) + value], name


def test_an_unknown_parameter_is_answered_with_an_error(client):
    assert client.answer(b"\x2d\xc8") == [bytes([0x2D, 0xFF, 0xC8, errno.ENOENT])]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_value_that_is_no_number_changes_nothing(client, value):
    number = identity("pid_rate.roll_kp")
    (before,) = client.answer(bytes([0x2D, number]))
    (answer,) = client.answer(bytes([0x2E, number]) + struct.pack("<f", value))
    assert answer[1:] == before[1:]


def test_a_setpoint_reaches_the_commander(client, craft):
    client.answer(b"\x30" + struct.pack("<fffH", 3.0, -2.0, 10.0, 20000))
    assert craft._firmware[0]["setpoint"].tolist() == [3.0, -2.0, 10.0]
    for bad in (
        b"\x30",
        b"\x30" + bytes(13),
        b"\x30" + struct.pack("<fffH", float("nan"), 0, 0, 1),
    ):
        assert client.answer(bad) == []
    assert craft._firmware[0]["setpoint_thrust"] == 20000


def block(client, number, *names, kind=7):
    body = b"".join(bytes([kind, variable(name)]) for name in names)
    return client.answer(bytes([0x5D, 0, number]) + body)[0][3]


def test_a_log_block_is_sent_at_its_period_with_the_live_values(client, craft):
    assert block(client, 4, "pm.vbat", "stabilizer.roll") == 0
    assert client.answer(bytes([0x5D, 3, 4, 2])) == [bytes([0x5D, 3, 4, 0])]
    start = craft.uptime_ms
    packets = [packet for now in range(start, start + 200) for packet in client.due(now)]
    stamps = [int.from_bytes(packet[2:5], "little") for packet in packets]
    assert stamps == list(range(start + 20, start + 200, 20))
    header, number = packets[0][:2]
    assert (header, number) == (0x52, 4)
    battery, roll = struct.unpack("<ff", packets[0][5:])
    assert battery == pytest.approx(craft.state().battery_v)
    assert roll == pytest.approx(craft.state().angles_deg[0])
    assert client.answer(bytes([0x5D, 4, 4])) == [bytes([0x5D, 4, 4, 0])]
    assert client.due(start + 1000) == []


def test_a_variable_is_sent_as_the_type_that_was_asked_for(client, craft):
    assert block(client, 1, "pm.vbat", kind=2) == 0
    client.answer(bytes([0x5D, 3, 1, 1]))
    (packet,) = client.due(craft.uptime_ms + 11)
    assert struct.unpack("<H", packet[5:]) == (4,)


def test_log_errors_are_those_of_the_firmware(client):
    assert block(client, 1, "gyro.x") == 0
    assert block(client, 1, "gyro.x") == errno.EEXIST
    assert client.answer(bytes([0x5D, 3, 9, 1]))[0][3] == errno.ENOENT
    assert client.answer(bytes([0x5D, 0, 2, 7, 99]))[0][3] == errno.ENOENT
    assert block(client, 2, *["gyro.x"] * 7) == errno.E2BIG
    for number in range(2, 9):
        assert block(client, number, "gyro.x") == 0
    assert block(client, 9, "gyro.x") == errno.ENOMEM
    assert client.answer(bytes([0x5D, 77, 1]))[0][3] == errno.ENOEXEC
    assert client.answer(b"\x5d\x05") == [b"\x5d\x05\x00\x00"]
    assert block(client, 9, "gyro.x") == 0


def test_appending_to_a_block_keeps_its_order(client, craft):
    assert block(client, 1, "gyro.x") == 0
    append = bytes([0x5D, 1, 1, 7, variable("acc.z")])
    assert client.answer(append) == [bytes([0x5D, 1, 1, 0])]
    client.answer(bytes([0x5D, 3, 1, 1]))
    (packet,) = client.due(craft.uptime_ms + 11)
    assert len(packet) == 5 + 8
