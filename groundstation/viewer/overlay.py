"""An .rrd file that shows what a model was missing: measured, before and after, by channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from groundstation.discrepancy.rerun_overlay import SERIES, Overlay
from groundstation.rerun_log.channels import APPLICATION, DEVICE_TIME, fresh_rrd, send_series

COLORS = ((225, 228, 232), (255, 140, 60), (86, 180, 255))
"""Measured, model, improved model: on the viewer's dark ground."""
NEAR_S = 1.0
"""The channels' plots show so much before and after the cursor: 50 ms must be seen in them."""
FINDINGS, GAP, FLIGHTS = "/findings", "/gap", "/flights"


def write_overlay(overlay: Overlay, path: Path) -> None:
    """Write it with its layout into a new file.

    Raises as ``fresh_rrd`` does, and leaves nothing half-written behind.
    """
    with fresh_rrd(path) as part:
        _write(overlay, part, path.name)


def _write(overlay: Overlay, path: Path, name: str) -> None:
    import rerun as rr

    stream = rr.RecordingStream(APPLICATION, recording_id=name)
    stream.save(path, default_blueprint=_blueprint(overlay))
    stream.send_recording_name(name)
    text = rr.TextDocument(overlay.text, media_type=rr.MediaType.MARKDOWN)
    stream.log(FINDINGS, text, static=True, strict=True)
    for channel, (_, values) in overlay.channels.items():
        _lines(stream, _entity(channel), SERIES, COLORS)
        # A row whose prediction is missing would break the measured line as well: each series
        # is an entity of its own.
        for column, series in enumerate(SERIES):
            send_series(stream, f"{_entity(channel)}/{series}", overlay.time_s, values[:, column])
    _lines(stream, GAP, SERIES[1:], COLORS[1:])
    for column, series in enumerate(SERIES[1:]):
        send_series(stream, f"{GAP}/{series}", overlay.gap_time_s, overlay.gap[:, column])
    for begin, flight in overlay.flights:
        stream.set_time(DEVICE_TIME, duration=begin)
        stream.log(FLIGHTS, rr.TextLog(f"{flight} begins"), strict=True)
    stream.flush()
    stream.disconnect()


def _entity(channel: str) -> str:
    return f"/channels/{channel}"


def _lines(stream: Any, entity: str, names: tuple[str, ...], colors: Any) -> None:
    import rerun as rr

    for name, color in zip(names, colors, strict=True):
        width = 2.0 if name == SERIES[0] else 1.2
        lines = rr.SeriesLines(names=name, colors=color, widths=width)
        stream.log(f"{entity}/{name}", lines, static=True, strict=True)


def _blueprint(overlay: Overlay) -> Any:
    import rerun as rr
    import rerun.blueprint as rrb

    from groundstation.rerun_log.log import layout_of

    bounds = rr.TimeRangeBoundary
    near = rr.VisibleTimeRange(
        DEVICE_TIME,
        start=bounds.cursor_relative(seconds=-NEAR_S),
        end=bounds.cursor_relative(seconds=NEAR_S),
    )

    def plot(name: str, origin: str, window: Any = None) -> Any:
        return rrb.TimeSeriesView(
            name=name,
            origin=origin,
            contents=[f"{origin}/**"],
            time_ranges=window,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=window is None),
        )

    plots = [
        plot(f"{channel.replace('_', ' ')} ({unit})", _entity(channel), near)
        for channel, (unit, _) in overlay.channels.items()
    ]
    left = rrb.Vertical(
        rrb.TextDocumentView(name="What was found", origin=FINDINGS, contents=[FINDINGS]),
        plot("Gap over all channels (1: noise)", GAP),
        row_shares=[3, 2],
    )
    grid = rrb.Grid(*plots, grid_columns=3)
    return layout_of(rrb.Horizontal(left, grid, column_shares=[2, 7]))
