"""The bridge on a real USB port: isochronous, without loss, through libusb.

The device is ``usb_device``, the stream ``usb_ring``.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import errno
import itertools
import re
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, LinkError, LinkLostError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.command import HostClock
from groundstation.telemetry.packet import (
    ALTERNATE,
    ENDPOINT,
    FRAME_NS,
    FRAME_PACKETS,
    INTERFACE,
    PACKET_BYTES,
    PRODUCT_ID,
    VENDOR_ID,
    Packets,
)
from groundstation.telemetry.packet import USB_FRAME_BYTES as FRAME_BYTES
from groundstation.telemetry.samples import RawBatch

# A ring of isochronous transfers in flight: what one read after the other cannot do.
#
# Between two reads of ``Device.read`` no transfer is queued and at least one frame passes unheard.
# Here ``DEPTH`` transfers of ``FRAMES`` frames are always queued; each is queued again before its
# content is looked at. Built on the structures of pyusb's own libusb backend, whose names are
# private: the version is pinned and the names are checked.


FRAMES = 8
"""Per transfer: packets are seen at most so many milliseconds after they came."""
DEPTH = 16
"""Transfers: a program may be away for FRAMES x DEPTH ms."""
DRAIN_S = 2.0

COMPLETED, CANCELLED, STALLED, NO_DEVICE, OVERRUN = 0, 3, 4, 5, 6
"""``enum libusb_transfer_status``; a frame's 1 is any other error."""
_ERROR_NO_DEVICE = -4
_DESCRIPTOR_BYTES = 12
_POLLOUT = 4
_GOOD = b"".join(
    value.to_bytes(4, "little") for _ in range(FRAMES) for value in (FRAME_BYTES, FRAME_BYTES, 0)
)


@dataclass(frozen=True, slots=True)
class Block:
    """One transfer's content.

    data: ``FRAMES`` times 64 bytes. descriptors: length, actual length and status of each frame,
    three 32-bit integers; None when every frame is full and good. seen_ns: when. queued: frames
    in transfers behind this one.
    """

    data: bytes
    descriptors: bytes | None
    seen_ns: int
    queued: int


class _PollFd(ctypes.Structure):
    _fields_ = [("fd", ctypes.c_int), ("events", ctypes.c_short)]


class _TimeVal(ctypes.Structure):
    _fields_ = [("seconds", ctypes.c_long), ("microseconds", ctypes.c_long)]


