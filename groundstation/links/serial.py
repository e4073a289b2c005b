"""The bridge on a serial port: frames of COBS and CRC-16 on a real tty."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import grp
import os
import select
import termios
import time
from collections import deque
from typing import Any

import numpy as np

from groundstation.background import in_background, left_running
from groundstation.errors import BadInputError, GroundStationError, LinkError, LinkLostError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.command import HostClock
from groundstation.telemetry.packet import SERIAL_FRAME_BYTES as FRAME_BYTES
from groundstation.telemetry.packet import Deframer, port_and_baud
from groundstation.telemetry.samples import RawBatch

BATCH_S = 0.008
"""A batch gathers what arrives within this time of its first byte."""
READ_BYTES = 1 << 16
MOST_WAITING_BYTES = 1 << 20
"""About 14 s at 2000 packets/s: only a program that does not read lets so much wait."""
OPEN_S = 5.0
"""A port that has not opened by then hangs in its driver."""
REPORT_S = 1.0
"""Damage is reported at most so often."""
UNREADABLE_BYTES = 100 * FRAME_BYTES
"""So many bytes without a single frame are no telemetry, or at another speed."""

_ABSENT = {errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.EIO}
_DENIED = {errno.EACCES, errno.EPERM}
_TAKEN = {errno.EAGAIN, errno.EBUSY}


def make(options: LinkOptions) -> Link:
    return SerialLink(options.argument, clock=options.clock)


class SerialLink(Link):
    """Reads ``PORT`` or ``PORT@BAUD`` (2 Mbaud otherwise), and only ever one reader does.

    Each packet is stamped when the read returns that brought its last byte. Bytes that wait for
    a reader are bounded: beyond 1 MB the oldest are dropped and counted.

    damaged: stretches between delimiters that were no frame, since the link was opened.
    dropped_bytes: of the reader that did not come, since the link was opened.
    """

    def __init__(self, address: str, *, clock: HostClock | None = None) -> None:
        super().__init__(f"serial:{address}", clock=clock)
        try:
            self.port, self.baud = port_and_baud(address)
        except ValueError as error:
            raise BadInputError(str(error)) from error
        self._serial: Any = None
        self._reset()

    @property
    def damaged(self) -> int:
        return self._deframer.damaged

    def _reset(self) -> None:
        self.dropped_bytes = 0
        self._deframer = Deframer()
        self._waiting: deque[tuple[int, bytes]] = deque()  # stamp and bytes of each read
        self._waiting_bytes = 0
        self._due_s = 0.0
        self._received_bytes = 0
        self._gone = ""
        self._reported = (0, 0, False)
        self._report_due_s = 0.0
        self._later: asyncio.TimerHandle | None = None
        self._arrived = asyncio.Event()

    async def _open(self) -> None:
        self._reset()
        self._serial = await self._opened_port()
        asyncio.get_running_loop().add_reader(self._serial.fileno(), self._receive)

    async def _opened_port(self) -> Any:
        """Opened in a thread: a wedged adapter can hold whoever opens it for ever."""
        what = f"opening {self.port}"
        hung = LinkError(
            f"serial port {self.port} does not answer: unplug the receiver and plug it in again"
        )
        if left_running(what):
            raise hung  # one thread that waits is enough, whichever link began it
        try:
            async with asyncio.timeout(OPEN_S):
                return await in_background(
                    lambda: _open_port(self.port, self.baud),
                    what=what,
                    discard=lambda port: port.close(),
                )
        except TimeoutError as late:
            raise hung from late

    def _receive(self) -> None:
        """Called by the loop when bytes wait in the kernel, or the port hung up."""
        fd = self._serial.fileno()
        try:
            data = os.read(fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._hang_up(error.strerror or str(error))
            return
        if not data:
            # with VMIN 0 a tty gives nothing both when it is empty and when it has gone
            if _has_hung_up(fd):
                self._hang_up("hung up")
            return
        if not self._waiting:
            self._due_s = time.monotonic() + BATCH_S
        self._waiting.append((self.clock(), data))
        self._waiting_bytes += len(data)
        self._received_bytes += len(data)
        while self._waiting_bytes > MOST_WAITING_BYTES:
            _, oldest = self._waiting.popleft()
            self._waiting_bytes -= len(oldest)
            self.dropped_bytes += len(oldest)
        self._arrived.set()

    def _hang_up(self, why: str) -> None:
        asyncio.get_running_loop().remove_reader(self._serial.fileno())
        self._gone = why
        self._arrived.set()

    async def _read(self) -> RawBatch:
        while True:
            await self._arrived.wait()
            wait_s = self._due_s - time.monotonic()
            if wait_s > 0 and not self._gone:
                await asyncio.sleep(wait_s)
            # no await from here to the return: a cancelled read has lost nothing
            batch = self._deframe()
            self._report()
            if len(batch):
                return batch
            if self._gone:
                raise LinkLostError(f"serial port {self.port} has gone: {self._gone}")

    def _deframe(self) -> RawBatch:
        """The packets of everything that waits."""
        parts, stamps = [], []
        for stamp, data in self._waiting:
            packets = self._deframer.feed(data)
            parts.append(packets)
            stamps.append(np.full(len(packets), stamp, np.int64))
        self._waiting.clear()
        self._waiting_bytes = 0
        if not self._gone:
            self._arrived.clear()
        if not parts:
            return RawBatch.concatenate([])
        return RawBatch(np.concatenate(parts), np.concatenate(stamps))

    def _report(self) -> None:
        """Tell what was wrong with the stream, once a second at most."""
        unreadable = self._deframer.frames == 0 and self._received_bytes > UNREADABLE_BYTES
        now = (self.damaged, self.dropped_bytes, unreadable)
        if now == self._reported:
            return
        wait_s = self._report_due_s - time.monotonic()
        if wait_s > 0 and self._serial is not None:
            if self._later is None:
                self._later = asyncio.get_running_loop().call_later(wait_s, self._report_late)
            return
        damaged, dropped = now[0] - self._reported[0], now[1] - self._reported[1]
        if unreadable and not self._reported[2]:
            text = (
                f"{self._received_bytes} bytes at {self.baud} baud hold no telemetry frame: "
                "check the bridge's baud rate and framing"
            )
            self.emit("fault", text, received_bytes=self._received_bytes)
        if damaged and not unreadable:
            self.emit("fault", f"{damaged} damaged frames skipped", damaged=self.damaged)
        if dropped:
            text = f"{dropped} bytes dropped: they were not read in time"
            self.emit("fault", text, dropped_bytes=self.dropped_bytes)
        self._reported = now
        self._report_due_s = time.monotonic() + REPORT_S

    def _report_late(self) -> None:
        """Also when nothing more comes."""
        self._later = None
        self._report()

    async def _close(self) -> None:
        if self._serial is not None:
            asyncio.get_running_loop().remove_reader(self._serial.fileno())
            self._serial.close()
        self._serial = None
        if self._later is not None:
            self._later.cancel()
            self._report_late()


def permission_advice(port: str) -> str:
    """What to do about a port that exists and may not be opened."""
    try:
        owner = os.stat(port).st_gid
        group = grp.getgrgid(owner).gr_name
    except (OSError, KeyError):
        owner, group = 0, "root"
    if owner == 0:
        return "permission denied; only root may use it: change its group by a udev rule"
    return (
        f"permission denied; join its group with 'sudo usermod -aG {group} $USER' and log in again"
    )


def _open_port(port: str, baud: int) -> Any:
    import serial

    try:
        opened = serial.Serial(port, baud, timeout=0, exclusive=True)
    except (OSError, termios.error, ValueError, OverflowError) as error:
        raise _refusal(port, baud, error) from error
    with contextlib.suppress(OSError, ValueError, NotImplementedError):
        # adapters that gather bytes (FTDI: for 16 ms) pass them on within 1 ms; a port of
        # another kind has nothing to set
        opened.set_low_latency_mode(True)
    return opened


def _refusal(port: str, baud: int, error: Exception) -> GroundStationError:
    """What an operator can do about a port that does not open."""
    number = _error_number(error)
    if number in _ABSENT:
        return LinkError(
            f"serial port {port} is not there: plug the receiver in "
            "('groundstation devices' lists what is)"
        )
    if number in _DENIED:
        return LinkError(f"serial port {port}: {permission_advice(port)}")
    if number in _TAKEN:
        return LinkError(f"serial port {port} is in use by another program: stop that one first")
    if number in (errno.ENOTTY, errno.EISDIR):
        return BadInputError(
            f"{port} is no serial port: use one that 'groundstation devices' lists"
        )
    return BadInputError(f"serial port {port} at {baud} baud: {error}")


def _error_number(error: Exception) -> int | None:
    """pyserial hides that of a failed termios call in its context."""
    for one in (error, error.__context__):
        if isinstance(one, OSError) and one.errno:
            return one.errno
        if isinstance(one, termios.error):
            return int(one.args[0])
    return None


def _has_hung_up(fd: int) -> bool:
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return any(events & (select.POLLHUP | select.POLLERR) for _, events in poll.poll(0))
