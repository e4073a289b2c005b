"""The layout a pilot flies by: the craft on the left, its signals on the right."""

from __future__ import annotations

from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn, TimelineColumn

from groundstation.rerun_log.channels import CRAFT, DEVICE_TIME, EVENTS, LINK, TABLES

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
