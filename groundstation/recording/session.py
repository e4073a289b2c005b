"""What reading a recording gives, whatever its format."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import RawBatch, SampleBatch

if TYPE_CHECKING:
    from groundstation.dynamics.model import Model

# The single channels of a sample batch, in the units in which people read them.


@dataclass(frozen=True, slots=True)
class Channel:
    """One column of numbers: shown value = ``scale`` x the sample's own value."""

    name: str
    unit: str
    suffix: str
    """The unit as part of a table's header."""
    field: str
    index: int | None
    scale: float

    @property
    def header(self) -> str:
        """Name and unit, as in ``gyro_x_deg_s``; a duty has no unit."""
        return f"{self.name}_{self.suffix}" if self.suffix else self.name

    def of(self, samples: SampleBatch) -> NDArray[np.float32]:
        """The channel in the samples' own unit, shape (n,), a view."""
        values: NDArray[np.float32] = getattr(samples, self.field)
        return values if self.index is None else values[:, self.index]

    def shown(self, samples: SampleBatch) -> NDArray[np.float64]:
        """The channel in ``unit``, shape (n,)."""
        return self.of(samples).astype(np.float64) * self.scale

    def is_in(self, samples: SampleBatch) -> bool:
        """Whether the channel has any value."""
        return bool(np.isfinite(self.of(samples)).any())


def _channels() -> tuple[Channel, ...]:
    degree, g = 180 / np.pi, 1 / STANDARD_GRAVITY
    angles = ("roll", "pitch", "yaw")
    motors = range(4)
    return (
        Channel("battery", "V", "v", "battery_v", None, 1.0),
        *(Channel(f"duty_{m + 1}", "1", "", "duty", m, 1.0) for m in motors),
        *(Channel(f"gyro_{a}", "deg/s", "deg_s", "gyro", i, degree) for i, a in enumerate("xyz")),
        *(
            Channel(f"accelerometer_{a}", "g", "g", "accelerometer", i, g)
            for i, a in enumerate("xyz")
        ),
        *(Channel(a, "deg", "deg", "attitude", i, degree) for i, a in enumerate(angles)),
        *(Channel(f"rotor_{m + 1}", "rpm", "rpm", "rotor_rev_s", m, 60.0) for m in motors),
        *(Channel(f"duty_step_{m + 1}", "1", "", "duty_step", m, 1.0) for m in motors),
    )


CHANNELS = _channels()
"""Battery, duties, gyro, accelerometer, attitude (pitch nose down positive), rotors, and what slow
rows know of two settings."""
UNUSUAL = ("rotor_rev_s", "duty_step")
"""Fields that most sources do not have and nobody misses; older recordings know them not."""


# A recording in memory, whatever file it came from.


@dataclass(frozen=True, slots=True)
class Table:
    """Any other series a file holds (a motion-capture event, say), values as stored.

    time_s: (n,) float64 on the device's clock.
    columns: name -> (n,) array, in the file's own type and unit.
    """

    time_s: NDArray[np.float64]
    columns: dict[str, NDArray[np.generic]]


@dataclass(slots=True)
class Recording:
    """Everything a file says.

    samples: decoded, deduplicated.
    raw: packets as received, or None where the source never had packets or they were not
        asked for.
    commands, events, statistics: dictionaries as recorded, in order of time.
    tables: further series by name; for a microSD log every event of the file, all values.
    metadata: name -> key -> text.
    damage: one line for each thing that could not be read; empty for a sound file.
    being_written: by a recorder, when it was read: more will come.
    """

    path: Path
    kind: str
    """mcap, csv, microsd, parquet, npz, ulog or rosbag."""
    samples: SampleBatch
    raw: RawBatch | None = None
    commands: list[dict[str, Any]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    statistics: list[dict[str, Any]] = field(default_factory=list)
    tables: dict[str, Table] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)
    being_written: bool = False

    def __repr__(self) -> str:
        more = f", {len(self.damage)} damaged places" if self.damage else ""
        return f"Recording({str(self.path)!r}, {self.kind}: {self.samples!r}{more})"

    @property
    def link(self) -> str:
        """The link that made the recording, or the kind of file where none did."""
        return self.metadata.get("session", {}).get("link", self.kind)


# One series of a log that has many.


@dataclass(frozen=True, slots=True)
class Series:
    """One series of a log.

    time_ns: (n,) when each row came, in order, on a clock that all series of the file share.
    columns: name -> (n,) numbers.
    type: of its messages, or empty.
    """

    name: str
    time_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.generic]]
    type: str = ""


