"""A UDP relay between client and craft: only so many log packets a second pass it, or nothing."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOG_DATA = 0x52
"""Port 5, channel 2, the two link bits aside."""


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
                data = self._far.recv(2048)
            except TimeoutError:
                continue
            if self.ceases(data):
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
