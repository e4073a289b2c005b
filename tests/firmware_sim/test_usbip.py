"""The emulated bridge on the wire: what a kernel asks and what it gets, in time it is told."""

import contextlib
import errno
import socket
import struct
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from usb_device import Fault, FaultKind, UsbBridge
from usbip import UsbIpSession, main, serve_tcp

from groundstation.telemetry.bridge_usb import (
    ALTERNATE,
    ENDPOINT,
    FRAME_BYTES,
    configuration_descriptor,
    device_descriptor,
)

FRAMES = 8
NOW_S = 1000.0


class Numbered:
    """Two packets a frame; each is full of the number of its frame."""

    def __init__(self):
        self.frame = 0

    def advance(self, until_s):
        end = int(until_s * 1e3)
        frames = np.repeat(np.arange(self.frame, end), 2)
        self.frame = max(self.frame, end)
        packets = np.repeat((frames % 251).astype(np.uint8)[:, None], 32, axis=1)
        return packets, (frames + 1) * 1e-3


class Host:
    """Speaks USB/IP as the kernel does."""

    def __init__(self, faults=()):
        self.bridge = UsbBridge(Numbered(), faults=faults)
        self.session = UsbIpSession(self.bridge)
        self.tag = 0
        self.now_s = NOW_S

    def control(self, kind, request, value=0, index=0, length=0):
        self.tag += 1
        head = struct.pack(">IIIIIIiiii", 1, self.tag, 2, kind >> 7, 0, 0, length, 0, 0, 0)
        setup = struct.pack("<BBHHH", kind, request, value, index, length)
        reply = self.session.take(head + setup, self.now_s)
        command, tag, _, _, _, status, size = struct.unpack_from(">IIIIIii", reply)
        assert (command, tag) == (3, self.tag)
        assert len(reply) == 48 + size
        return status, reply[48:]

    def listen(self):
        assert self.control(0x00, 9, 1)[0] == 0
        assert self.control(0x01, 11, ALTERNATE)[0] == 0

    def submit(self):
        self.tag += 1
        size = FRAMES * FRAME_BYTES
        head = struct.pack(">IIIIIIiiii8x", 1, self.tag, 2, 1, 1, 2, size, 0, FRAMES, 1)
        rows = b"".join(
            struct.pack(">IIII", at * FRAME_BYTES, FRAME_BYTES, 0, 0) for at in range(FRAMES)
        )
        assert self.session.take(head + rows, self.now_s) == b""
        return self.tag

    def unlink(self, tag):
        self.tag += 1
        head = struct.pack(">IIIIII24x", 2, self.tag, 2, 0, 0, tag)
        reply = self.session.take(head, self.now_s)
        assert struct.unpack_from(">II", reply) == (4, self.tag)
        return struct.unpack_from(">i", reply, 20)[0]

    def after(self, ms):
        """Transfers that complete in so many milliseconds: tag, status, start and frames."""
        self.now_s += ms * 1e-3
        data = self.session.complete(self.now_s)
        done = []
        while data:
            command, tag, _, _, _, status, size, start, packets, _ = struct.unpack_from(
                ">IIIIIiiiii", data
            )
            assert command == 3
            content, rows = data[48 : 48 + size], data[48 + size : 48 + size + 16 * packets]
            frames, at = [], 0
            for offset, length, actual, fault in struct.iter_unpack(">IIIi", rows):
                assert offset == len(frames) * FRAME_BYTES
                assert length == FRAME_BYTES
                frames.append((content[at : at + actual], fault))
                at += actual
            assert at == size
            done.append((tag, status, start, frames))
            data = data[48 + size + 16 * packets :]
        return done


@pytest.fixture
def host():
    host = Host()
    host.listen()
    return host


def full(frame):
    return bytes([frame % 251]) * FRAME_BYTES, 0


def test_the_descriptors_are_what_was_declared():
    host = Host()
    assert host.control(0x80, 6, 0x0100, length=18) == (0, device_descriptor())
    assert host.control(0x80, 6, 0x0200, length=9) == (0, configuration_descriptor()[:9])
    assert host.control(0x80, 6, 0x0200, length=255) == (0, configuration_descriptor())
    assert len(configuration_descriptor()) == configuration_descriptor()[2] == 34
    status, text = host.control(0x80, 6, 0x0303, 0x0409, 255)
    assert (status, text[2:].decode("utf-16-le")) == (0, "stand-in")


@pytest.mark.parametrize(
    "request_",
    [(0x80, 6, 0x0600), (0x80, 6, 0x0F00), (0x80, 6, 0x0309), (0x01, 11, 2), (0x40, 1, 0)],
)
def test_what_a_full_speed_bridge_does_not_have_is_stalled(request_):
    length = 64 if request_[0] & 0x80 else 0
    assert Host().control(*request_, length=length) == (-errno.EPIPE, b"")


