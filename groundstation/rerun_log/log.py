"""Samples, events and statistics as rerun columns: the live view and .rrd files look the same."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.rerun_log.channels import (
    CRAFT,
    DEVICE_TIME,
    GROUPS,
    HOST_TIME,
    LINK,
    STATISTICS,
    TABLES,
    scaled,
)
from groundstation.rerun_log.craft import craft_drawing
from groundstation.rerun_log.device_clock import Clock
from groundstation.telemetry.samples import SampleBatch

_LEVELS = {
    "lost": rr.TextLogLevel.ERROR,
    "fault": rr.TextLogLevel.ERROR,
    "silent": rr.TextLogLevel.WARN,
    "restart": rr.TextLogLevel.WARN,
    "gap": rr.TextLogLevel.WARN,
}


class ViewerLog:
    """Writes to one rerun stream, everything on the axis of ``clock``."""

    def __init__(self, stream: rr.RecordingStream, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock

    def craft(self) -> None:
        """The drawing of the craft and the names of the series: static, sent once."""
        for entity, archetype in craft_drawing():
            self._stream.log(entity, archetype, static=True, strict=True)
        for group in GROUPS:
            lines = rr.SeriesLines(names=group.names, colors=group.colors, widths=1.5)
            self._stream.log(group.entity, lines, static=True, strict=True)
        for name, (label, color) in STATISTICS.items():
            lines = rr.SeriesLines(names=label, colors=color, widths=1.5)
            self._stream.log(f"{LINK}/{name}", lines, static=True, strict=True)

    def samples(self, batch: SampleBatch) -> None:
        if not len(batch):
            return
        times = self._clock.advance(batch)
        indexes = [_duration(DEVICE_TIME, times), _host_time(batch.host_time_ns)]
        for entity, columns in sample_columns(batch):
            self._stream.send_columns(entity, indexes=indexes, columns=columns, strict=True)

    def entries(self, entity: str, entries: Sequence[Mapping[str, Any]]) -> None:
        """Log events or commands: dictionaries with ``time_ns`` (Unix) and whatever JSON can say.

        Shown as ``link`` and ``text`` where an entry has them, and as JSON otherwise.
        """
        texts, levels = [], []
        for entry in entries:
            text = str(entry.get("text") or _json(entry))
            texts.append(f"{entry['link']}: {text}" if entry.get("link") else text)
            levels.append(_LEVELS.get(str(entry.get("kind")), rr.TextLogLevel.INFO))
        self._send(entity, _times(entries), rr.TextLog.columns(text=texts, level=levels))

    def statistics(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Log link statistics: dictionaries with ``time_ns`` (Unix) and numbers by name."""
        times = _times(entries)
        for name in STATISTICS:
            values = np.array([entry.get(name) for entry in entries], np.float64)
            known = ~np.isnan(values)
            columns = rr.Scalars.columns(scalars=values[known])
            self._send(f"{LINK}/{name}", times[known], columns)

    def series(
        self, path: Sequence[str], times_ns: NDArray[np.int64], values: NDArray[np.float64]
    ) -> None:
        """Log numbers (n,) of Unix times (n,) below ``TABLES``."""
        known = np.isfinite(values)
        columns = rr.Scalars.columns(scalars=values[known])
        self._send(rr.new_entity_path([TABLES, *path]), times_ns[known], columns)

    def _send(self, entity: str, times: NDArray[np.int64], columns: Any) -> None:
        if len(times):
            indexes = [_duration(DEVICE_TIME, self._clock.at_host(times)), _host_time(times)]
            self._stream.send_columns(entity, indexes=indexes, columns=columns, strict=True)


def sample_columns(batch: SampleBatch) -> Iterator[tuple[str, Any]]:
    """Entity and rerun columns for every channel of which the batch has at least one value."""
    for group in GROUPS:
        values = getattr(batch, group.column)
        if not np.isnan(values).all():
            yield group.entity, rr.Scalars.columns(scalars=scaled(group, values))
    if not np.isnan(batch.attitude).any():
        yield CRAFT, rr.Transform3D.columns(quaternion=quaternions(batch.attitude))


def quaternions(attitude: NDArray[np.float32]) -> NDArray[np.float32]:
    """Roll, pitch, yaw in rad, shape (n, 3), as xyzw, shape (n, 4): body FLU to world ENU."""
    return np.roll(quaternion_of_attitude(attitude), -1, axis=-1).astype(np.float32)


def _duration(timeline: str, times_ns: NDArray[np.int64]) -> rr.TimeColumn:
    return rr.TimeColumn(timeline, duration=times_ns.astype("timedelta64[ns]"))


def _host_time(times_ns: NDArray[np.int64]) -> rr.TimeColumn:
    return rr.TimeColumn(HOST_TIME, timestamp=times_ns.astype("datetime64[ns]"))


def _times(entries: Sequence[Mapping[str, Any]]) -> NDArray[np.int64]:
    return np.array([entry["time_ns"] for entry in entries], np.int64)


def _json(entry: Mapping[str, Any]) -> str:
    return json.dumps(dict(entry), default=str)
