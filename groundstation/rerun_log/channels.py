"""What a flight is called in rerun: entities and clocks; and where a new ``.rrd`` file goes."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shlex
import shutil
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, GroundStationError, RecordingError, install
from groundstation.paths import taken
from groundstation.telemetry.packet import SAMPLE_PERIOD_S, STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch

# What the viewer calls things, and the units in which people read them.
#
# People get degrees, deg/s, g, per cent, volts and rpm.
#
# | entity | values |
# |---|---|
# | /craft | orientation of the craft: body FLU in the world ENU |
# | /telemetry/... | ``GROUPS`` |
# | /link/NAME | ``STATISTICS`` of the link |
# | /events, /commands | what happened and what was commanded, as text |
# | /tables/NAME/VARIABLE | what a craft logs besides its telemetry, further tables of a file |
# | /twin/rates, attitude, accelerometer, gap | live only: measured beside predicted |
#
# Timelines: ``device_time`` (duration) and ``host_time`` (Unix).


APPLICATION = "groundstation"
DEVICE_TIME = "device_time"
HOST_TIME = "host_time"

CRAFT = "/craft"
TABLES = "tables"
EVENTS = "/events"
COMMANDS = "/commands"
LINK = "/link"

ROLL, PITCH, YAW = (239, 83, 80), (102, 187, 106), (66, 165, 245)
MOTORS = ((255, 167, 38), (38, 198, 218), (171, 127, 230), (212, 225, 87))
"""Colours of M1..M4, the same on the craft and in the plots."""


@dataclass(frozen=True, slots=True)
class Group:
    """A channel of the samples and how people read it.

    per_si: what one SI unit is in the shown unit.
    """

    entity: str
    column: str
    per_si: float
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


_AXES = (ROLL, PITCH, YAW)
_DEG = 180 / np.pi
_PLACES = ("M1 front", "M2 right", "M3 rear", "M4 left")
_NUMBERS = ("M1", "M2", "M3", "M4")
GROUPS = (
    Group("/telemetry/attitude", "attitude", _DEG, ("roll", "pitch (nose down +)", "yaw"), _AXES),
    Group("/telemetry/rates", "gyro", _DEG, ("roll rate", "pitch rate", "yaw rate"), _AXES),
    Group(
        "/telemetry/accelerometer",
        "accelerometer",
        1 / STANDARD_GRAVITY,
        ("forward", "left", "up"),
        _AXES,
    ),
    Group("/telemetry/motors", "duty", 100.0, _PLACES, MOTORS),
    Group("/telemetry/battery", "battery_v", 1.0, ("battery",), ((255, 202, 40),)),
    Group("/telemetry/rotors", "rotor_rev_s", 60.0, _NUMBERS, MOTORS),
    Group("/telemetry/motor_steps", "duty_step", 100.0, _NUMBERS, MOTORS),
)
"""Shown in degrees, deg/s, g, % duty, V and rpm."""

STATISTICS: dict[str, tuple[str, tuple[int, int, int]]] = {
    "loss_pct": ("lost (%)", (239, 83, 80)),
    "latency_ms": ("latency (ms)", (255, 202, 40)),
    "rate_hz": ("samples (1/s)", (102, 187, 106)),
    "packets_hz": ("packets (1/s)", (66, 165, 245)),
    "copies": ("copies per sample", (171, 127, 230)),
    "latency_p99_ms": ("latency, 99 % (ms)", (255, 167, 38)),
    "jitter_ms": ("jitter (ms)", (212, 225, 87)),
    "clock_ppm": ("device clock (ppm)", (38, 198, 218)),
}
"""The link statistics that can be plotted; the layout shows the first three."""


def scaled(group: Group, values: NDArray[np.float32]) -> NDArray[np.float64]:
    """SI values in the unit that people read."""
    return values.astype(np.float64) * group.per_si


# One axis of device time for samples (which carry it) and for events (which carry host time).
#
# Device time starts again when the craft restarts; a view that follows the newest data would then
# show the old flight for ever. What follows a restart is therefore moved behind what came before
# it, by the silence that the host measured.


class Clock(Protocol):
    """Times in ns on the common axis."""

    def advance(self, batch: SampleBatch) -> NDArray[np.int64]:
        """Times of the next samples, shape (n,)."""

    def at_host(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Times of the Unix times ``time_ns``, both shape (n,)."""


