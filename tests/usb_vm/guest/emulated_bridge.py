"""The emulated bridge as a process of its own, plugged into this machine's kernel on command,
which then shows it to every USB program as it shows a real one: USB/IP over a socket pair with the
virtual host controller (``vhci-hcd``, root only).

Protocol: Documentation/usb/usbip_protocol.rst of the Linux kernel, all fields big endian.
"""

from __future__ import annotations

import contextlib
import errno
import multiprocessing
import select
import socket
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from groundstation.errors import LinkError, LinkLostError
from groundstation.telemetry.packet import FRAME_S
from support.usb_device import Completion, UsbBridge

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
FULL_SPEED = 2
DEVICE_ID = 1 << 16 | 2
IDLE_S = 0.05

_SUBMIT, _UNLINK, _RET_SUBMIT, _RET_UNLINK = 1, 2, 3, 4
_HEADER_BYTES = 48
_ISO_BYTES = 16
_PORT_FREE = "004"


class UsbIpSession:
    """One attachment of a bridge: bytes from the host in, bytes to the host out."""

    def __init__(self, bridge: UsbBridge) -> None:
        self.bridge = bridge
        self._received = bytearray()
        self._offsets: dict[int, list[tuple[int, int]]] = {}

    def take(self, data: bytes, now_s: float) -> bytes:
        """Requests as they come, in any pieces; the replies that are due at once."""
        self._received += data
        replies = []
        while (size := self._message_bytes()) is not None:
            message = bytes(self._received[:size])
            del self._received[:size]
            replies.append(self._answer(message, now_s))
        return b"".join(replies)

    def complete(self, now_s: float) -> bytes:
        """Replies of transfers that have ended by now."""
        return b"".join(self._completion(done) for done in self.bridge.complete(now_s))

    def _message_bytes(self) -> int | None:
        """Length of the first request, once all of it is here."""
        if len(self._received) < _HEADER_BYTES:
            return None
        command, _, _, direction, _, _, length, _, packets, _ = struct.unpack_from(
            ">IIIIIIiiii", self._received
        )
        size = _HEADER_BYTES
        if command == _SUBMIT:
            size += length if direction == 0 else 0
            size += max(packets, 0) * _ISO_BYTES
        elif command != _UNLINK:
            raise ValueError(f"USB/IP command {command}: the other side is no USB/IP host")
        return size if len(self._received) >= size else None

    def _answer(self, message: bytes, now_s: float) -> bytes:
        command, tag, _, _, endpoint, flags_or_tag = struct.unpack_from(">IIIIII", message)
        if command == _UNLINK:
            taken_back = self.bridge.cancel(flags_or_tag)
            self._offsets.pop(flags_or_tag, None)
            status = -errno.ECONNRESET if taken_back else 0
            return struct.pack(">IIIIIi24x", _RET_UNLINK, tag, 0, 0, 0, status)
        packets = struct.unpack_from(">i", message, 32)[0]
        if endpoint == 0:
            data = self.bridge.control(message[40:48], now_s)
            if data is None:
                return _reply(tag, -errno.EPIPE, 0)
            return _reply(tag, 0, len(data)) + data
        if packets <= 0 or endpoint != 1:
            return _reply(tag, -errno.EPIPE, 0)
        rows = struct.iter_unpack(">IIII", message[-packets * _ISO_BYTES :])
        self._offsets[tag] = [(offset, length) for offset, length, _, _ in rows]
        self.bridge.submit(tag, packets, now_s)
        return b""

    def _completion(self, done: Completion) -> bytes:
        transfer = done.transfer
        offsets = self._offsets.pop(transfer.tag)
        data = b"".join(content for content, _ in done.packets)
        rows = b"".join(
            struct.pack(">IIIi", offset, length, len(content), status)
            for (offset, length), (content, status) in zip(offsets, done.packets, strict=True)
        )
        errors = sum(status != 0 for _, status in done.packets)
        head = _reply(
            transfer.tag, done.status, len(data), transfer.start, len(done.packets), errors
        )
        return head + data + rows


def _reply(
    tag: int, status: int, length: int, start: int = 0, packets: int = -1, errors: int = 0
) -> bytes:
    return struct.pack(
        ">IIIIIiiiii8x", _RET_SUBMIT, tag, 0, 0, 0, status, length, start, packets, errors
    )


def serve(bridge: UsbBridge, connection: socket.socket, stop: socket.socket) -> None:
    """Answer one host until it leaves, the bridge is unplugged or ``stop`` becomes readable."""
    bridge.plug()
    session = UsbIpSession(bridge)
    with connection:
        while bridge.plugged:
            due_s = bridge.due_s()
            wait_s = IDLE_S if due_s is None else max(0.0, due_s - time.monotonic())
            ready, _, _ = select.select([connection, stop], [], [], wait_s)
            if stop in ready:
                return
            try:
                if connection in ready:
                    data = connection.recv(1 << 16)
                    if not data:
                        return
                    connection.sendall(session.take(data, time.monotonic()))
                connection.sendall(session.complete(time.monotonic()))
                bridge.fly_on(time.monotonic())
            except ConnectionError:
                return