def test_configuration_and_setting_are_kept(host):
    assert host.control(0x80, 8, length=1) == (0, b"\x01")
    assert host.control(0x81, 10, length=1) == (0, bytes([ALTERNATE]))
    assert host.control(0x82, 0, index=ENDPOINT, length=2) == (0, b"\0\0")


def test_transfers_follow_each_other_without_a_gap(host):
    tags = [host.submit() for _ in range(3)]
    assert host.after(8) == []  # the stream begins with the next frame
    done = host.after(17)
    assert [tag for tag, *_ in done] == tags
    starts = [start for _, _, start, _ in done]
    assert starts == [starts[0], starts[0] + 8, starts[0] + 16]
    for _, status, start, frames in done:
        assert status == 0
        assert frames == [full(start + at) for at in range(FRAMES)]
    assert host.bridge.counts.good == 24
    assert host.bridge.counts.lost == 0


@given(away_ms=st.integers(1, 400))
def test_a_dry_queue_drops_the_frames_in_between_and_counts_them(away_ms):
    host = Host()
    host.listen()
    host.submit()
    ((_, _, first, _),) = host.after(9)
    host.after(away_ms)
    host.submit()
    ((_, _, second, frames),) = host.after(10)
    assert host.bridge.counts.dry == second - first - FRAMES
    assert abs(host.bridge.counts.dry - away_ms - 1) <= 1
    assert host.bridge.counts.packets_lost == 2 * host.bridge.counts.dry
    assert frames[0] == full(second)


def test_a_transfer_taken_back_is_not_completed_and_a_completed_one_not_taken_back(host):
    first, second, third = (host.submit() for _ in range(3))
    assert host.unlink(second) == -errno.ECONNRESET
    assert [tag for tag, *_ in host.after(40)] == [first, third]
    assert host.unlink(first) == 0


def test_after_everything_was_taken_back_nobody_listens_and_nothing_is_lost(host):
    tags = [host.submit() for _ in range(4)]
    assert [host.unlink(tag) for tag in tags] == [-errno.ECONNRESET] * 4
    host.after(500)
    host.submit()
    assert len(host.after(10)) == 1
    assert host.bridge.counts.lost == 0


@pytest.mark.parametrize(
    ("kind", "status", "length"),
    [
        (FaultKind.SHORT, 0, 40),
        (FaultKind.CRC, -errno.EILSEQ, 64),
        (FaultKind.PROTOCOL, -errno.EPROTO, 0),
        (FaultKind.MISSED, -errno.EXDEV, 0),
        (FaultKind.OVERRUN, -errno.EOVERFLOW, 64),
        (FaultKind.PIPE, -errno.EPIPE, 0),
    ],
)
def test_a_fault_hits_its_frame_alone(kind, status, length):
    host = Host([Fault(3, kind, 40)])
    host.listen()
    host.submit()
    ((_, overall, start, frames),) = host.after(10)
    assert overall == 0
    content, told = frames.pop(3)
    assert (told, len(content)) == (status, length)
    assert frames == [full(start + at) for at in (0, 1, 2, 4, 5, 6, 7)]
    assert host.bridge.counts.faulty == {kind: 1}
    assert host.bridge.counts.packets_lost == 2


def test_a_stall_fails_every_transfer_until_the_host_clears_it():
    host = Host([Fault(10, FaultKind.STALL)])
    host.listen()
    for _ in range(3):
        host.submit()
    done = host.after(17)
    assert [status for _, status, *_ in done] == [0, -errno.EPIPE, -errno.EPIPE]
    assert host.control(0x82, 0, index=ENDPOINT, length=2) == (0, b"\1\0")
    host.submit()
    assert [status for _, status, *_ in host.after(1)] == [-errno.EPIPE]
    assert host.control(0x02, 1, 0, ENDPOINT) == (0, b"")
    host.submit()
    ((_, status, start, frames),) = host.after(10)
    assert status == 0
    assert host.bridge.counts.halted == start - done[1][2]
    assert frames[0] == full(start)


def test_an_unplugged_bridge_says_nothing_more():
    host = Host([Fault(9, FaultKind.UNPLUG)])
    host.listen()
    for _ in range(3):
        host.submit()
    assert len(host.after(100)) == 1
    assert not host.bridge.plugged


