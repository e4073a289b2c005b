"""``fleet``: many recordings of many crafts."""

from __future__ import annotations

from pathlib import Path

import typer

from groundstation.cli.model_files import AS_JSON, HTML, effect_names, require_new, say_written
from groundstation.cli.progress import shown
from groundstation.cli.terminal import show, show_json

WORKERS = typer.Option(
    None, "--workers", min=1, help="Processes (default: one a core); 1 is this one alone."
)
SCHEDULER = typer.Option(
    None, "--scheduler", metavar="tcp://HOST:PORT", help="A running Dask scheduler instead."
)
CATALOGUE = typer.Argument(metavar="CATALOGUE", help="The folder that fleet index made.")


def add_commands(app: typer.Typer) -> None:
    fleet = typer.Typer(
        no_args_is_help=True,
        help="Many recordings of many crafts: what changed since when, and which craft differs."
        "\n\nExample: [bold]groundstation fleet index flights/ -o fleet[/bold]",
    )
    fleet.command("index")(index)
    fleet.command("fit")(fit)
    fleet.command("report")(report)
    app.add_typer(fleet, name="fleet")


def index(
    sources: list[str] = typer.Argument(
        metavar="FOLDER...", help="Folders, files, globs, or addresses such as s3://bucket/flights."
    ),
    output: Path = typer.Option(..., "-o", "--output", help="The catalogue: a folder, new or old."),
    workers: int | None = WORKERS,
    scheduler: str | None = SCHEDULER,
    as_json: bool = AS_JSON,
) -> None:
    """Read every recording once into a catalogue; again, only what changed.

    Example: [bold]groundstation fleet index flights/ -o fleet[/bold]
    """
    from dataclasses import asdict

    from groundstation.fleet.engine import cores
    from groundstation.fleet.index import index as brought_up
    from groundstation.fleet.index import recordings_of
    from groundstation.fleet.parts import held

    with shown("looking") as progress, held(output):
        counts = brought_up(
            output, sources, workers=workers or cores(), scheduler=scheduler, progress=progress
        )
        rows = recordings_of(output)
    crafts = sorted({row["craft"] for row in rows if row["craft"]})
    if as_json:
        show_json({**asdict(counts), "recordings": len(rows), "crafts": crafts})
        return
    show(
        f"{output}: {len(rows)} recordings of {len(crafts)} crafts; {counts.read} read,"
        f" {counts.unchanged} unchanged, {counts.gone} gone"
    )
    for row in rows:
        if row["state"] == "damaged":
            show(f"  damaged: {row['address']}: {row['reason']}")


def fit(
    catalogue: Path = CATALOGUE,
    vehicle: str | None = typer.Option(
        None, "--vehicle", help="Profile of all crafts (default: what each recording says)."
    ),
    effects: str = typer.Option(
        "dead_time,rotor_acceleration_torque", "--with", help="Effects that every craft has."
    ),
    workers: int | None = WORKERS,
    scheduler: str | None = SCHEDULER,
    as_json: bool = AS_JSON,
) -> None:
    """Fit each flight by itself; stopped, it goes on where it was.

    Example: [bold]groundstation fleet fit fleet --workers 8[/bold]
    """
    from dataclasses import asdict

    from groundstation.fleet.engine import cores
    from groundstation.fleet.fit import fit_all
    from groundstation.fleet.parts import held

    with shown("looking") as progress, held(catalogue):
        counts = fit_all(
            catalogue,
            vehicle=vehicle,
            effects=effect_names(effects),
            workers=workers or cores(),
            scheduler=scheduler,
            progress=progress,
        )
    if as_json:
        show_json(asdict(counts))
        return
    show(
        f"{catalogue}: {counts.fitted} flights fitted, {counts.refused} of them told nothing;"
        f" {counts.unchanged} were fitted already, {counts.short} too short"
    )


def report(catalogue: Path = CATALOGUE, html: Path | None = HTML, as_json: bool = AS_JSON) -> None:
    """Say what changed since when, and which craft differs from the others.

    Example: [bold]groundstation fleet report fleet --html fleet.html[/bold]
    """
    from groundstation.fleet.findings import findings_of
    from groundstation.fleet.fit import fits_table
    from groundstation.fleet.index import recordings_of

    if html is not None:
        require_new(html)
    recordings, fits = recordings_of(catalogue), fits_table(catalogue).rows()
    fleet = findings_of(recordings, fits)
    if html is not None:
        from groundstation.fleet.report import report as page

        page(fleet, recordings, fits, catalogue.name).write(html)
    if as_json:
        show_json(fleet.as_dict())
        return
    crafts = {one.craft for one in fleet.series}
    show(f"{catalogue}: {len(crafts)} crafts, {len(recordings)} recordings, {fleet.tests} tests")
    for one in fleet.findings:
        show(f"  {one.text}")
    if not fleet.findings:
        show("  no craft changed or differs" if crafts else "  nothing is fitted: fleet fit first")
    say_written(html)
