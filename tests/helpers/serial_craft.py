"""A stand-in on a pseudo-terminal, flown by a thread in real time."""

from __future__ import annotations

import threading
import time

from firmware_sim.craft import StandIn
from firmware_sim.serial_port import SerialPort
from firmware_sim.settings import StandInSettings

STEP_S = 0.002


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
        while not self._stopped.wait(STEP_S):
            packets, _ = self._craft.advance(time.monotonic() - start)
            self.port.send(packets)
