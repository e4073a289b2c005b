"""Software crafts that fly in real time: over UDP, on a serial port, behind a narrow radio."""

from __future__ import annotations

import asyncio
import contextlib
import random
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from typing import Any

from firmware_sim.craft import StandIn
from firmware_sim.crtp import CrtpServer
from firmware_sim.serial_port import SerialPort
from firmware_sim.settings import StandInSettings
from groundstation.links.stand_in import StandInLink
from support.programs import free_port
from support.waiting import until

SERIAL_STEP_S = 0.002
OFF_S = 6.0
"""An empty cell is off by then, and a charged one soon in."""
LOG_DATA = 0x52
"""Port 5, channel 2, the two link bits aside."""


class ServedCraft:
    """A stand-in flown by a thread in steps of 10 ms, longer where it is late, served by a loop in
    another."""

    def __init__(self, craft: StandIn) -> None:
        self.craft = craft
        self.loop = asyncio.new_event_loop()
        self.server = CrtpServer(craft, port=0)
        self.each_step: Callable[[], None] = lambda: None
        self.skip_s = 0.0
        """Time that passes for the craft at its next step, for nobody else."""
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self.loop.run_forever),
            threading.Thread(target=self._fly),
        ]

    @property
    def uri(self) -> str:
        return f"udp://127.0.0.1:{self.server.port}"

    def start(self) -> None:
        for thread in self._threads:
            thread.start()
        asyncio.run_coroutine_threadsafe(self.server.start(), self.loop).result(10)

    def stop(self) -> None:
        asyncio.run_coroutine_threadsafe(self.server.close(), self.loop).result(10)
        self._stop.set()
        self.loop.call_soon_threadsafe(self.loop.stop)
        for thread in self._threads:
            thread.join(10)
        self.loop.close()

    def _fly(self) -> None:
        flown_s = self.craft.time_s
        ahead_s = flown_s - time.monotonic()
        while not self._stop.wait(0.009):
            late_s = time.monotonic() + ahead_s - flown_s
            flown_s += min(max(late_s, 0.01), 0.05) + self.skip_s
            ahead_s += self.skip_s
            self.skip_s = 0.0
            self.craft.advance(flown_s)
            self.each_step()


@contextlib.contextmanager
def served(**settings: Any) -> Iterator[ServedCraft]:
    """A craft that has found its gyro's bias; by default it waits on the ground."""
    craft = StandIn(StandInSettings(**{"program": "wait", "resume_s": 1e6, **settings}))
    craft.advance(3.0)
    running = ServedCraft(craft)
    running.start()
    try:
        yield running
    finally:
        running.stop()


def run_flat(craft: StandIn) -> None:
    """Its cell is empty from now on: it is soon off, and on again with a charged one."""
    craft._state[0]["charge"] = 0.0


def switched_off_and_on(running: ServedCraft) -> None:
    """Wait until its next power-on, which comes after a few seconds of the craft's time."""
    boots = running.craft.boots
    run_flat(running.craft)
    running.skip_s = OFF_S
    until(lambda: running.craft.boots > boots, "the next power-on")


@contextlib.asynccontextmanager
async def flown_link(options: dict[str, Any]) -> AsyncIterator[str]:
    """Fly a stand-in in real time; yields the URI on which it takes commands."""
    port = free_port()
    async with StandInLink(options, crtp=("127.0.0.1", port)) as link:

        async def read() -> None:
            while True:
                await link.read()

        reading = asyncio.create_task(read())
        try:
            yield f"udp://127.0.0.1:{port}"
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)


class SerialCraft:
    """Flies and sends while it is entered. ``path`` is what a link opens."""

    def __init__(self, settings: StandInSettings, where: str = "pty") -> None:
        self._craft = StandIn(settings)
        self._craft.advance(0.0)  # compiles where no cache has it
        self.port = SerialPort(where)
        self.path = self.port.path
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._fly, name="craft")

    def __enter__(self) -> SerialCraft:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()
        self.port.close()

    def _fly(self) -> None:
        start = time.monotonic()
        while not self._stopped.wait(SERIAL_STEP_S):
            packets, _ = self._craft.advance(time.monotonic() - start)
            self.port.send(packets)


class NarrowRadio:
    """most_hz: log packets a second that come through, any of them, however many are sent.
    stalled: neither side hears the other, and what is said meanwhile is lost. loses: told what a
    client sends, whether it is lost. ceases: the same of what the craft sends. doubles: every
    answer comes twice. adds: what comes with each log packet."""

    def __init__(self, craft_port: int, most_hz: float) -> None:
        self.most_hz, self.stalled = most_hz, False
        self.loses: Callable[[bytes], bool] = lambda packet: False
        self.ceases: Callable[[bytes], bool] = lambda packet: False
        self.doubles, self.adds = False, list[bytes]()
        self._craft = ("127.0.0.1", craft_port)
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self._far.bind(("127.0.0.1", 0))
        self._client: tuple[str, int] | None = None
        self._stopped = threading.Event()
        self._threads = [threading.Thread(target=self._up), threading.Thread(target=self._down)]
        for one in (self._near, self._far):
            one.settimeout(0.1)

    @property
    def uri(self) -> str:
        return f"udp://127.0.0.1:{self._near.getsockname()[1]}"

    def reach(self, craft_port: int) -> None:
        """From now on the craft on that port is the one that hears and is heard."""
        self._craft = ("127.0.0.1", craft_port)

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        self._stopped.set()
        for thread in self._threads:
            thread.join()
        self._near.close()
        self._far.close()

    def _up(self) -> None:
        while not self._stopped.is_set():
            try:
                data, self._client = self._near.recvfrom(2048)
            except TimeoutError:
                continue
            if not self.stalled and not self.loses(data):
                self._far.sendto(data, self._craft)

    def _down(self) -> None:
        came, since, share, chance = 0, time.monotonic(), 1.0, random.Random(7)
        while not self._stopped.is_set():
            try:
                data, sender = self._far.recvfrom(2048)
            except TimeoutError:
                continue
            if sender != self._craft or self.ceases(data):
                continue
            is_log = data[0] & 0xF3 == LOG_DATA
            if is_log:
                came += 1
                if (now := time.monotonic()) >= since + 0.5:
                    share, came, since = self.most_hz * (now - since) / came, 0, now
                if chance.random() >= share:
                    continue
            if self._client is not None and not self.stalled:
                times = 1 if is_log or not self.doubles else 2
                for packet in [data] * times + (self.adds if is_log else []):
                    self._near.sendto(packet, self._client)


@contextmanager
def narrow(craft_port: int, most_hz: float = 1e9) -> Iterator[NarrowRadio]:
    """A relay before the craft on that port."""
    radio = NarrowRadio(craft_port, most_hz)
    radio.start()
    try:
        yield radio
    finally:
        radio.stop()
