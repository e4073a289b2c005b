"""What the viewer is told: samples, events and statistics as rerun columns.

Live view and .rrd export share this module, so that both look the same. People get degrees,
deg/s, g, per cent and volts; the values stay exact, because a float32 in SI survives the way
through float64 and back (``unscaled``).

| entity | values |
|---|---|
| /craft | orientation of the craft: body FLU in the world ENU |
| /telemetry/attitude, rates, accelerometer, motors, battery, rotors | see ``GROUPS`` |
| /telemetry/packet | ticks, tick_s, segment, copies, debug: for an exact read-back |
| /link, /link/NAME | link statistics: as JSON, and each number for itself |
| /events, /commands | what happened and what was commanded: as text, and as JSON |

Timelines: ``device_time`` (duration), ``seq`` (number of the sample) and ``host_time`` (Unix).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch
from groundstation.viewer.device_clock import Clock

APPLICATION = "groundstation"
DEVICE_TIME = "device_time"
SEQUENCE = "seq"
HOST_TIME = "host_time"

CRAFT = "/craft"
PACKET = "/telemetry/packet"
EVENTS = "/events"
COMMANDS = "/commands"
LINK = "/link"

PACKET_COLUMNS = ("ticks", "segment", "copies", "debug")
PACKET_ARCHETYPE = "groundstation.Packet"
ENTRY_ARCHETYPE = "groundstation.Entry"

ROLL, PITCH, YAW = (239, 83, 80), (102, 187, 106), (66, 165, 245)
MOTORS = ((255, 167, 38), (38, 198, 218), (171, 127, 230), (212, 225, 87))
"""Colours of M1..M4, the same on the craft and in the plots."""
NOSE = (255, 64, 129)


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


GROUPS: tuple[Group, ...] = (
    Group(
        "/telemetry/attitude",
        "attitude",
        180 / np.pi,
        ("roll", "pitch (nose down +)", "yaw"),
        (ROLL, PITCH, YAW),
    ),
    Group(
        "/telemetry/rates",
        "gyro",
        180 / np.pi,
        ("roll rate", "pitch rate", "yaw rate"),
        (ROLL, PITCH, YAW),
    ),
    Group(
        "/telemetry/accelerometer",
        "accelerometer",
        1 / STANDARD_GRAVITY,
        ("forward", "left", "up"),
        (ROLL, PITCH, YAW),
    ),
    Group(
        "/telemetry/motors",
        "duty",
        100.0,
        ("M1 front", "M2 right", "M3 rear", "M4 left"),
        MOTORS,
    ),
    Group("/telemetry/battery", "battery_v", 1.0, ("battery",), ((255, 202, 40),)),
    Group("/telemetry/rotors", "rotor_rev_s", 60.0, ("M1", "M2", "M3", "M4"), MOTORS),
)
"""Shown in degrees, deg/s, g, % duty, V and rpm."""

STATISTICS: dict[str, tuple[str, tuple[int, int, int]]] = {
    "loss_pct": ("lost (%)", (239, 83, 80)),
    "latency_ms": ("latency (ms)", (255, 202, 40)),
    "rate_hz": ("samples (1/s)", (102, 187, 106)),
}
"""The statistics that the blueprint shows; any other is logged under its own name."""

_LEVELS = {
    "lost": rr.TextLogLevel.ERROR,
    "fault": rr.TextLogLevel.ERROR,
    "silent": rr.TextLogLevel.WARN,
    "restart": rr.TextLogLevel.WARN,
}


class ViewerLog:
    """Writes to one rerun stream, everything on the axis of ``clock``."""

    def __init__(self, stream: rr.RecordingStream, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock
        self._named: set[str] = set()

    def craft(self) -> None:
        """The drawing of the craft and the names of the series: static, sent once."""
        for entity, archetype in craft_drawing():
            self._stream.log(entity, archetype, static=True, strict=True)
        for group in GROUPS:
            lines = rr.SeriesLines(names=group.names, colors=group.colors, widths=1.5)
            self._stream.log(group.entity, lines, static=True, strict=True)

    def samples(self, batch: SampleBatch, first_seq: int) -> None:
        """Log a batch whose first sample has the number ``first_seq``."""
        if not len(batch):
            return
        indexes = [
            _device_time(self._clock.advance(batch)),
            rr.TimeColumn(SEQUENCE, sequence=np.arange(first_seq, first_seq + len(batch))),
            _host_time(batch.host_time_ns),
        ]
        for entity, columns in sample_columns(batch):
            self._stream.send_columns(entity, indexes=indexes, columns=columns, strict=True)

    def entries(self, entity: str, entries: Sequence[Mapping[str, Any]]) -> None:
        """Log events or commands: dictionaries with ``time_ns`` (Unix) and whatever JSON can say.

        People read ``link`` and ``text`` where an entry has them, and the JSON otherwise.
        """
        texts, levels = [], []
        for entry in entries:
            text = str(entry.get("text") or _json(entry))
            texts.append(f"{entry['link']}: {text}" if entry.get("link") else text)
            levels.append(_LEVELS.get(str(entry.get("kind")), rr.TextLogLevel.INFO))
        columns = rr.TextLog.columns(text=texts, level=levels)
        self._send(entity, _times(entries), [*columns, *_json_columns(entries)])

    def statistics(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Log link statistics: dictionaries with ``time_ns`` and numbers, one entity each."""
        times = _times(entries)
        self._send(LINK, times, _json_columns(entries))
        names = dict.fromkeys(name for entry in entries for name in entry if name != "time_ns")
        for name in names:
            found = [isinstance(entry.get(name), int | float) for entry in entries]
            values = [entry[name] for entry, present in zip(entries, found, strict=True) if present]
            if not values:
                continue
            entity = f"{LINK}/{name}"
            if name not in self._named:
                label, color = STATISTICS.get(name, (name.replace("_", " "), (158, 158, 158)))
                lines = rr.SeriesLines(names=label, colors=color, widths=1.5)
                self._stream.log(entity, lines, static=True, strict=True)
                self._named.add(name)
            self._send(entity, times[found], rr.Scalars.columns(scalars=values))

    def _send(self, entity: str, times: NDArray[np.int64], columns: Any) -> None:
        if len(times):
            indexes = [_device_time(self._clock.at_host(times)), _host_time(times)]
            self._stream.send_columns(entity, indexes=indexes, columns=columns, strict=True)