@dataclass(frozen=True, slots=True)
class Log:
    """A log of many series. unread: types of series that could not be read."""

    series: Sequence[Series]
    found: Findings
    unread: Sequence[str] = ()


# What a reader finds besides rows, and under which names it is in a recording's metadata.


UNCLEAR_METADATA = "unclear"
"""Metadata record of what a file leaves open, field -> words."""
NO_CHANNEL = "channels"
"""Its field that says which columns there are instead, where none is of a channel."""
NOTES_METADATA = "notes"
"""Metadata record of what was found while reading and settled."""
ROWS_METADATA = "rows"
"""Metadata record of what became of a file's rows: ``RowOrder.notes``."""


@dataclass(slots=True)
class Findings:
    """damage: a line for each thing that could not be read. notes: what was settled. unclear: field
    -> what is left open."""

    damage: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    unclear: dict[str, str] = field(default_factory=dict)

    def metadata(self, rows: dict[str, str]) -> dict[str, dict[str, str]]:
        """The records that are not empty. rows: ``RowOrder.notes``."""
        records = {
            NOTES_METADATA: {str(k): note for k, note in enumerate(self.notes, 1)},
            UNCLEAR_METADATA: self.unclear,
            ROWS_METADATA: rows,
        }
        return {name: record for name, record in records.items() if record}


# Which rows of a table are read, and how far apart they are.


@dataclass(frozen=True, slots=True)
class Rows:
    """only: a column and the value that it has in the rows that are read; None: all rows. rate_hz:
    rows a second of a table without a time column; 0: there is one."""

    only: tuple[str, str] | None = None
    rate_hz: float = 0.0

    def __bool__(self) -> bool:
        return self.only is not None or self.rate_hz > 0.0


EVERY_ROW = Rows()


def rows_of(only: str | None, rate_hz: float | None) -> Rows:
    """As a command line says it: ``COLUMN=VALUE``, and rows a second.

    Raises BadInputError where there is no ``=``.
    """
    if only is None:
        return Rows(None, rate_hz or 0.0)
    column, mark, value = only.partition("=")
    if not mark or not column:
        raise BadInputError(f"--only {only!r}: must be COLUMN=VALUE, as in --only id=7")
    return Rows((column, value), rate_hz or 0.0)


# Host stamps of files that carry none, made from device time.


RESTART_PAUSE_S = 2.0
"""Silence put before a segment that starts earlier than the one before it ended: long enough
to be taken for a restart when the recording is replayed (1 s of silence declares one)."""

_LATEST_NS = 1 << 61
"""Segments of nonsense (decades each) stop adding up here, below what 64 bits hold."""

SYNTHESISED = {"source": "made from device time"}
"""Metadata record ``host_time`` of a recording whose host stamps were never measured."""


def host_time_from_ticks(
    ticks: NDArray[np.int64], tick_s: float, segment: NDArray[np.int32]
) -> NDArray[np.int64]:
    """Host stamps in ns, shape (n,), that keep every device interval and never run backwards.

    The first segment starts at its own device time (the Unix epoch plus that), so that the
    same file always gives the same stamps. Device time must lie within +-2^62 ns.
    """
    if len(ticks) == 0:
        return np.empty(0, np.int64)
    device_ns = np.rint(ticks.astype(np.float64) * (tick_s * 1e9)).astype(np.int64)
    starts = np.flatnonzero(np.diff(segment, prepend=segment[0] - 1))
    ends = np.append(starts[1:], len(ticks)) - 1
    offset_ns = np.zeros(len(ticks), np.int64)
    earliest_ns = 0
    for start, end in zip(starts, ends, strict=True):
        shift_ns = max(0, earliest_ns - int(device_ns[start]))
        offset_ns[start : end + 1] = shift_ns
        ended_ns = int(device_ns[end]) + shift_ns
        earliest_ns = min(ended_ns + round(RESTART_PAUSE_S * 1e9), _LATEST_NS)
    return device_ns + offset_ns


# Which Crazyflie a file is from, as far as its names and ranges tell.
#
# A file that was not made here does not name its craft. What it holds may still exclude the
# Crazyflie 1.0, whose profile is the default: ``family_of`` says so, and ``fit`` and the others
# then ask.


TODAY = "2.x"
"""A Crazyflie 2.x or Brushless; which of them, no log says."""
UNKNOWN = "unknown"