class IsoRing:
    """Transfers on one endpoint of an open pyusb device.

    on_block: called for each transfer that completed. It must not raise.
    gone: the device was unplugged. failed: a transfer failed as a whole; ``cancel``, wait for
    ``active`` to be 0, clear the endpoint and ``start`` again.
    """

    def __init__(
        self,
        device: Any,
        endpoint: int,
        *,
        clock: Callable[[], int],
        on_block: Callable[[Block], None],
    ) -> None:
        require_private_names(device)
        self._lib, self._context = device.backend.lib, device.backend.ctx
        self._handle = device._ctx.handle.handle
        self._clock, self._on_block = clock, on_block
        self.gone = self.failed = False
        self.active = 0
        self._stopping = False
        self._now = _TimeVal(0, 0)
        _declare(self._lib)
        from usb.backend import libusb1

        # kept: the C library holds their addresses
        self._callback = libusb1._libusb_transfer_cb_fn_p(self._done)
        self._buffers = [ctypes.create_string_buffer(FRAMES * FRAME_BYTES) for _ in range(DEPTH)]
        self._transfers = [self._lib.libusb_alloc_transfer(FRAMES) for _ in range(DEPTH)]
        self._slots: dict[int, tuple[Any, int, int]] = {}
        for transfer, buffer in zip(self._transfers, self._buffers, strict=True):
            self._lib.libusb_fill_iso_transfer(
                transfer,
                self._handle,
                endpoint,
                ctypes.cast(buffer, ctypes.POINTER(ctypes.c_ubyte)),
                len(buffer),
                FRAMES,
                self._callback,
                None,
                0,
            )
            self._lib.libusb_set_iso_packet_lengths(transfer, FRAME_BYTES)
            content = transfer.contents
            self._slots[ctypes.addressof(content)] = (
                transfer,
                ctypes.addressof(buffer),
                ctypes.addressof(content.iso_packet_desc),
            )

    def start(self) -> None:
        """Queue every transfer. What fails is told by ``gone`` and ``failed``."""
        self.failed = self._stopping = False
        for transfer in self._transfers:
            if not self._submit(transfer):
                return

    def poll_fds(self) -> list[tuple[int, bool]]:
        """File descriptors to watch, and whether for writing (else for reading)."""
        listed = self._lib.libusb_get_pollfds(self._context)
        fds = []
        at = 0
        while listed[at]:
            fds.append((listed[at].contents.fd, bool(listed[at].contents.events & _POLLOUT)))
            at += 1
        self._lib.libusb_free_pollfds(listed)
        return fds

    def handle(self, wait_s: float = 0.0) -> None:
        """Let the library deliver what has completed."""
        self._now.seconds, self._now.microseconds = int(wait_s), int(wait_s % 1 * 1e6)
        self._lib.libusb_handle_events_timeout_completed(
            self._context, ctypes.byref(self._now), None
        )

    def cancel(self) -> None:
        """Take every transfer back; they return through ``handle``."""
        self._stopping = True
        for transfer in self._transfers:
            self._lib.libusb_cancel_transfer(transfer)

    def free(self) -> None:
        """Cancel, wait until none is in flight and give the memory back. May block briefly."""
        self.cancel()
        deadline_s = time.monotonic() + DRAIN_S
        while self.active and time.monotonic() < deadline_s:
            self.handle(0.05)
        if self.active:
            _abandoned.append(self)  # the kernel may still write into its buffers
            return
        for transfer in self._transfers:
            self._lib.libusb_free_transfer(transfer)
        self._transfers.clear()
        self._slots.clear()

    def _submit(self, transfer: Any) -> bool:
        result = self._lib.libusb_submit_transfer(transfer)
        if result == 0:
            self.active += 1
        elif result == _ERROR_NO_DEVICE:
            self.gone = True
        else:
            self.failed = True
        return bool(result == 0)

    def _done(self, pointer: Any) -> None:
        """Called by the library for each transfer that came back. Raises nothing."""
        content = pointer.contents
        transfer, buffer, descriptors = self._slots[ctypes.addressof(content)]
        self.active -= 1
        status = content.status
        if status == COMPLETED:
            seen_ns = self._clock()
            queued = self.active * FRAMES
            data = ctypes.string_at(buffer, FRAMES * FRAME_BYTES)
            described = ctypes.string_at(descriptors, FRAMES * _DESCRIPTOR_BYTES)
            if not (self._stopping or self.failed or self.gone):
                self._submit(transfer)
            good = None if described == _GOOD else described
            self._on_block(Block(data, good, seen_ns, queued))
        elif status == NO_DEVICE:
            self.gone = True
        elif status != CANCELLED or not self._stopping:
            self.failed = True


_abandoned: list[IsoRing] = []
"""Rings whose transfers never came back: their memory must stay."""


def require_private_names(device: Any) -> None:
    """Raise LinkError when pyusb is not the version whose inner structures are used here."""
    import usb
    from usb.backend import libusb1

    module = ("_libusb_transfer_cb_fn_p", "_libusb_transfer", "_libusb_iso_packet_descriptor")
    missing = [name for name in module if not hasattr(libusb1, name)]
    missing += [f"backend.{name}" for name in ("lib", "ctx") if not hasattr(device.backend, name)]
    handle = getattr(getattr(getattr(device, "_ctx", None), "handle", None), "handle", None)
    if handle is None:
        missing.append("_ctx.handle.handle")
    if missing:
        raise LinkError(
            f"pyusb {usb.__version__} lacks {', '.join(missing)}: "
            "install the version this program was made for, pip install 'pyusb==1.3.*'"
        )


