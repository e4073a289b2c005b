"""The bridge as a USB device: descriptors, control requests, and frames in step with a bus.

Without any transport: ``tests/usb_vm/guest/emulated_bridge.py`` carries it to a kernel. Time is
given with each call, in seconds of any steady clock; the bus counts frames of 1 ms from the first
moment it is told.

A transfer begins where the one before it ended. When the host has none queued, the frames in
between have no place to go: they are dropped and counted in ``BridgeCounts.dry``.
"""

from __future__ import annotations

import enum
import errno
import math
import struct
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.packet import (
    ALTERNATE,
    ENDPOINT,
    FRAME_S,
    INTERFACE,
    PRODUCT_ID,
    VENDOR_ID,
)
from groundstation.telemetry.packet import USB_FRAME_BYTES as FRAME_BYTES

INTERVAL = 1
MAX_POWER_MA = 100
CONTROL_BYTES = 64
ENGLISH = 0x0409


def device_descriptor(vendor_id: int = VENDOR_ID, product_id: int = PRODUCT_ID) -> bytes:
    """The 18 bytes of USB 2.0 table 9-8: strings 1 maker, 2 product, 3 serial number."""
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        18, 1, 0x0200, 0, 0, 0, CONTROL_BYTES, vendor_id, product_id, 0x0100, 1, 2, 3, 1,
    )  # fmt: skip


def configuration_descriptor() -> bytes:
    """The configuration with its interface, both settings and the endpoint (USB 2.0 9.6.3)."""
    body = (
        _interface(0, endpoints=0)
        + _interface(ALTERNATE, endpoints=1)
        + struct.pack("<BBBBHB", 7, 5, ENDPOINT, 1, FRAME_BYTES, INTERVAL)
    )
    head = struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 1, 1, 0, 0x80, MAX_POWER_MA // 2)
    return head + body


def string_descriptor(text: str, index: int) -> bytes:
    """A string, or for index 0 the one language they are in."""
    content = struct.pack("<H", ENGLISH) if index == 0 else text.encode("utf-16-le")
    return struct.pack("<BB", 2 + len(content), 3) + content


def _interface(alternate: int, endpoints: int) -> bytes:
    return struct.pack("<BBBBBBBBB", 9, 4, INTERFACE, alternate, endpoints, 0xFF, 0, 0, 0)


MANUFACTURER, PRODUCT = "groundstation", "Crazyflie telemetry bridge"


class Flight(Protocol):
    """Where packets come from: a ``StandIn``, or anything that flies like one."""

    def advance(self, until_s: float) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """Packets (n, 32) that have reached the host by ``until_s``, and when each did (s)."""


class FaultKind(enum.StrEnum):
    SHORT = "short"
    """The frame ends early, inside a packet."""
    CRC = "crc"
    """Checksum error: bytes arrive, and are wrong."""
    PROTOCOL = "protocol"
    """Bit stuffing or time-out: nothing arrives."""
    MISSED = "missed"
    """The host controller had no time for the frame."""
    OVERRUN = "overrun"
    """More bytes than the endpoint may send."""
    PIPE = "pipe"
    """The packet of one frame is answered by a stall."""
    STALL = "stall"
    """The endpoint halts until the host clears it."""
    UNPLUG = "unplug"
    """The cable is pulled."""


