"""A flight of the daemon's craft: begun once per person's command, recorded, and its parameters put
back."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation import BadInputError, GroundStationError, Pilot, socket_path
from groundstation.cli.commanding import (
    begin_recording,
    end_recording,
    why_aborted,
)
from groundstation.cli.interrupts import Interrupts
from groundstation.cli.motors_off import Ended, stop_motors
from groundstation.cli.terminal import say
from groundstation.service.client import ask

if TYPE_CHECKING:
    from groundstation.learn.planning import Craft

BY_OPERATOR = "the operator "
"""How the daemon's note of a Stop or a Land begins."""
STOPPED_SINCE = "motors were stopped since this program began; begin it again"
STOPS = "GROUNDSTATION_STOPS"
"""The daemon's count of Stops when it began this program as a job."""


def stops_begun(path: Path) -> int:
    """How often somebody had stopped the motors when this program began, as the daemon counts.

    Raises GroundStationError where that was done while the program was still being loaded.
    """
    from groundstation.cli import main

    given = os.environ.get(STOPS, "")
    if given.isdigit():
        return int(given)
    command = ask(path, "GET", "/status")["command"]
    for event in ask(path, "GET", "/events"):
        is_stop = event["kind"] == "stop" and event["text"].startswith(BY_OPERATOR)
        if is_stop and main.begun_ns < event["time_ns"] < time.time_ns():
            raise GroundStationError(STOPPED_SINCE)
    return 0 if command is None else int(command["stops"])


@contextmanager
def commanded(client: str, stops: int | None = None, craft: Craft | None = None) -> Iterator[Pilot]:
    """The lease on the daemon's craft. stops: as ``stops_begun`` said at the program's begin.

    Raises GroundStationError where the motors were stopped since, BadInputError where it is another
    craft than ``craft``.
    """
    from groundstation.learn import planning as journal

    with Pilot(socket_path(), client, stops) as pilot:
        now = journal.Craft(**pilot.lease["craft"])
        if craft is not None and not craft.is_same(now):
            raise BadInputError(
                f"this is another craft: {now}; it was {craft}. Nothing was written or flown; learn"
                " this one in another folder with -o"
            )
        yield pilot


def require_calm(stops: int) -> None:
    """Raises GroundStationError where somebody has stopped the motors since this program began."""
    command = ask(socket_path(), "GET", "/status")["command"]
    if command is not None and command["stops"] != stops:
        raise GroundStationError(STOPPED_SINCE)


@dataclass(frozen=True, slots=True)
class Changes:
    """Parameters that a flight writes, by full name. former: what the craft had. stays: whether
    the new ones stay after a good flight."""

    changed: dict[str, float]
    former: dict[str, float]
    stays: frozenset[str] = frozenset()

    @classmethod
    def of(cls, before: Mapping[str, float], changed: Mapping[str, float], **more: Any) -> Changes:
        """before: every parameter of the craft. Raises BadInputError for one that it has not."""
        unknown = [name for name in changed if name not in before]
        if unknown:
            raise BadInputError(
                f"the craft has no parameter {', '.join(unknown)}; nothing was written"
            )
        return cls(dict(changed), {name: before[name] for name in changed}, **more)

    def put_back(self, pilot: Pilot, why: str) -> list[str]:
        """The names of what is put back: all of it after a flight that was cut short. A lease that
        is over leaves it to the daemon."""
        back = {k: v for k, v in self.former.items() if why or k not in self.stays}
        try:
            write_parameters(pilot, back)
        except GroundStationError:  # the lease is over, or the craft is out of reach
            pilot.content = False
            say("the daemon puts the former parameters back, once the craft stands", error=True)
            return []
        if back and why:
            say("the former parameters are back", error=True)
        return sorted(back)


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a flight: see ``Ended``. seconds: it took. recording: the daemon's file.
    restored: parameters that were put back."""

    ended: Ended
    seconds: float
    recording: str
    restored: list[str]


def fly_recorded(
    pilot: Pilot,
    changes: Changes,
    fly: Callable[[Interrupts], Ended],
    mark: str,
    **details: Any,
) -> Report:
    """Record one flight with the changed parameters, and put them back behind it.

    fly: what is flown; it leaves a craft whose motors stand. mark, details: the recording's first.
    An interrupt ends the flight and is told in the report: nothing after it is skipped.
    """
    path, begun_s = socket_path(), time.monotonic()
    with Interrupts() as signals:
        recording = begin_recording(path)
        try:
            with signals.heard():
                write_parameters(pilot, changes.changed)
                pilot.mark(mark, **details)
            ended = fly(signals)
        except KeyboardInterrupt as stop:
            ended = Ended(str(stop), stop_motors(pilot), stop)
        except GroundStationError as error:
            ended = Ended(why_aborted(error), stop_motors(pilot))
        seconds = time.monotonic() - begun_s
        restored = changes.put_back(pilot, ended.why)
        file = end_recording(path, recording, ended.why)
    return Report(ended, seconds, file, restored)


def write_parameters(pilot: Pilot, values: Mapping[str, float]) -> None:
    """Write parameters and require that the craft read back the same numbers."""
    import numpy as np

    if not values:
        return
    back = pilot.write(dict(values))
    for name, value in values.items():
        if np.float32(back[name]) != np.float32(value):
            raise GroundStationError(
                f"{name}: wrote {value:g}, the craft says {back[name]:g}; nothing was flown"
            )
