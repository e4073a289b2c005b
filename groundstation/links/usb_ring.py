"""A ring of isochronous transfers in flight: what one read after the other cannot do.

Between two reads of ``Device.read`` no transfer is queued and at least one frame passes unheard.
Here ``DEPTH`` transfers of ``FRAMES`` frames are always queued; each is queued again before its
content is looked at. Built on the structures of pyusb's own libusb backend, whose names are
private: the version is pinned and the names are checked.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from groundstation.errors import LinkError
from groundstation.telemetry.packet import USB_FRAME_BYTES as FRAME_BYTES

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