_PACKET_STATUS = {
    FaultKind.CRC: (-errno.EILSEQ, FRAME_BYTES),
    FaultKind.PROTOCOL: (-errno.EPROTO, 0),
    FaultKind.MISSED: (-errno.EXDEV, 0),
    FaultKind.OVERRUN: (-errno.EOVERFLOW, FRAME_BYTES),
    FaultKind.PIPE: (-errno.EPIPE, 0),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """frame: counted from the first one of the stream. length: bytes of a short frame."""

    frame: int
    kind: FaultKind
    length: int = 0


@dataclass(slots=True)
class BridgeCounts:
    """What became of every frame since a host began to listen.

    good: delivered whole. faulty: delivered with a fault, by kind. dry: no transfer was queued.
    halted: passed while the endpoint was halted. packets: inside good frames. packets_lost:
    inside all the others.
    """

    good: int = 0
    faulty: dict[str, int] = field(default_factory=dict)
    dry: int = 0
    halted: int = 0
    packets: int = 0
    packets_lost: int = 0

    @property
    def lost(self) -> int:
        """Frames that did not reach the host whole."""
        return sum(self.faulty.values()) + self.dry + self.halted


@dataclass(slots=True)
class Transfer:
    """One isochronous transfer of the host: ``frames`` frames from ``start`` on."""

    tag: int
    start: int
    frames: int


@dataclass(frozen=True, slots=True)
class Completion:
    """status: of the transfer, 0 or a negative errno. packets: bytes and status of each frame."""

    transfer: Transfer
    status: int
    packets: list[tuple[bytes, int]]


class UsbBridge:
    """The device. One host at a time; ``plug`` before each.

    flight: where packets come from. faults: in order of their frames; each happens once. Those
        behind an ``UNPLUG`` are of the next stream and count from its start.
    """

    def __init__(
        self, flight: Flight, *, serial: str = "stand-in", faults: Iterable[Fault] = ()
    ) -> None:
        self.counts = BridgeCounts()
        self.plugged = False
        self._flight = flight
        self._strings = ("", MANUFACTURER, PRODUCT, serial)
        self._faults = deque(faults)
        self._epoch_s: float | None = None
        self._frames: dict[int, list[bytes]] = {}
        self._flown = 0
        self._queue: deque[Transfer] = deque()
        self._stream_start: int | None = None
        self._next = 0
        self._halted = self._resuming = False
        self.plug()

    def plug(self) -> None:
        """The cable is in: default state, no configuration."""
        self.plugged = True
        self._configuration = self._alternate = 0
        self._stop()

    # -- control requests ------------------------------------------------------------------

    def control(self, setup: bytes, now_s: float) -> bytes | None:
        """Answer a request on endpoint 0: the data, or None to stall."""
        kind, request, value, index, length = struct.unpack("<BBHHH", setup)
        answer: bytes | None = None
        match (kind, request):
            case (0x80, 6):
                answer = self._descriptor(value >> 8, value & 0xFF)
            case (0x80, 8):
                answer = bytes([self._configuration])
            case (0x81, 10):
                answer = bytes([self._alternate])
            case (0x80 | 0x81 | 0x82, 0):
                halted = index == ENDPOINT and self._halted
                answer = struct.pack("<H", halted if kind == 0x82 else 0)
            case (0x00, 9) if value <= 1:
                self._configuration, self._alternate = value, 0
                self._stop()
                answer = b""
            case (0x01, 11) if index == 0 and value <= ALTERNATE:
                self._alternate = value
                self._stop()
                answer = b""
            case (0x02, 1) if index == ENDPOINT and value == 0:
                self._clear_halt(now_s)
                answer = b""
        return None if answer is None else answer[:length]

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if kind == 1:
            return device_descriptor()
        if kind == 2 and index == 0:
            return configuration_descriptor()
        if kind == 3 and index < len(self._strings):
            return string_descriptor(self._strings[index], index)
        return None

    # -- the stream ------------------------------------------------------------------------

    def submit(self, tag: int, frames: int, now_s: float) -> None:
        """The host queues a transfer of ``frames`` frames."""
        transfer = Transfer(tag, 0, frames)
        self._place(transfer, now_s)
        self._queue.append(transfer)

    def cancel(self, tag: int) -> bool:
        """The host takes a transfer back. False when it has completed already."""
        for transfer in self._queue:
            if transfer.tag == tag:
                self._queue.remove(transfer)
                if not self._queue and not self._halted:
                    self._stop()
                return True
        return False

    def fly_on(self, now_s: float) -> None:
        """Time passes while nobody listens: the craft goes on, its packets are gone."""
        if self._stream_start is None:
            self._fly(self._frame(now_s))

    def due_s(self) -> float | None:
        """When something will next be complete."""
        if not self._queue or self._epoch_s is None:
            return None
        first = self._queue[0]
        end = self._next if self._halted else first.start + first.frames
        return self._epoch_s + end * FRAME_S

    def complete(self, now_s: float) -> list[Completion]:
        """Transfers whose last frame has ended by ``now_s``."""
        done: list[Completion] = []
        while self.plugged and (due_s := self.due_s()) is not None and due_s <= now_s:
            completion = self._run(self._queue.popleft())
            if completion is not None:
                done.append(completion)
        return done

    def _place(self, transfer: Transfer, now_s: float) -> None:
        """After the transfer before it, or with the next frame when that has ended already."""
        start = self._frame(now_s) + 1
        if self._stream_start is None:
            self._stream_start = self._next = start
        if self._halted:
            transfer.start = self._next
            return
        if start > self._next:
            if self._resuming:
                self.counts.halted += start - self._next
            else:
                self.counts.dry += start - self._next
            self._fly(start)
            for frame in range(self._next, start):
                self.counts.packets_lost += len(self._frames.pop(frame, ()))
            self._next = start
        self._resuming = False
        transfer.start = self._next
        self._next += transfer.frames

    def _run(self, transfer: Transfer) -> Completion | None:
        """What the frames of a transfer carried; None when the cable was pulled."""
        end = transfer.start + transfer.frames
        if not self._halted:
            self._fly(end)
            kinds = {f.kind for f in self._faults_of_stream() if self._is_inside(f, transfer)}
            if FaultKind.UNPLUG in kinds:
                self._skip_faults(end)
                self.plugged = False
                return None
            if FaultKind.STALL in kinds:
                self._skip_faults(end)
                self._halted, self._next = True, transfer.start
        if self._halted:
            return Completion(transfer, -errno.EPIPE, [(b"", -errno.EPIPE)] * transfer.frames)
        packets = [self._pass(frame) for frame in range(transfer.start, end)]
        return Completion(transfer, 0, packets)

    def _pass(self, frame: int) -> tuple[bytes, int]:
        """One frame's bytes and status, counted."""
        content = self._frames.pop(frame, [])
        fault = self._skip_faults(frame + 1)
        if fault is None or not self._is_at(fault, frame):
            self.counts.good += 1
            self.counts.packets += len(content)
            return b"".join(content), 0
        self.counts.faulty[fault.kind] = self.counts.faulty.get(fault.kind, 0) + 1
        self.counts.packets_lost += len(content)
        if fault.kind is FaultKind.SHORT:
            return b"".join(content)[: fault.length].ljust(fault.length, b"\x55"), 0
        status, length = _PACKET_STATUS[fault.kind]
        return b"\xaa" * length, status

    def _is_at(self, fault: Fault, frame: int) -> bool:
        return fault.frame + (self._stream_start or 0) == frame

    def _is_inside(self, fault: Fault, transfer: Transfer) -> bool:
        at = fault.frame + (self._stream_start or 0) - transfer.start
        return 0 <= at < transfer.frames

    def _faults_of_stream(self) -> Iterator[Fault]:
        for fault in self._faults:
            yield fault
            if fault.kind is FaultKind.UNPLUG:
                return

    def _skip_faults(self, before: int) -> Fault | None:
        """Take out this stream's faults of frames before ``before``; the last of them."""
        last = None
        while self._faults and self._faults[0].frame + (self._stream_start or 0) < before:
            last = self._faults.popleft()
            if last.kind is FaultKind.UNPLUG:
                break
        return last

    def _clear_halt(self, now_s: float) -> None:
        if not self._halted:
            return
        self._halted, self._resuming = False, True
        for transfer in self._queue:
            self._place(transfer, now_s)

    def _stop(self) -> None:
        """The host listens no more: frames pass without being anyone's loss."""
        self._queue.clear()
        self._frames.clear()
        self._stream_start = None
        self._next = 0
        self._halted = self._resuming = False

    # -- the bus ---------------------------------------------------------------------------

    def _frame(self, now_s: float) -> int:
        """The frame that is under way."""
        if self._epoch_s is None:
            self._epoch_s = now_s
        return math.floor((now_s - self._epoch_s) / FRAME_S)

    def _fly(self, end: int) -> None:
        """Have the packets of every frame before ``end`` at hand; of a stream only."""
        if end <= self._flown:
            return
        packets, arrival_s = self._flight.advance((end + 0.5) * FRAME_S)
        self._flown = end
        if self._stream_start is None:
            return
        frames = np.rint(arrival_s / FRAME_S).astype(np.int64) - 1
        for row in np.flatnonzero(frames >= self._stream_start):
            self._frames.setdefault(int(frames[row]), []).append(packets[row].tobytes())
