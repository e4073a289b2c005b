"""An .rrd file of what a fit was made of: a plot for every panel, all on one time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from groundstation.identification.fit_record import Panel
from groundstation.rerun_log.channels import APPLICATION, DEVICE_TIME
from groundstation.rerun_log.new_rrd import fresh_rrd, send_series

COLORS = ((225, 228, 232), (255, 140, 60), (86, 180, 255), (120, 220, 160))
"""On the viewer's dark ground."""
ABOUT = "/about"
MOST_COLUMNS = 2


def write_panels(panels: Sequence[Panel], text: str, path: Path) -> None:
    """Write them with their layout into a new file. text: Markdown, shown beside them.

    Raises as ``fresh_rrd`` does, and leaves nothing half-written behind.
    """
    with fresh_rrd(path) as part:
        _write(panels, text, part, path.name)


def _write(panels: Sequence[Panel], text: str, path: Path, name: str) -> None:
    import rerun as rr

    stream = rr.RecordingStream(APPLICATION, recording_id=name)
    stream.save(path, default_blueprint=_blueprint(panels))
    stream.send_recording_name(name)
    document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
    stream.log(ABOUT, document, static=True, strict=True)
    for number, panel in enumerate(panels):
        for color, (line, values) in zip(COLORS, panel.lines.items(), strict=False):
            entity = rr.new_entity_path(["panels", str(number), line])
            shape = (
                rr.SeriesPoints(names=line, colors=color, marker_sizes=1.5)
                if panel.singly
                else rr.SeriesLines(names=line, colors=color, widths=1.2)
            )
            stream.log(entity, shape, static=True, strict=True)
            send_series(stream, entity, panel.time_s, values)
    stream.flush()
    stream.disconnect()


def _blueprint(panels: Sequence[Panel]) -> Any:
    import rerun as rr
    import rerun.blueprint as rrb

    from groundstation.rerun_log.blueprint import layout_of

    ends = rr.TimeRangeBoundary.infinite()
    whole = rr.VisibleTimeRange(DEVICE_TIME, start=ends, end=ends)
    plots = [
        rrb.TimeSeriesView(
            name=panel.title,
            origin=f"/panels/{number}",
            contents=[f"/panels/{number}/**"],
            time_ranges=whole,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=len(panel.lines) > 1),
        )
        for number, panel in enumerate(panels)
    ]
    about = rrb.TextDocumentView(name="About", origin=ABOUT, contents=[ABOUT])
    grid = rrb.Grid(*plots, grid_columns=MOST_COLUMNS if len(plots) > 3 else 1)
    return layout_of(rrb.Horizontal(about, grid, column_shares=[2, 7]))
