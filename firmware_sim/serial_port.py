"""The bridge on a serial line: a pseudo-terminal of this machine, or a real port."""

from __future__ import annotations

import errno
import os
import select
import tty
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from numpy.typing import NDArray

from groundstation.telemetry.packet import SERIAL_FRAME_BYTES as FRAME_BYTES
from groundstation.telemetry.packet import frame_packets, port_and_baud

QUEUE_FRAMES = 2000
"""A second of every copy. The driver of a port holds about as much for a reader that is busy, a
pseudo-terminal a third of it; a packet that finds the queue full is dropped."""


class SerialPort:
    """Sends packets as frames, never waiting for the reader.

    where: ``pty`` makes a pseudo-terminal; ``pty:LINK`` also a symbolic link to it, a name that
        stays the same from one run to the next; anything else is a port, ``PORT`` or
        ``PORT@BAUD``.

    path: what the reader opens (of a real port: ours; the reader has the other end).
    unheard: packets for which nobody had the terminal open.
    dropped: packets for which the queue was full.

    Raises OSError when the port cannot be used, ValueError when LINK is a file of another kind.
    """

    def __init__(self, where: str) -> None:
        self.unheard = self.dropped = 0
        self._queue = bytearray()
        self._serial: Any = None
        self._link: Path | None = None
        kind, _, link = where.partition(":")
        if kind == "pty":
            self._fd, self.path = _new_terminal()
            if link:
                self._make_link(Path(link))
        else:
            self._serial, self.path = _open_port(where)
            self._fd = self._serial.fileno()
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def send(self, packets: NDArray[Any]) -> None:
        """Send packets (n, 32). Raises OSError when the port has gone."""
        if not self._is_heard():
            # as on a wire: what nobody listens to is gone, and none of it waits for who comes
            self.unheard += len(packets) + self._queued()
            self._queue.clear()
            return
        for start in range(0, len(packets), QUEUE_FRAMES):
            part = packets[start : start + QUEUE_FRAMES]
            room = QUEUE_FRAMES - self._queued()
            self._queue += frame_packets(part[:room])
            self.dropped += max(0, len(part) - room)
            self._flush()
        self._flush()

    def close(self) -> None:
        """Hang up. Safe to call twice."""
        if self._fd < 0:
            return
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        if self._serial is not None:
            self._serial.close()
        else:
            os.close(self._fd)
        self._fd = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _queued(self) -> int:
        """Frames that wait, one that is half sent among them."""
        return -(-len(self._queue) // FRAME_BYTES)

    def _flush(self) -> None:
        try:
            while self._queue:
                del self._queue[: os.write(self._fd, self._queue)]
        except BlockingIOError:
            pass
        except OSError as error:
            raise OSError(error.errno, error.strerror, self.path) from error

    def _is_heard(self) -> bool:
        """Whether the other end is open: a wire cannot tell, a pseudo-terminal can."""
        events = dict(self._poll.poll(0)).get(self._fd, 0)
        if events & select.POLLIN:
            with suppress(OSError):
                os.read(self._fd, 4096)  # the bridge takes no commands
        if self._serial is not None and events & (select.POLLHUP | select.POLLERR):
            raise OSError(errno.EIO, "the port has gone", self.path)
        return not events & select.POLLHUP

    def _make_link(self, link: Path) -> None:
        if link.exists() and not link.is_symlink():
            self.close()
            raise ValueError(f"{link}: exists and is no link; give another name")
        try:
            link.unlink(missing_ok=True)
            link.symlink_to(self.path)
        except OSError as error:
            self.close()
            raise OSError(error.errno, error.strerror, str(link)) from error
        self._link = link
        self.path = str(link)


def _new_terminal() -> tuple[int, str]:
    """A pseudo-terminal in raw mode: its master, and the path of the other end."""
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    # closed, so that the master sees who opens it; its settings stay
    os.close(slave)
    os.set_blocking(master, False)
    return master, path


def _open_port(where: str) -> tuple[Any, str]:
    import serial

    port, baud = port_and_baud(where)
    try:
        opened = serial.Serial(port, baud, timeout=0, exclusive=True)
    except serial.SerialException as error:
        text = os.strerror(error.errno) if error.errno else "is no serial port"
        raise OSError(error.errno or errno.ENOTTY, text, port) from error
    return opened, port
