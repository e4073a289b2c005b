"""What rerun shows of a flight: series, the craft, layouts. Imports rerun."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.encodings import TextLogColumn, TimelineColumn

from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.rerun_log.channels import (
    CRAFT,
    DEVICE_TIME,
    EVENTS,
    GROUPS,
    HOST_TIME,
    LINK,
    MOTORS,
    STATISTICS,
    TABLES,
    Clock,
    scaled,
)
from groundstation.telemetry.samples import SampleBatch

# The layout a pilot flies by: the craft on the left, its signals on the right.


LIVE_WINDOW_S = 10.0
"""A live plot shows this much of the newest device time."""


def pilot_blueprint(
    *, window_s: float | None, twin: bool = False, tables: bool = False
) -> rrb.Blueprint:
    """The views over device time.

    window_s: length of the plots, which follow the newest data; None shows all there is, for a
    finished recording. twin: with a tab, in front, of what the live twin predicts. tables:
    with a tab of what the craft logs besides its telemetry.
    """
    bounds = rr.TimeRangeBoundary
    window = rr.VisibleTimeRange(
        DEVICE_TIME,
        start=bounds.infinite() if window_s is None else bounds.cursor_relative(seconds=-window_s),
        end=bounds.infinite() if window_s is None else bounds.cursor_relative(),
    )

    def plot(name: str, *entities: str, low: float | None = None, high: float | None = None) -> Any:
        return rrb.TimeSeriesView(
            name=name,
            origin="/",
            contents=list(entities),
            time_ranges=window,
            axis_y=None if low is None or high is None else rrb.ScalarAxis(range=(low, high)),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
        )

    left = rrb.Vertical(
        _craft_view(),
        rrb.Horizontal(
            plot("Battery (V)", "/telemetry/battery", low=2.9, high=4.3),
            plot("Samples per second", f"{LINK}/rate_hz"),
        ),
        plot("Link: loss (%), latency (ms)", f"{LINK}/loss_pct", f"{LINK}/latency_ms"),
        _events_view(),
        row_shares=[6, 2, 2, 2],
    )
    right = rrb.Vertical(
        plot("Attitude (deg)", "/telemetry/attitude"),
        plot("Rates (deg/s)", "/telemetry/rates"),
        plot("Accelerometer (g)", "/telemetry/accelerometer"),
        plot("Motors (% duty)", "/telemetry/motors", low=0.0, high=100.0),
        name="Telemetry",
    )
    tabs = [right]
    if tables:
        tabs.append(rrb.Vertical(plot("What else the craft logs", f"/{TABLES}/**"), name="Log"))
    if twin:
        beside = rrb.Vertical(
            plot("Rates: measured, and predicted 50 ms before (deg/s)", "/twin/rates/**"),
            plot("Attitude (deg)", "/twin/attitude/**"),
            plot("Accelerometer up (g)", "/twin/accelerometer/**"),
            plot("Gap: prediction error over noise (1: the model is right)", "/twin/gap"),
            name="Twin",
        )
        tabs.insert(0, beside)
    if len(tabs) > 1:
        right = rrb.Tabs(*tabs, active_tab=0)
    return layout_of(rrb.Horizontal(left, right, column_shares=[4, 5]), follow=window_s is not None)


def _craft_view() -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name="Craft",
        origin="/",
        contents=[f"{CRAFT}/**", "/world/**"],
        background=rrb.Background(color=(21, 24, 30)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(-0.14, -0.105, 0.155),
            look_target=(0.0, 0.0, -0.022),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )


def _events_view() -> rrb.TextLogView:
    return rrb.TextLogView(
        name="Events",
        origin=EVENTS,
        contents=[EVENTS],
        columns=rrb.TextLogColumns(
            timeline_columns=[TimelineColumn(DEVICE_TIME)],
            text_log_columns=[TextLogColumn("LogLevel"), TextLogColumn("Body")],
        ),
    )


def layout_of(views: Any, follow: bool = False) -> rrb.Blueprint:
    """Views and nothing else, from the first moment on, or following the newest data."""
    return rrb.Blueprint(
        views,
        rrb.TopPanel(state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(
            state="collapsed", timeline=DEVICE_TIME, play_state="following" if follow else "paused"
        ),
        auto_views=False,
        auto_layout=False,
    )


# The drawing of the craft.


NOSE = (255, 64, 129)


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


# Samples, events and statistics as rerun columns: the live view and .rrd files look the same.


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