def sample_columns(batch: SampleBatch) -> Iterator[tuple[str, Any]]:
    """Entity and rerun columns for every channel of which the batch has at least one value."""
    for group in GROUPS:
        values = getattr(batch, group.column)
        if not np.isnan(values).all():
            yield group.entity, rr.Scalars.columns(scalars=values.astype(np.float64) * group.per_si)
    if not np.isnan(batch.attitude).any():
        yield CRAFT, rr.Transform3D.columns(quaternion=quaternions(batch.attitude))
    columns = {name: getattr(batch, name) for name in PACKET_COLUMNS}
    columns["tick_s"] = np.full(len(batch), batch.tick_s)
    yield PACKET, rr.DynamicArchetype.columns(PACKET_ARCHETYPE, components=columns)


def unscaled(group: Group, shown: NDArray[np.float64]) -> NDArray[np.float32]:
    """Undo ``sample_columns`` to the last bit of the float32."""
    return (shown / group.per_si).astype(np.float32)


def quaternions(attitude: NDArray[np.float32]) -> NDArray[np.float32]:
    """Roll, pitch, yaw in rad, shape (n, 3), as xyzw, shape (n, 4): body FLU to world ENU.

    The rotation of thesis eq. 3.6: Rz(yaw) Ry(pitch) Rx(roll), pitch nose down positive.
    """
    half = attitude.astype(np.float64) / 2
    (sx, sy, sz), (cx, cy, cz) = np.sin(half).T, np.cos(half).T
    return np.stack(
        [
            sx * cy * cz - cx * sy * sz,
            cx * sy * cz + sx * cy * sz,
            cx * cy * sz - sx * sy * cz,
            cx * cy * cz + sx * sy * sz,
        ],
        axis=1,
    ).astype(np.float32)


