"""What people begin that commands a craft: programs, jobs, and clients of this process."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from groundstation.errors import GroundStationError
from groundstation.service.client import Pilot
from support.programs import Program
from support.truth import Craft

HEIGHT_M, HOVERS_HZ, CLIMB_M_S = 0.3, 50, 0.4


class Hovering(threading.Thread):
    """A client of this process, who holds a height until it is ended.

    stops: the count that it was begun with. after_s: when it asks for the lease. ends: how, of
    release, land, stop and dies. silent_s: it says nothing for so long. write: parameters, next.
    """

    def __init__(self, socket: Path, name: str, stops: int, after_s: float) -> None:
        super().__init__(name=name)
        self.ends, self.silent_s = "", 0.0
        self.write: dict[str, float] = {}
        self.written: dict[str, float] = {}
        self.settled = self.unsure = False
        self._socket, self._stops, self._after_s = socket, stops, after_s
        self._wakes = threading.Event()
        self.start()

    def end(self, how: str) -> None:
        self.ends = how
        self._wakes.set()

    def run(self) -> None:
        self._wakes.wait(self._after_s)
        pilot = Pilot(self._socket, self.name, self._stops)
        with contextlib.suppress(GroundStationError):
            pilot.__enter__()
            begun_s = time.monotonic()
            while not self.ends:
                height_m = min(HEIGHT_M, CLIMB_M_S * (time.monotonic() - begun_s))
                pilot.setpoint(0.0, 0.0, 0.0, height_m=height_m, vx_m_s=0.0, vy_m_s=0.0)
                values, self.write = self.write, {}
                if values:
                    self.written |= values
                    pilot.write(values)
                silent_s, self.silent_s = self.silent_s, 0.0
                self._wakes.wait(max(silent_s, 1.0 / HOVERS_HZ))
            if self.ends == "stop":
                pilot.stop()
            elif self.ends == "land":
                pilot.land()
            if self.ends != "dies":
                self.unsure = True
                pilot.release()
                self.settled = True
        pilot.close()


class Begun:
    """Somebody or something that a person began. begun_ns: when. signals: what was sent to it.
    settles: parameters that it leaves where it ends well. unsure: it may have left them."""

    def __init__(self, kind: str, what: Program | Hovering | str, craft: Craft) -> None:
        self.kind, self.what, self.craft = kind, what, craft
        self.name = what.name if isinstance(what, Hovering) else kind
        self.begun_ns = time.time_ns()
        self.signals: list[int] = []
        self.settles: dict[str, float] = {}
        self.unsure = False
        self._switched, self._flights = craft.switched, len(craft.truth.flights)

    def ended(self, jobs: Callable[[], dict[str, str]]) -> bool:
        """jobs: state of each, by id."""
        if isinstance(self.what, Hovering):
            return not self.what.is_alive()
        if isinstance(self.what, Program):
            return self.what.poll() is not None
        return jobs().get(self.what) not in ("waiting", "running")

    def signal(self, number: int) -> None:
        assert isinstance(self.what, Program)
        truth = self.craft.truth
        # one that has flown may have left what it had to before it hears of this
        self.unsure |= len(truth.flights) > self._flights and not truth.flies
        self.signals.append(number)
        self.what.send_signal(number)

    def settle(self) -> None:
        """What it has left is what the craft may have."""
        left, sure = self.settles, False
        if isinstance(self.what, Hovering):
            left, sure = self.what.written, self.what.settled
            self.unsure = self.what.unsure
        elif isinstance(self.what, Program):
            sure = self.what.returncode == 0
        if self.craft.switched != self._switched:
            return  # whatever it left was forgotten
        for name, value in left.items():
            if sure:
                self.craft.gains[name] = {value}
            elif self.unsure:
                self.craft.gains[name] |= {value}

    def kill(self) -> None:
        """Whatever it does."""
        if isinstance(self.what, Hovering):
            self.what.end("dies")
            self.what.join()
        elif isinstance(self.what, Program):
            self.what.end()


@contextlib.contextmanager
def held(pid: int) -> Iterator[None]:
    """It stands still meanwhile."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