def test_faults_behind_an_unplugging_are_those_of_the_next_stream():
    faults = [Fault(9, FaultKind.UNPLUG), Fault(2, FaultKind.CRC), Fault(8, FaultKind.UNPLUG)]
    host = Host(faults)
    for clean in (True, False):
        host.bridge.plug()
        host.listen()
        for _ in range(3):
            host.submit()
        ((_, _, _, frames),) = host.after(100)
        assert [status == 0 for _, status in frames] == [clean or at != 2 for at in range(FRAMES)]
        assert not host.bridge.plugged


@given(cuts=st.lists(st.integers(1, 100), max_size=20))
def test_requests_may_come_in_any_pieces(cuts):
    whole, pieces = Host(), Host()
    request = struct.pack(">IIIIIIiiii", 1, 7, 2, 1, 0, 0, 18, 0, 0, 0)
    request += struct.pack("<BBHHH", 0x80, 6, 0x0100, 0, 18)
    stream = request * 5
    expected = whole.session.take(stream, NOW_S)
    got, at = b"", 0
    for cut in [*cuts, len(stream)]:
        got += pieces.session.take(stream[at : at + cut], NOW_S)
        at += cut
    assert got == expected


def test_something_that_is_no_usbip_host_is_refused():
    with pytest.raises(ValueError, match="no USB/IP host"):
        Host().session.take(b"GET / HTTP/1.1\r\n" * 5, NOW_S)


@pytest.fixture
def server():
    """A bridge on a free port of this machine: its address."""
    ours, theirs = socket.socketpair()
    with socket.create_server(("127.0.0.1", 0)) as listener, ours, theirs:
        bridge = UsbBridge(Numbered())
        thread = threading.Thread(target=serve_tcp, args=(bridge, listener, theirs))
        thread.start()
        yield listener.getsockname()
        ours.send(b"x")
        thread.join(10)
        assert not thread.is_alive()


def received(connection, size):
    data = b""
    while len(data) < size:
        more = connection.recv(size - len(data))
        assert more
        data += more
    return data


def test_the_device_is_listed_imported_and_streams_over_tcp(server):
    with socket.create_connection(server, 10) as client:
        client.sendall(struct.pack(">HHI", 0x0111, 0x8005, 0))
        listed = received(client, 12 + 312 + 4)
        assert struct.unpack_from(">HHII", listed) == (0x0111, 0x0005, 0, 1)
        assert listed[12 + 256 : 12 + 259] == b"1-1"
        assert client.recv(1) == b""
    with socket.create_connection(server, 10) as client:
        client.sendall(struct.pack(">HHI32s", 0x0111, 0x8003, 0, b"9-9"))
        assert struct.unpack(">HHI", received(client, 8)) == (0x0111, 0x0003, 1)
    for _ in range(2):  # one host after the other
        with socket.create_connection(server, 10) as client:
            client.sendall(struct.pack(">HHI32s", 0x0111, 0x8003, 0, b"1-1"))
            assert received(client, 8 + 312)[:8] == struct.pack(">HHI", 0x0111, 0x0003, 0)
            host = Host()
            host.session.take = lambda data, _, client=client: client.sendall(data) or b""
            host.submit()
            reply = received(client, 48 + FRAMES * (FRAME_BYTES + 16))
            assert struct.unpack_from(">I", reply)[0] == 3


def test_a_client_that_speaks_nonsense_is_dropped_and_the_next_is_served(server):
    with socket.create_connection(server, 10) as client:
        client.sendall(b"GET / HTTP/1.1\r\n\r\n")
        with contextlib.suppress(ConnectionResetError):
            assert client.recv(100) == b""
    with socket.create_connection(server, 10) as client:
        client.sendall(struct.pack(">HHI", 0x0111, 0x8005, 0))
        assert struct.unpack_from(">HH", received(client, 328)) == (0x0111, 0x0005)


def test_the_craft_flies_on_while_nobody_listens():
    bridge = UsbBridge(Numbered())
    for second in range(60):
        bridge.fly_on(NOW_S + second)
    assert bridge._flight.frame == 59_000
    bridge.control(struct.pack("<BBHHH", 0, 9, 1, 0, 0), NOW_S + 60)
    bridge.control(struct.pack("<BBHHH", 1, 11, ALTERNATE, 0, 0), NOW_S + 60)
    bridge.submit(1, FRAMES, NOW_S + 60.0005)
    (done,) = bridge.complete(NOW_S + 60.1)
    assert done.packets[0] == full(60_001)
    assert bridge.counts.lost == 0


@pytest.mark.parametrize("where", ["somewhere", "127.0.0.1:70000"])
def test_a_wrong_place_for_the_bridge_is_refused_in_one_line(where, capsys, monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert main([where]) == 1
    told = capsys.readouterr().err
    assert "vhci, or HOST:PORT" in told
    assert told.count("\n") == 1