def craft_drawing() -> Iterator[tuple[str, Any]]:
    """A Crazyflie in plus configuration, metres, body FLU, above a compass rose in world ENU."""
    yield "/", rr.ViewCoordinates.RIGHT_HAND_Z_UP
    arm, rotor_radius, rotor_height = 0.046, 0.0225, 0.013
    tips = np.array([(arm, 0, 0), (0, -arm, 0), (-arm, 0, 0), (0, arm, 0)])
    metal, dark = (176, 182, 192), (96, 102, 112)
    yield (
        f"{CRAFT}/arms",
        rr.LineStrips3D([tips[[0, 2]], tips[[1, 3]]], radii=0.0028, colors=dark),
    )
    yield (
        f"{CRAFT}/board",
        rr.Boxes3D(
            half_sizes=[(0.015, 0.015, 0.0015), (0.012, 0.008, 0.004)],
            centers=[(0, 0, 0.002), (0, 0, 0.007)],
            colors=[dark, metal],
            fill_mode="solid",
        ),
    )
    yield (
        f"{CRAFT}/motors",
        rr.Cylinders3D(
            lengths=[0.02] * 4,
            radii=[0.004] * 4,
            centers=tips + np.array([0, 0, 0.002]),
            colors=metal,
            fill_mode="solid",
        ),
    )
    yield (
        f"{CRAFT}/rotors",
        rr.Cylinders3D(
            lengths=[0.0015] * 4,
            radii=[rotor_radius] * 4,
            centers=tips + np.array([0, 0, rotor_height]),
            colors=MOTORS,
            fill_mode="solid",
        ),
    )
    yield (
        f"{CRAFT}/nose",
        rr.Arrows3D(
            origins=[(arm, 0, rotor_height + 0.004)],
            vectors=[(0.052, 0, 0)],
            radii=0.0022,
            colors=NOSE,
        ),
    )
    yield from _compass_rose(radius=0.105, below=0.06)


def _compass_rose(radius: float, below: float) -> Iterator[tuple[str, Any]]:
    """A still reference under the craft: a circle with a mark every 30 deg, east and north."""
    grey = (120, 126, 138)
    angles = np.radians(np.arange(0, 361, 5))
    circle = np.stack([np.cos(angles), np.sin(angles), np.full(len(angles), -below)], axis=1)
    circle[:, :2] *= radius
    marks = [np.array([point, point * (0.92, 0.92, 1)]) for point in circle[:-1:6]]
    cross = [circle[[0, 36]], circle[[18, 54]], np.array([(0, 0, -below), (0, 0, 0)])]
    yield (
        "/world/compass",
        rr.LineStrips3D([circle, *marks, *cross], radii=0.0005, colors=grey),
    )
    yield (
        "/world/directions",
        rr.Points3D(
            circle[[0, 18]] * (1.12, 1.12, 1),
            labels=["east (x)", "north (y)"],
            radii=0.0005,
            colors=grey,
            show_labels=True,
        ),
    )


def _device_time(times_ns: NDArray[np.int64]) -> rr.TimeColumn:
    return rr.TimeColumn(DEVICE_TIME, duration=times_ns.astype("timedelta64[ns]"))


def _host_time(times_ns: NDArray[np.int64]) -> rr.TimeColumn:
    return rr.TimeColumn(HOST_TIME, timestamp=times_ns.astype("datetime64[ns]"))


def _times(entries: Sequence[Mapping[str, Any]]) -> NDArray[np.int64]:
    return np.array([entry["time_ns"] for entry in entries], np.int64)


def _json(entry: Mapping[str, Any]) -> str:
    return json.dumps(dict(entry), default=str)


def _json_columns(entries: Sequence[Mapping[str, Any]]) -> Any:
    return rr.DynamicArchetype.columns(
        ENTRY_ARCHETYPE, components={"json": [_json(entry) for entry in entries]}
    )