class LiveClock:
    """Knows what has been seen so far; before the first sample everything is at zero."""

    def __init__(self) -> None:
        self._offset_ns = 0
        self._segment: int | None = None
        self._last: tuple[int, int] | None = None

    def advance(self, batch: SampleBatch) -> NDArray[np.int64]:
        times = np.rint(batch.time_s * 1e9).astype(np.int64)
        for rows in _segments(batch):
            if self._last is not None:
                last_ns, last_host_ns = self._last
                if times[rows.start] + self._offset_ns < last_ns:
                    silence_ns = max(
                        int(batch.host_time_ns[rows.start]) - last_host_ns,
                        round(SAMPLE_PERIOD_S * 1e9),
                    )
                    self._offset_ns = last_ns + silence_ns - int(times[rows.start])
            times[rows] += self._offset_ns
            self._last = int(times[rows.stop - 1]), int(batch.host_time_ns[rows.stop - 1])
        if len(batch):
            self._segment = int(batch.segment[-1])
        return times

    def at_device(self, segment: int, time_s: NDArray[np.float64]) -> NDArray[np.int64] | None:
        """Of device times (n,) in a segment; None where it is not the one of the newest sample."""
        if segment != self._segment:
            return None
        return np.rint(time_s * 1e9).astype(np.int64) + self._offset_ns

    def at_host(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        if self._last is None:
            return np.zeros_like(time_ns)
        last_ns, last_host_ns = self._last
        return time_ns - last_host_ns + last_ns


class RecordedClock:
    """Knows all samples of a recording from the start, so that events fall between them."""

    def __init__(self, samples: SampleBatch) -> None:
        self._times = LiveClock().advance(samples)
        self._hosts = np.maximum.accumulate(samples.host_time_ns)
        self._next = 0

    def advance(self, batch: SampleBatch) -> NDArray[np.int64]:
        self._next += len(batch)
        return self._times[self._next - len(batch) : self._next]

    def at_host(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        if not len(self._times):
            return time_ns - time_ns[:1]
        before = np.searchsorted(self._hosts, time_ns, side="right") - 1
        nearest = np.clip(before, 0, None)
        return self._times[nearest] + time_ns - self._hosts[nearest]


def _segments(batch: SampleBatch) -> Iterator[slice]:
    """Stretches of uninterrupted device time."""
    edges = np.flatnonzero(np.diff(batch.segment)) + 1
    bounds = [0, *edges.tolist(), len(batch)] if len(batch) else []
    for start, stop in pairwise(bounds):
        yield slice(start, stop)


# A new .rrd file: whole under its name, or not there at all.


ROWS_PER_CHUNK = 4096


@contextlib.contextmanager
def fresh_rrd(path: Path) -> Iterator[Path]:
    """Within the block, write to the file it gives; in the end that becomes the new ``path``.

    Raises BadInputError when ``path`` exists, its folder does not or rerun is not installed,
    RecordingError when the file could not be written completely; nothing half-written is left
    behind.
    """
    require_rerun(f"{path}: an .rrd file")
    if path.exists():
        raise BadInputError(taken(path))
    if not path.parent.is_dir():
        raise BadInputError(f"{path.parent} is not a folder: create it first")
    os.environ.setdefault("RUST_LOG", "off")  # what goes wrong is raised, and said once
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        _require_footer(part)
        os.link(part, path)  # unlike a rename, fails when the name was taken meanwhile
    except FileExistsError as error:
        raise BadInputError(taken(path)) from error
    except (OSError, RuntimeError, ValueError) as error:
        raise RecordingError(
            f"{path} could not be written ({_first_line(error)}): is there space on the disk?"
        ) from error
    finally:
        part.unlink(missing_ok=True)


def send_series(stream: Any, entity: str, time_s: Any, values: Any) -> None:
    """Log the rows (n,) of a series that are known, by device time; the others are gaps."""
    import rerun as rr

    known = np.flatnonzero(np.isfinite(values))
    for first in range(0, len(known), ROWS_PER_CHUNK):
        rows = known[first : first + ROWS_PER_CHUNK]
        times = np.rint(time_s[rows] * 1e9).astype("timedelta64[ns]")
        stream.send_columns(
            entity,
            indexes=[rr.TimeColumn(DEVICE_TIME, duration=times)],
            columns=rr.Scalars.columns(scalars=values[rows]),
            strict=True,
        )


def _require_footer(path: Path) -> None:
    """Raises RuntimeError for a torn file: rerun's writer may stop without an exception."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it warns of is what it raises
        RrdReader(path).store()


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


# Whether rerun is there: an extra, for it is larger than all the rest.


def require_rerun(what: str) -> None:
    """Raises BadInputError, which names the extra to install, where rerun is missing.

    what: what needs it, as the sentence's subject.
    """
    if importlib.util.find_spec("rerun") is None:
        raise BadInputError(
            f"{what} needs rerun, an optional part of some 500 MB: {install('viewer')}"
        )


def rerun_program() -> Path:
    """The rerun executable itself (the ``rerun`` script only starts it as another child).

    Raises BadInputError when rerun is not installed, GroundStationError when only its program is
    missing.
    """
    require_rerun("the live view (--viewer off: everything but it)")
    package = importlib.util.find_spec("rerun_cli")
    folder = Path(package.origin).parent if package and package.origin else Path()
    program = Path(os.environ.get("RERUN_CLI_PATH", folder / "rerun"))
    if package is None or not os.access(program, os.X_OK):
        raise GroundStationError(
            f"the rerun program is missing ({program}): pip install --force-reinstall rerun-sdk, "
            "or use --viewer off"
        )
    return program


def rerun_command() -> str:
    """What a user types to start it."""
    script = Path(sys.executable).with_name("rerun")
    on_path = shutil.which("rerun")
    return "rerun" if on_path or not script.exists() else shlex.quote(str(script))
