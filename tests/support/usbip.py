"""The bridge on a USB bus over USB/IP: attached to this machine's kernel, or served on TCP.

    python tests/support/usbip.py vhci|HOST:PORT [--settings FILE]

flies the software craft behind it until Ctrl-C.

The kernel's virtual host controller (``modprobe vhci-hcd``) then has a real device, which every
USB program sees. Protocol: Documentation/usb/usbip_protocol.rst of the Linux kernel, all fields
big-endian.
"""

from __future__ import annotations

import argparse
import errno
import select
import signal
import socket
import struct
import sys
import time
from pathlib import Path

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings, load_settings
from groundstation.telemetry.bridge_usb import PRODUCT_ID, VENDOR_ID
from support.usb_device import Completion, UsbBridge

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
FULL_SPEED = 2
BUS_ID = "1-1"
DEVICE_ID = 1 << 16 | 2
PORT = 3240
VERSION = 0x0111
IDLE_S = 0.05

_SUBMIT, _UNLINK, _RET_SUBMIT, _RET_UNLINK = 1, 2, 3, 4
_HEADER_BYTES = 48
_ISO_BYTES = 16
_PORT_FREE = "004"


def main(arguments: list[str] | None = None) -> int:
    """Returns 0, or 1 after one line on stderr."""
    parser = argparse.ArgumentParser(prog="python tests/support/usbip.py", description=__doc__)
    parser.add_argument("where", metavar="vhci|HOST:PORT")
    parser.add_argument("--settings", type=Path, help="of the craft (docs/stand_in.md)")
    options = parser.parse_args(arguments)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        for sign in (signal.SIGINT, signal.SIGTERM):
            signal.signal(sign, lambda *_: ours.send(b"x"))
        try:
            settings = load_settings(options.settings) if options.settings else StandInSettings()
            craft = StandIn(settings)
            craft.advance(0.0)  # compiles on a machine's first run; what is announced answers
            print(f"USB bridge on {options.where}", flush=True)
            run(UsbBridge(craft), options.where, theirs)
        except (ValueError, OSError) as error:
            print(f"usbip: {error}", file=sys.stderr)
            return 1
    return 0


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


def run(bridge: UsbBridge, where: str, stop: socket.socket) -> None:
    """``vhci``: plug the bridge into this machine until the kernel lets go of it. ``HOST:PORT``:
    export it there. Returns when ``stop`` becomes readable.

    Raises ValueError or OSError when it cannot be done.
    """
    if where == "vhci":
        serve(bridge, attach(), stop)
        return
    host, _, port = where.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"{where}: give vhci, or HOST:PORT (usually 127.0.0.1:{PORT})")
    with socket.create_server((host, int(port))) as listener:
        serve_tcp(bridge, listener, stop)


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


def serve_tcp(bridge: UsbBridge, listener: socket.socket, stop: socket.socket) -> None:
    """Export the bridge to ``usbip attach -r HOST -b 1-1``, one host after the other."""
    while True:
        ready, _, _ = select.select([listener, stop], [], [], IDLE_S)
        if stop in ready:
            return
        bridge.fly_on(time.monotonic())
        if not ready:
            continue
        connection, _ = listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(5.0)  # for the greeting; a host that says nothing blocks no other
        try:
            imported = _greet(bridge, connection)
        except (OSError, struct.error):
            imported = False
        if imported:
            connection.settimeout(None)
            serve(bridge, connection, stop)
        else:
            connection.close()


def _greet(bridge: UsbBridge, connection: socket.socket) -> bool:
    """Answer a list or an import request; whether the device was imported."""
    _, request, _ = struct.unpack(">HHI", _exactly(connection, 8))
    if request == 0x8005:
        listed = struct.pack(">HHII", VERSION, 0x0005, 0, 1) + _device_record()
        connection.sendall(listed + bytes([0xFF, 0, 0, 0]))
        return False
    if request != 0x8003:
        return False
    wanted = _exactly(connection, 32).rstrip(b"\0").decode(errors="replace")
    if wanted != BUS_ID:
        connection.sendall(struct.pack(">HHI", VERSION, 0x0003, 1))
        return False
    connection.sendall(struct.pack(">HHI", VERSION, 0x0003, 0) + _device_record())
    return True


def _device_record() -> bytes:
    """The 312 bytes that describe the device in a list or an import."""
    return struct.pack(
        ">256s32sIIIHHHBBBBBB",
        f"/sys/devices/platform/groundstation/usb1/{BUS_ID}".encode(), BUS_ID.encode(),
        DEVICE_ID >> 16, DEVICE_ID & 0xFFFF, FULL_SPEED, VENDOR_ID, PRODUCT_ID, 0x0100,
        0, 0, 0, 0, 1, 1,
    )  # fmt: skip


def _exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = connection.recv(size - len(data))
        if not more:
            raise ConnectionError("the host left during the greeting")
        data += more
    return data


if __name__ == "__main__":
    sys.exit(main())