_TODAYS_GROUPS = frozenset(
    {"stateEstimate", "stateEstimateZ", "kalman", "ctrltarget", "controller", "rpm", "pwm"}
)
"""Groups of log variables that the firmware of 2014 does not have."""
_TODAYS_NAMES = frozenset({"pm.vbatMV", "motor.m1req", "motor.m1_rpm"})
_MOST_G_OF_1 = 8.0 * np.sqrt(3.0) * 1.01
"""The 1.0 measures to 8 g an axis, a 2.x to 24 g."""


def family_of(names: Collection[str], samples: SampleBatch) -> dict[str, str]:
    """The ``vehicle`` metadata of a file that names no craft: its family, and why.

    names: variables or columns as the file spells them.
    """
    by_name = sorted(
        name
        for name in names
        if (name.split(".")[0] in _TODAYS_GROUPS and "." in name) or name in _TODAYS_NAMES
    )
    if by_name:
        return {"family": TODAY, "because": f"only a 2.x logs {by_name[0]}"}
    force = samples.accelerometer[np.isfinite(samples.accelerometer).all(axis=1)]
    most_g = float(np.linalg.norm(force, axis=1).max(initial=0.0)) / STANDARD_GRAVITY
    if most_g > _MOST_G_OF_1:
        return {"family": TODAY, "because": f"{most_g:.0f} g are beyond a 1.0's sensor"}
    return {"family": UNKNOWN, "because": "the file does not say"}


def vehicle_of(
    recordings: Sequence[Recording], given: str | None, model: Model | None = None
) -> str | None:
    """The profile that the user gave, or the one that the recordings name; None where neither does.

    model: what their craft is taken for where nobody names it.

    Raises BadInputError where they name several, or where one may be of another craft than the
    model's, than crazyflie1 without a model.
    """
    if given is not None:
        return given
    said = {one.path.name: one.metadata.get("vehicle", {}).get("profile") for one in recordings}
    labels = {label for label in said.values() if label is not None}
    if len(labels) > 1:
        listed = ", ".join(f"{name} of {label!r}" for name, label in said.items() if label)
        raise BadInputError(
            f"recordings of several vehicles ({listed}); fit one at a time, or, if a label is"
            " wrong, say --vehicle"
        )
    label = labels.pop() if labels else None
    for one in recordings:
        require_family(one, label or (model.vehicle if model is not None else None), model)
    return label


def require_family(recording: Recording, vehicle: str | None, model: Model | None = None) -> None:
    """Raises BadInputError where a recording that names no craft cannot be, or need not be, one of
    ``vehicle`` (None: nobody said which), whose profile ``model`` may hold.

    A profile of the user's own is the user's word on what flew: only a built-in one says whose
    firmware its craft has, and can contradict."""
    from groundstation.dynamics.model import model_vehicle
    from groundstation.dynamics.vehicle import BUILT_IN, load_vehicle

    said = recording.metadata.get("vehicle", {})
    if "family" not in said or "profile" in said:
        return
    family, why = said["family"], said.get("because", "")
    listed = ", ".join(
        name for name, one in BUILT_IN.items() if family == "unknown" or one.firmware == family
    )
    if vehicle is None:
        what = "its craft is not known" if family == "unknown" else f"of a Crazyflie {family}"
        raise BadInputError(
            f"{recording.path}: {what} ({why}); say which with --vehicle {listed}, or a TOML"
            " profile"
        )
    if model is not None and model.vehicle == vehicle:
        flown = model_vehicle(model)
    else:
        flown = load_vehicle(vehicle)
    if flown.name not in BUILT_IN:
        return
    if family != "unknown" and flown.firmware != family:
        raise BadInputError(
            f"{recording.path}: of a Crazyflie {family} ({why}), not of {vehicle!r}; say which"
            f" with --vehicle {listed}, or a TOML profile"
        )


def require_craft_of(recording: Recording, model: Model) -> None:
    """Raises BadInputError where a recording says, or shows, that it is of another vehicle than the
    model's."""
    recorded = recording.metadata.get("vehicle", {}).get("profile", model.vehicle)
    if recorded != model.vehicle:
        raise other_vehicle(recording.path.name, recorded, model)
    require_family(recording, model.vehicle, model)


def other_vehicle(what: str, recorded: str, model: Model) -> BadInputError:
    """What to say where ``what`` is of another vehicle than the model."""
    return BadInputError(
        f"{what}: the vehicle is {recorded!r}, the model is for {model.vehicle!r}; fit a model to"
        f" this vehicle, or, if the recording's label is wrong, say --vehicle {model.vehicle}"
    )
