"""The bridge on a real USB port: isochronous, without loss, through libusb.

The device is ``usb_device``, the stream ``usb_ring``.
"""

from __future__ import annotations

import asyncio
import errno
import itertools
import time
from collections import deque
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import LinkError, LinkLostError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.clock import HostClock
from groundstation.links.usb_device import DEFAULT_DEVICE, BridgeDevice, release
from groundstation.links.usb_frames import FrameClock
from groundstation.links.usb_ring import DEPTH, DRAIN_S, FRAMES, OVERRUN, STALLED, Block, IsoRing
from groundstation.telemetry.packet import ENDPOINT, FRAME_NS, FRAME_PACKETS, PACKET_BYTES, Packets
from groundstation.telemetry.samples import RawBatch

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