def _declare(lib: Any) -> None:
    """Prototypes of what pyusb itself does not use."""
    from usb.backend.libusb1 import _libusb_transfer

    pointer = ctypes.c_void_p
    lib.libusb_cancel_transfer.argtypes = [ctypes.POINTER(_libusb_transfer)]
    lib.libusb_get_pollfds.argtypes = [pointer]
    lib.libusb_get_pollfds.restype = ctypes.POINTER(ctypes.POINTER(_PollFd))
    lib.libusb_free_pollfds.argtypes = [ctypes.POINTER(ctypes.POINTER(_PollFd))]
    lib.libusb_free_pollfds.restype = None
    lib.libusb_handle_events_timeout_completed.argtypes = [
        pointer,
        ctypes.POINTER(_TimeVal),
        ctypes.POINTER(ctypes.c_int),
    ]


# Frames of the USB bus as a clock, and how many of them nobody saw.
#
# The bus counts milliseconds: frame k of a stream ends at ``offset + k ms``. A program sees a frame
# at its end or later, so the lowest (time seen - k ms) is the offset. A stamp made from it is right
# even when the program was blocked while the transfers filled.
#
# A queue that ran dry leaves no error anywhere, only an offset that is whole milliseconds higher
# afterwards: that number is the frames lost.


LEAK_NS = 200
"""Rise of the offset with each frame: the bus may be slower than the host's clock by 200 ppm."""
MARGIN_NS = 1_500_000
"""A queue that came this close to its end may have run dry."""
SETTLE_BLOCKS = 32


