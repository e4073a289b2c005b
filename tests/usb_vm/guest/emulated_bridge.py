"""The emulated bridge as a process of its own, plugged into this machine's kernel on command."""

import contextlib
import multiprocessing
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from groundstation.errors import LinkError, LinkLostError
from groundstation.telemetry.packet import FRAME_S
from support.usb_device import UsbBridge
from support.usbip import attach, serve

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
