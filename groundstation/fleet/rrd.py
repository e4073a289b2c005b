"""A fleet in the rerun viewer: crafts by quantities and effects, and every craft's trends."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.fleet.findings import FALSE_SHARE, Fleet, Series, drawn_crafts, told
from groundstation.fleet.flight_fit import QUANTITIES, RELATIVE, WORDS
from groundstation.fleet.parts import Row
from groundstation.rerun_log.channels import APPLICATION
from groundstation.rerun_log.new_rrd import fresh_rrd

DATE, FLIGHT = "date", "flight"
FOUND, MAP, EVENTS, TRENDS = "/found", "/crafts", "/events", "/trends"
FULL_PERCENT = 5.0
"""A deviation of so many percent and more has the largest dot and the fullest colour."""
COLUMN, LINE = 60.0, 22.0
"""Spacing of the dots, in the view's units."""
BRIGHT = ((255, 140, 60), (86, 180, 255), (110, 220, 130), (240, 110, 190), (250, 220, 90))
"""Lines of crafts with findings; the others are grey."""
GREY, LOW, HIGH = (120, 124, 132), (86, 180, 255), (255, 110, 60)


def write_rrd(fleet: Fleet, effects: Mapping[str, Row], name: str, path: Path) -> None:
    """Write a catalogue called ``name`` with its layout into a new file.

    effects: its table of that name. Raises as ``fresh_rrd`` does, and leaves nothing half-written
    behind.
    """
    import rerun as rr

    crafts = drawn_crafts(fleet)
    ill = sorted({one.craft for one in fleet.findings})
    bright = {craft: BRIGHT[k % len(BRIGHT)] for k, craft in enumerate(ill)}
    with fresh_rrd(path) as part:
        stream = rr.RecordingStream(APPLICATION, recording_id=path.name)
        stream.save(part, default_blueprint=_blueprint(fleet))
        stream.send_recording_name(f"fleet {name}")
        text = rr.TextDocument(
            in_words(fleet, effects, name, crafts), media_type=rr.MediaType.MARKDOWN
        )
        stream.log(FOUND, text, static=True, strict=True)
        _send_map(stream, fleet, crafts)
        for one in fleet.series:
            if one.craft in crafts:
                color = bright.get(one.craft, GREY)
                _send_trend(stream, one, middle_of(fleet, one.quantity), color)
        for finding in fleet.findings:
            stream.reset_time()
            stream.set_time(DATE, timestamp=np.datetime64(finding.since[:19]))
            stream.log(EVENTS, rr.TextLog(finding.text, level="WARN"), strict=True)
        stream.flush()
        stream.disconnect()


def middle_of(fleet: Fleet, quantity: str) -> float:
    """What crafts are compared with: the fleet's middle, as ``Series`` have their values."""
    crowd = fleet.populations.get(quantity)
    if crowd is not None:
        return crowd.middle
    values = [float(np.median(one.values)) for one in fleet.series if one.quantity == quantity]
    return float(np.median(values)) if values else 0.0


def in_words(fleet: Fleet, effects: Mapping[str, Row], name: str, crafts: Sequence[str]) -> str:
    """Findings, and effects by craft, in Markdown."""
    every = {one.craft for one in fleet.series}
    lines = [f"# Fleet {name}", ""]
    lines += [f"- {one.text}" for one in fleet.findings] or ["No craft changed or differs."]
    lines += [
        "",
        f"{fleet.tests} tests; at most {100 * FALSE_SHARE:.0f} % of what is named is chance."
        " Dots: percent away from the middle of the fleet, orange above, blue below; a box has"
        f" passed the test. {len(crafts)} of {len(every)} crafts are drawn.",
    ]
    searched = {craft: row for craft, row in effects.items() if row["reason"] is None}
    if searched:
        lines += ["", "| craft | its model lacks | gap |", "|---|---|---|"]
        for craft, row in searched.items():
            sizes = zip(row["parameters"], row["values"], row["units"], strict=True)
            lacks = ", ".join(f"{what} {value:.3g} {unit}".strip() for what, value, unit in sizes)
            gap = f"{row['gap_before']:.2f} → {row['gap_after']:.2f}"
            lines.append(f"| {craft} | {lacks or 'nothing that has a name'} | {gap} |")
    return "\n".join(lines)


def percent(quantity: str, values: Any, middle: float) -> Any:
    """Values as ``Series`` have them, in percent away from ``middle``."""
    away = np.asarray(values) - middle
    return 100.0 * (np.expm1(away) if quantity in RELATIVE else away)


