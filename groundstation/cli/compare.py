"""``compare``: where a model and recordings disagree."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation.cli.flights import (
    MODEL,
    VEHICLE,
    model_for,
    read_flights,
    require_apart,
)
from groundstation.cli.model_files import (
    AS_JSON,
    ATTITUDE,
    HTML,
    require_new,
    say_written,
    told_turning,
)
from groundstation.cli.progress import shown, tell_found
from groundstation.cli.terminal import show, show_json

if TYPE_CHECKING:
    from groundstation.comparison.comparison import Place
    from groundstation.discrepancy.report_json import Gap

RECORDINGS = typer.Argument(metavar="REC...", help="Recordings of flights.")
ROWS = 8
CLEAR = 3.0
"""Standard deviations of noise energy from which a place is worth naming."""


def add_commands(app: typer.Typer) -> None:
    app.command("compare")(compare)


def compare(
    recordings: list[Path] = RECORDINGS,
    model: str = MODEL,
    vehicle: str | None = VEHICLE,
    attitude: str | None = ATTITUDE,
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Where simulation and measurement disagree: by channel, by regime, by horizon.

    The model predicts rates, attitude and specific force 20 and 50 ms ahead of every row; its
    errors stand beside what noise alone would leave.

    Example: [bold]groundstation compare flight.mcap --model body.json --html where.html[/bold]
    """
    import msgspec

    from groundstation import compare as judge
    from groundstation.discrepancy.report_json import CompareReport, gap_of
    from groundstation.dynamics.meanings import suitability, verdict

    if html is not None:
        require_new(html)
    require_apart(recordings, [])
    loaded = model_for(model, vehicle)
    turning = told_turning(loaded, attitude)
    with shown("reading") as progress:
        read, left_out = read_flights(recordings, loaded, vehicle)
        for line in left_out:
            show(line, error=True)
        flights = [run for one in read for run in one.runs]
        progress(0.3, "predicting 20 and 50 ms ahead")
        found = judge(flights, loaded, turning=turning)
        for line in found.warnings.values():
            show(line, error=True)
        names = [one.name for one in read if one.runs]
        report = CompareReport(
            found.places,
            gap_of(found, (found.further(), None)),
            names,
            model,
            turning,
            verdict(suitability(loaded)),
        )
        if html is not None:
            from groundstation.discrepancy.report_html import compare_page

            progress(0.8, "drawing the report")
            compare_page(found, report).write(html)
    if as_json:
        show_json(msgspec.json.decode(msgspec.json.encode(report)))
        return
    tell_found(f"gap over all channels {report.gap.validation.before:.2f} (1.00: noise alone)")
    say_good_for(report.good_for)
    say_gap(report.gap)
    say_where(report.where)
    say_written(html)


def say_good_for(verdict: str) -> None:
    """What the model is good for, where a fit of it is known."""
    if verdict:
        show(f"the model: {verdict[:1].lower()}{verdict[1:]}")


def say_gap(gap: Gap) -> None:
    """The gap of each channel, in words for a terminal."""
    level = gap.validation
    after = "" if level.after is None else f", after {level.after:.2f}"
    show(f"gap over all channels: {level.before:.2f}{after} (1.00: noise alone)")
    head = "before" if level.after is not None else "gap"
    show(f"  {'channel':<16}{head:>8}{'' if level.after is None else '   after'}   error")
    for name, channel in gap.channels.items():
        own = channel.own_unit
        later = "" if channel.after is None else f"{channel.after:8.2f}"
        error = own.before if own.after is None else own.after
        show(
            f"  {name:<16}{channel.before:8.2f}{later}   {error:.3g} {own.unit},"
            f" noise {own.noise_floor:.3g}"
        )


def say_where(rows: list[Place], most: int = ROWS) -> None:
    """The places that are clearly worse than noise."""
    clear = [row for row in rows if row.significance >= CLEAR][:most]
    if not clear:
        show("nowhere clearly worse than noise")
        return
    show("worst, most significant first:")
    for row in clear:
        show(f"  {_row(row)}")


def _row(row: Place) -> str:
    return (
        f"{row.channel:<16}{row.regime:<28}{row.rms:9.3g} {row.unit}, noise {row.expected_rms:.3g}"
    )