class FrameClock:
    """When frames ended, and how many are missing between those that were seen.

    lost: frames that passed without a transfer to hold them, as far as it is settled.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._frames = 0
        self._offset_ns: int | None = None
        self._before_ns: int | None = None
        self._blocks = 0
        self._breaks: deque[int] = deque()

    def anchor(self, frames: int, seen_ns: Sequence[int]) -> None:
        """Blocks of ``frames`` frames that ``see`` will be given next: the one that was looked at
        most promptly tells when all of them ended. A program is busy when a stream begins.
        """
        for number, seen in enumerate(seen_ns, 1):
            ahead = number * frames
            offset_ns = seen - (self._frames + ahead) * FRAME_NS + ahead * LEAK_NS
            self._offset_ns = min(
                offset_ns, offset_ns if self._offset_ns is None else self._offset_ns
            )

    def see(self, frames: int, seen_ns: int, queued: int) -> int:
        """The next ``frames`` frames were seen at ``seen_ns``; when the last of them ended (ns).

        queued: frames in transfers behind this one, at that moment: they hold what comes next.
        The result may be late, never early, and never after ``seen_ns``.
        """
        if self._breaks and self._frames >= self._breaks[0]:
            self.interrupt()
        self._frames += frames
        self._leak(frames)
        at_ns = self._frames * FRAME_NS
        offset_ns = seen_ns - at_ns
        self._offset_ns = offset_ns if self._offset_ns is None else min(offset_ns, self._offset_ns)
        self._blocks += 1
        if self._blocks >= SETTLE_BLOCKS:
            self.settle()
        if seen_ns > self._offset_ns + at_ns + queued * FRAME_NS - MARGIN_NS:
            self._breaks.append(self._frames + queued)
        return self._offset_ns + at_ns

    def skip(self, frames: int) -> None:
        """Frames that were received and dropped unread."""
        self._frames += frames
        self._leak(frames)

    def interrupt(self) -> None:
        """What comes next need not follow what came last."""
        while self._breaks and self._breaks[0] <= self._frames:
            self._breaks.popleft()
        if self._before_ns is None:
            self._before_ns = self._offset_ns
        self._offset_ns = None
        self._blocks = 0

    def settle(self) -> None:
        """Count what an interruption cost, with the frames seen since."""
        if self._before_ns is not None and self._offset_ns is not None:
            self.lost += max(0, round((self._offset_ns - self._before_ns) / FRAME_NS))
            self._before_ns = None

    def _leak(self, frames: int) -> None:
        rise = frames * LEAK_NS
        if self._offset_ns is not None:
            self._offset_ns += rise
        if self._before_ns is not None:
            self._before_ns += rise


# The bridge as a device on the USB: found by its ids, claimed and let go, by pyusb.


DEFAULT_DEVICE = f"{VENDOR_ID:04x}:{PRODUCT_ID:04x}"
PERMISSION_HELP = (
    "install the rule with 'groundstation install udev --print | "
    "sudo tee /etc/udev/rules.d/70-groundstation.rules', then plug the device in again"
)

_ISOCHRONOUS = 1


class BridgeDevice:
    """A telemetry bridge by vendor and product id.

    ids: ``VID:PID`` in hexadecimal. serial: of one among several; empty for the first found.
    """

    def __init__(self, ids: str, serial: str) -> None:
        self._vendor, self._product = parse_ids(ids)
        self._name, self._serial = ids.lower(), serial
        self._backend: Any = None

    def __str__(self) -> str:
        return f"{self._name} with serial number {self._serial}" if self._serial else self._name

    def claim(self) -> Any:
        """Find the device and make it stream; None when it is not there. Blocks."""
        import usb.core
        import usb.util

        try:
            for device in self.find():
                serial = self._serial
                if serial and usb.util.get_string(device, device.iSerialNumber) != serial:
                    usb.util.dispose_resources(device)
                    continue
                try:
                    _select(device)
                except BaseException:
                    usb.util.dispose_resources(device)
                    raise
                return device
        except usb.core.USBError as error:
            if error.errno in (errno.ENODEV, errno.ENOENT):
                return None  # it went away while it was being opened
            raise LinkError(f"USB device {self}: {_explain(error)}") from error
        except (NotImplementedError, ValueError) as error:
            # pyusb: no access to the language list or the strings
            raise LinkError(f"USB device {self}: {error}; {PERMISSION_HELP}") from error
        return None

    def find(self) -> list[Any]:
        """Devices with these ids, by pyusb; its library is loaded the first time. Blocks."""
        import libusb_package
        import usb.core
        from usb.backend import libusb1

        if self._backend is None:
            self._backend = libusb1.get_backend(find_library=libusb_package.find_library)
        if self._backend is None:
            raise LinkError(
                "libusb is not usable here: reinstall with 'pip install libusb-package'"
            )
        found = usb.core.find(
            find_all=True, backend=self._backend, idVendor=self._vendor, idProduct=self._product
        )
        return list(found)


def parse_ids(device: str) -> tuple[int, int]:
    """Vendor and product id of ``VID:PID``. Raises BadInputError for anything else."""
    match = re.fullmatch(r"([0-9a-fA-F]{4}):([0-9a-fA-F]{4})", device)
    if match is None:
        raise BadInputError(
            f"configuration [usb] device {device!r}: give VID:PID, for example {DEFAULT_DEVICE}"
        )
    return int(match[1], 16), int(match[2], 16)


def release(ring: IsoRing | None, device: Any) -> None:
    """Stop the stream and let go of the device, whether or not it is still there. Blocks."""
    import usb.core
    import usb.util

    if ring is not None:
        ring.free()
    with contextlib.suppress(usb.core.USBError):
        device.set_interface_altsetting(INTERFACE, 0)
    usb.util.dispose_resources(device)


def _select(device: Any) -> None:
    """Claim the interface and switch its endpoint on. Raises LinkError when it is no bridge."""
    import usb.core
    import usb.util

    try:
        configuration = device.get_active_configuration()
    except usb.core.USBError:
        device.set_configuration()
        configuration = device.get_active_configuration()
    setting = usb.util.find_descriptor(
        configuration, bInterfaceNumber=INTERFACE, bAlternateSetting=ALTERNATE
    )
    endpoint = setting and usb.util.find_descriptor(setting, bEndpointAddress=ENDPOINT)
    isochronous = endpoint and usb.util.endpoint_type(endpoint.bmAttributes) == _ISOCHRONOUS
    if not isochronous or endpoint.wMaxPacketSize != FRAME_BYTES:
        raise LinkError(
            f"USB device {device.idVendor:04x}:{device.idProduct:04x} is no telemetry bridge: it "
            f"needs isochronous endpoint 0x{ENDPOINT:02x} of {FRAME_BYTES} bytes in alternate "
            f"setting {ALTERNATE}; set [usb] device to another one"
        )
    usb.util.claim_interface(device, INTERFACE)
    device.set_interface_altsetting(INTERFACE, ALTERNATE)


def _explain(error: Any) -> str:
    if error.errno == errno.EACCES:
        return f"no permission; {PERMISSION_HELP}"
    if error.errno == errno.EBUSY:
        return "in use by another program; stop that first"
    return f"{error.strerror}; unplug it and plug it in again"


POLL_S = 0.5
"""How often an absent device is looked for."""
WATCHDOG_S = 1.0
"""The bus delivers frames even when the craft is off: without any, the transfers are stuck."""
FRUITLESS_MOST = 3
"""Restarts of the stream without a frame, after which the device is opened anew."""
REPORT_S = 1.0
ANCHOR_BLOCKS = DEPTH
"""A stream's first blocks are held until so many tell when it began (128 ms): a program that was
busy meanwhile, as it is when it opens a recording, would stamp them late."""
BLOCKS_KEPT = 1024
"""8 s of frames wait for a reader; older ones are dropped and counted."""

_FRAME_ROWS = np.dtype([("length", "<u4"), ("actual", "<u4"), ("status", "<i4")])


@dataclass(slots=True)
class UsbCounts:
    """What became of the bus's frames since the link was opened.

    frames: arrived whole. errors, overruns, stalls: arrived with that status, nothing of them
    was used. ragged: no whole number of packets, nothing was used. unseen: passed while no
    transfer was queued (settled a quarter of a second later). unread: dropped because nobody
    read. packets: delivered.
    """

    frames: int = 0
    errors: int = 0
    overruns: int = 0
    stalls: int = 0
    ragged: int = 0
    unseen: int = 0
    unread: int = 0
    packets: int = 0

    @property
    def lost(self) -> int:
        """Frames whose content is missing."""
        return self.errors + self.overruns + self.stalls + self.ragged + self.unseen + self.unread


def make(options: LinkOptions) -> Link:
    return UsbLink(**options.usb, clock=options.clock)


class UsbLink(Link):
    """Reads a telemetry bridge by vendor and product id.

    device: ``VID:PID`` in hexadecimal. serial: of one among several; empty for the first found.

    ``open`` raises LinkError at once when the device is absent. After that, and after a loss,
    the next ``open`` waits until it is there: a device is used within ``POLL_S`` of appearing.
    """

    def __init__(
        self, *, device: str = DEFAULT_DEVICE, serial: str = "", clock: HostClock | None = None
    ) -> None:
        super().__init__("usb", clock=clock)
        self._device = BridgeDevice(device, serial)
        self.counts = UsbCounts()
        self._claimed: Any = None
        self._ring: IsoRing | None = None
        self._watched: list[tuple[int, bool]] = []
        self._blocks: deque[Block | None] = deque()  # None: an interruption
        self._ready = asyncio.Event()
        self._frames = FrameClock()
        self._anchored = False
        self._last_stamp_ns = 0
        self._awaited = False
        self._restart: asyncio.Task[None] | None = None
        self._alive_s = 0.0
        self._fruitless = 0
        self._reported = UsbCounts()
        self._report_due_s = 0.0

    # -- opening and closing ---------------------------------------------------------------

    async def _open(self) -> None:
        claimed = await asyncio.to_thread(self._device.claim)
        while claimed is None:
            if not self._awaited:
                self._awaited = True
                raise LinkError(f"no USB device {self._device} is plugged in; waiting for one")
            await asyncio.sleep(POLL_S)
            claimed = await asyncio.to_thread(self._device.claim)
        self._claimed = claimed
        self._awaited = True
        self.counts, self._reported = UsbCounts(), UsbCounts()
        self._frames, self._last_stamp_ns = FrameClock(), 0
        self._anchored = False
        self._blocks.clear()
        self._fruitless = 0
        self._ready = asyncio.Event()
        try:
            self._ring = IsoRing(claimed, ENDPOINT, clock=self.clock, on_block=self._take)
            self._watch()
            self._ring.start()
        except BaseException:
            await self._close()
            raise
        self._alive_s = time.monotonic()

    async def _close(self) -> None:
        if self._restart is not None:
            await asyncio.wait([self._restart])
            self._restart = None
        self._unwatch()
        ring, claimed = self._ring, self._claimed
        self._ring = self._claimed = None
        if claimed is not None:
            await asyncio.to_thread(release, ring, claimed)
        self._frames.settle()
        self._report(force=True)
        self._blocks.clear()

    # -- the stream ------------------------------------------------------------------------

    async def _read(self) -> RawBatch:
        while True:
            ring = self._ring
            assert ring is not None
            # nothing is awaited between taking the blocks and the return: nothing can be lost
            batch = self._decode()
            self._report()
            if len(batch):
                return batch
            if ring.gone:
                self._unwatch()
                raise LinkLostError(f"USB device {self._device} was unplugged")
            if self._restart is not None:
                await asyncio.shield(self._restart)
                self._restart = None
                continue
            if self._fruitless >= FRUITLESS_MOST:
                raise LinkLostError(f"USB device {self._device} gives no frames; it is opened anew")
            silent_s = time.monotonic() - self._alive_s
            if ring.failed or silent_s > WATCHDOG_S:
                what = "a transfer failed" if ring.failed else f"no frame for {silent_s:.1f} s"
                self.emit("fault", f"{what}: the stream is started again")
                self._fruitless += 1
                self._restart = asyncio.create_task(self._start_again(ring))
                continue
            self._ready.clear()
            await self._ready.wait()

    async def _start_again(self, ring: IsoRing) -> None:
        """After a failed transfer or a silent bus: all back, halt cleared, all queued anew."""
        import usb.core

        ring.cancel()
        try:
            async with asyncio.timeout(DRAIN_S):
                while ring.active:
                    self._ready.clear()
                    await self._ready.wait()
            if not ring.gone:
                await asyncio.to_thread(self._claimed.clear_halt, ENDPOINT)
        except TimeoutError:
            ring.gone = True  # the host controller is stuck: only a new handle can help
        except usb.core.USBError as error:
            ring.gone = error.errno in (errno.ENODEV, errno.ENOENT)
            self.emit("fault", f"the endpoint could not be cleared: {error.strerror}")
        if not ring.gone:
            self._blocks.append(None)
            ring.start()
        self._alive_s = time.monotonic()

    def _watch(self) -> None:
        assert self._ring is not None
        loop = asyncio.get_running_loop()
        self._watched = self._ring.poll_fds()
        for fd, for_writing in self._watched:
            add = loop.add_writer if for_writing else loop.add_reader
            add(fd, self._handle)

    def _unwatch(self) -> None:
        loop = asyncio.get_running_loop()
        for fd, for_writing in self._watched:
            remove = loop.remove_writer if for_writing else loop.remove_reader
            remove(fd)
        self._watched = []

    def _handle(self) -> None:
        ring = self._ring
        if ring is None:
            return
        ring.handle()
        if ring.gone and not ring.active:
            self._unwatch()  # a dead descriptor is ready for ever
        self._ready.set()

    def _take(self, block: Block) -> None:
        """A transfer's content, from inside the library's callback."""
        self._alive_s = time.monotonic()
        self._fruitless = 0
        self._blocks.append(block)
        while len(self._blocks) > BLOCKS_KEPT:
            if self._blocks.popleft() is None:
                self._frames.interrupt()
            else:
                self._frames.skip(FRAMES)
                self.counts.unread += FRAMES

    def _decode(self) -> RawBatch:
        """Everything received so far, as whole packets with the ends of their frames."""
        parts: list[RawBatch] = []
        while self._blocks and (self._anchored or self._anchor()):
            block = self._blocks.popleft()
            if block is None:
                self._frames.interrupt()
                self._anchored = False
                continue
            end_ns = self._frames.see(FRAMES, block.seen_ns, block.queued)
            packets, frame = self._whole_packets(block)
            stamps = end_ns - (FRAMES - 1 - frame) * FRAME_NS
            np.maximum(stamps, self._last_stamp_ns, out=stamps)
            self._last_stamp_ns = max(self._last_stamp_ns, end_ns)
            parts.append(RawBatch(packets, stamps))
        self.counts.unseen = self._frames.lost
        return RawBatch.concatenate(parts)

    def _anchor(self) -> bool:
        """Whether enough blocks are here, or will ever be, to tell when this stream began."""
        first = list(itertools.takewhile(lambda block: block is not None, self._blocks))
        more = len(first) == len(self._blocks) < ANCHOR_BLOCKS
        ring = self._ring
        if more and not (ring is None or ring.gone or ring.failed):
            return False
        self._frames.anchor(FRAMES, [block.seen_ns for block in first if block is not None])
        self._anchored = True
        return True

    def _whole_packets(self, block: Block) -> tuple[Packets, NDArray[np.int64]]:
        """Packets (n, 32) of the good frames, and the place (n,) of each one's frame."""
        packets = np.frombuffer(block.data, np.uint8).reshape(-1, PACKET_BYTES)
        places = np.arange(len(packets))
        counts = self.counts
        if block.descriptors is None:
            good = FRAMES
        else:
            rows = np.frombuffer(block.descriptors, _FRAME_ROWS)
            status, actual = rows["status"], rows["actual"]
            # bytes of a frame that failed or broke off are of no known meaning
            whole = (status == 0) & (actual % PACKET_BYTES == 0)
            counts.ragged += int(np.count_nonzero((status == 0) & ~whole))
            counts.stalls += int(np.count_nonzero(status == STALLED))
            counts.overruns += int(np.count_nonzero(status == OVERRUN))
            counts.errors += int(np.count_nonzero(~np.isin(status, (0, STALLED, OVERRUN))))
            good = int(np.count_nonzero(whole))
            held = np.where(whole, actual // PACKET_BYTES, 0)
            slot = places % FRAME_PACKETS
            keep = slot < held[places // FRAME_PACKETS]
            packets, places = packets[keep], places[keep]
        counts.frames += good
        counts.packets += len(packets)
        return packets, places // FRAME_PACKETS

    def _report(self, *, force: bool = False) -> None:
        """An event when frames were lost since the last one, at most one a second."""
        if self.counts.lost == self._reported.lost:
            return
        if not force and time.monotonic() < self._report_due_s:
            return
        more = self.counts.lost - self._reported.lost
        self._reported = replace(self.counts)
        self._report_due_s = time.monotonic() + REPORT_S
        self.emit("loss", f"{more} USB frames lost", **asdict(self.counts))