def _send_map(stream: Any, fleet: Fleet, crafts: Sequence[str]) -> None:
    """Crafts by quantities, as dots."""
    import rerun as rr

    names = [one for one in QUANTITIES if one in {value.quantity for value in fleet.values}]
    found = {(one.craft, name) for one in fleet.findings for name in (one.quantity, *one.moved)}
    places, sizes, colors, labels, rings = [], [], [], [], []
    for value in fleet.values:
        if value.craft not in crafts:
            continue
        middle = middle_of(fleet, value.quantity)
        own = math.log(value.value) if value.quantity in RELATIVE else value.value
        away = float(percent(value.quantity, own, middle))
        share = min(1.0, abs(away) / FULL_PERCENT)
        place = _place(names.index(value.quantity), crafts.index(value.craft))
        places.append(place)
        sizes.append(1.0 + 7.0 * share)
        end = HIGH if away > 0.0 else LOW
        colors.append([round(a + share * (b - a)) for a, b in zip(GREY, end, strict=True)])
        labels.append(
            f"{value.craft} {value.quantity} {told(value.quantity, own):.4g} ({away:+.1f} %)"
        )
        if (value.craft, value.quantity) in found:
            rings.append(place)
    dots = rr.Points2D(places, radii=sizes, colors=colors, labels=labels, show_labels=False)
    stream.log(f"{MAP}/values", dots, static=True, strict=True)
    half = [[9.5, 9.5]] * len(rings)
    boxes = rr.Boxes2D(centers=rings, half_sizes=half, colors=[HIGH], show_labels=False)
    stream.log(f"{MAP}/found", boxes, static=True, strict=True)
    # A label hangs below its point; long names of neighbours would overlap on one line.
    rows = [_place(-1, k - 0.6) for k in range(len(crafts))]
    columns = [_place(k, -2 - k % 2) for k in range(len(names))]
    titles = rr.Points2D(
        [*rows, *columns], radii=0.5, colors=[GREY], labels=[*crafts, *names], show_labels=True
    )
    stream.log(f"{MAP}/titles", titles, static=True, strict=True)


def _place(column: float, line: float) -> tuple[float, float]:
    return COLUMN * column, LINE * line


def _send_trend(stream: Any, one: Series, middle: float, color: tuple[int, int, int]) -> None:
    """A craft's flights, over their dates and by number."""
    import rerun as rr

    entity = f"{TRENDS}/{one.quantity}/{rr.escape_entity_path_part(one.craft)}"
    line = rr.SeriesLines(names=one.craft, colors=color, widths=1.0 if color == GREY else 2.0)
    stream.log(entity, line, static=True, strict=True)
    dates: NDArray[np.datetime64] = np.array([day[:19] for day in one.begun], "datetime64[ns]")
    stream.send_columns(
        entity,
        indexes=[
            rr.TimeColumn(DATE, timestamp=dates),
            rr.TimeColumn(FLIGHT, sequence=np.arange(1, len(dates) + 1)),
        ],
        columns=rr.Scalars.columns(scalars=percent(one.quantity, one.values, middle)),
        strict=True,
    )


def _blueprint(fleet: Fleet) -> Any:
    import rerun as rr
    import rerun.blueprint as rrb

    from groundstation.rerun_log.blueprint import layout_of

    all_time = rr.VisibleTimeRange(
        DATE, start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
    days = [
        np.datetime64(day[:19]) for one in fleet.series for day in (one.begun[0], one.begun[-1])
    ]
    axis = None
    if days:
        ends = (
            rr.TimeRangeBoundary.absolute(nanos=int(day.astype("datetime64[ns]").astype(np.int64)))
            for day in (min(days), max(days))
        )
        axis = rrb.TimeAxis(view_range=rr.TimeRange(*ends))
    known = {one.quantity for one in fleet.series}
    plots = [
        rrb.TimeSeriesView(
            name=f"{WORDS[name]} (% from the middle)",
            origin=f"{TRENDS}/{name}",
            contents=[f"{TRENDS}/{name}/**"],
            time_ranges=all_time,
            axis_x=axis,
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for name in QUANTITIES
        if name in known
    ]
    left = rrb.Vertical(
        rrb.TextDocumentView(name="What was found", origin=FOUND, contents=[FOUND]),
        rrb.Spatial2DView(name="Crafts by quantities", origin=MAP, contents=[f"{MAP}/**"]),
        rrb.TextLogView(name="Since when", origin=EVENTS, contents=[EVENTS]),
        row_shares=[3, 4, 2],
    )
    grid = rrb.Grid(*plots, grid_columns=2)
    return layout_of(rrb.Horizontal(left, grid, column_shares=[4, 5]), DATE)