def attach() -> socket.socket:
    """Plug a new device into this machine's virtual host controller; our end of its cable.

    Raises OSError when the controller is not there or may not be used (root only).
    """
    port = _free_port()
    ours, kernels = socket.socketpair()
    with kernels:
        attachment = f"{port} {kernels.fileno()} {DEVICE_ID} {FULL_SPEED}"
        try:
            (VHCI / "attach").write_text(attachment)
        except OSError:
            ours.close()
            raise
    return ours


def _free_port() -> int:
    status = VHCI / "status"
    if not status.exists():
        raise OSError(
            errno.ENODEV, "no virtual host controller: run 'modprobe vhci-hcd'", str(VHCI)
        )
    for line in status.read_text().splitlines()[1:]:
        hub, port, state = line.split()[:3]
        if hub == "hs" and state == _PORT_FREE:
            return int(port)
    raise OSError(errno.EBUSY, "every port of the virtual host controller is taken", str(VHCI))


OUT = Path("/mnt")
"""The folder that the host sees too."""
COLUMNS = ("packets", "arrival_s")
PATIENCE_S = 6000.0
"""Virtual: it runs on while anything is loaded from the host, which may be busy."""


def unpacked(path, folder):
    """``folder``, with the columns of an .npz file in files that every bridge can map: unpacking a
    flight costs this machine more than most tests of it."""
    with np.load(path) as flown:
        for name in COLUMNS:
            np.save(folder / f"{name}.npy", flown[name])
    return folder


class RecordedFlight:
    """A flight that was flown before, from a folder that ``unpacked`` has made."""

    def __init__(self, folder):
        # plain views, for an array of numpy's class for mapped files is slow to index
        self.packets, self._arrival_s = (
            np.asarray(np.load(folder / f"{name}.npy", mmap_mode="r")) for name in COLUMNS
        )
        self._at = 0

    def advance(self, until_s):
        end = int(np.searchsorted(self._arrival_s, until_s, side="right"))
        rows = slice(self._at, end)
        self._at = max(end, self._at)
        return self.packets[rows], self._arrival_s[rows]


class AwaitedFlight(RecordedFlight):
    """A craft that is switched on when a host begins to listen: nothing of it is missed."""

    def __init__(self, folder):
        super().__init__(folder)
        self.start_s = np.inf

    def advance(self, until_s):
        packets, arrival_s = super().advance(until_s - self.start_s)
        return packets, arrival_s + self.start_s


class AwaitedBridge(UsbBridge):
    """The bridge of an ``AwaitedFlight``."""

    def submit(self, tag, frames, now_s):
        if np.isinf(self._flight.start_s):
            self._flight.start_s = (self._frame(now_s) + 1) * FRAME_S
        super().submit(tag, frames, now_s)


def rows_of(sent, received):
    """Where in the packets sent those received begin and end; the first may be any copy."""
    copies = np.flatnonzero((sent == received[0]).all(axis=1))
    came = int(np.argmax((received != received[0]).any(axis=1)))
    first = int(copies[len(copies) - came])
    return slice(first, first + len(received))


class EmulatedBridge:
    """Starts the process; every method returns when the kernel has been told.

    awaited: whether the flight begins with the stream, and not with the process.
    """

    def __init__(self, flight, faults=(), serial="VM1", *, awaited=False):
        # a server that has imported everything forks: starting costs no files, thus no time
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["emulated_bridge"])
        self._serial = serial
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=run_bridge, args=(theirs, flight, list(faults), serial, awaited), daemon=True
        )
        self._process.start()
        theirs.close()
        assert self._pipe.recv() == "ready"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """Returns when it has left the bus too: the next bridge would be taken for this one."""
        self._pipe.close()
        self._process.join(PATIENCE_S)
        self._process.close()
        deadline_s = time.monotonic() + PATIENCE_S
        while self._serial in serials_on_the_bus():
            assert time.monotonic() < deadline_s, "a bridge that was unplugged is still there"
            time.sleep(0.05)

    def plug(self):
        self._ask("plug")

    def unplug(self):
        self._ask("unplug")

    def counts(self):
        return self._ask("counts")

    def _ask(self, word):
        self._pipe.send(word)
        return self._pipe.recv()


def serials_on_the_bus():
    found = set()
    for path in Path("/sys/bus/usb/devices").glob("*/serial"):
        with contextlib.suppress(OSError):  # it left meanwhile
            found.add(path.read_text().strip())
    return found


def run_bridge(pipe, flight, faults, serial, awaited):
    """The process: obeys until the pipe is closed."""
    made, flown = (AwaitedBridge, AwaitedFlight) if awaited else (UsbBridge, RecordedFlight)
    bridge = made(flown(flight), serial=serial, faults=faults)
    ours, theirs = socket.socketpair()
    thread = None
    pipe.send("ready")
    while True:
        try:
            word = pipe.recv()
        except EOFError:
            word = "end"
        if word == "counts":
            pipe.send(bridge.counts)
            continue
        if thread is not None:
            ours.send(b"x")
            thread.join()
            theirs.recv(1)
            thread = None
        if word == "end":
            return
        if word == "plug":
            thread = threading.Thread(target=serve, args=(bridge, attach(), theirs))
            thread.start()
        pipe.send(word)


async def open_when_there(link):
    """The first attempt may find nothing; the next waits until the device is there."""
    try:
        await link.open()
    except LinkError:
        await link.open()


async def read_until_lost(link):
    async def read_on():
        while True:
            await link.read()

    with pytest.raises(LinkLostError, match="unplugged"):
        await read_on()
