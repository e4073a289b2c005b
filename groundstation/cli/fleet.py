"""``fleet``: many recordings of many crafts."""

from __future__ import annotations

from pathlib import Path

import typer

from groundstation.cli.model_files import (
    AS_JSON,
    HTML,
    answer,
    effect_names,
    model_for,
    require_new,
)
from groundstation.cli.terminal import Commands, shown

WORKERS = typer.Option(
    None, "--workers", min=1, help="Processes (default: one a core); 1 is this one alone."
)
SCHEDULER = typer.Option(
    None, "--scheduler", metavar="tcp://HOST:PORT", help="A running Dask scheduler instead."
)
VEHICLE = typer.Option(
    None, "--vehicle", help="Profile of all crafts (default: what each recording says)."
)
CATALOGUE = typer.Argument(metavar="CATALOGUE", help="The folder that fleet index made.")


def add_commands(app: typer.Typer) -> None:
    fleet = Commands(
        no_args_is_help=True,
        help="Many recordings of many crafts: what changed since when, and which craft differs."
        "\n\nExample: [bold]groundstation fleet index flights/ -o fleet[/bold]",
    )
    fleet.command("index")(index)
    fleet.command("fit")(fit)
    fleet.command("discrepancy")(discrepancy)
    fleet.command("report")(report)
    app.add_typer(fleet, name="fleet")


def index(
    sources: list[str] = typer.Argument(
        metavar="FOLDER...", help="Folders, files, globs, or addresses such as s3://bucket/flights."
    ),
    output: Path = typer.Option(..., "-o", "--output", help="The catalogue: a folder, new or old."),
    vehicle: str | None = VEHICLE,
    workers: int | None = WORKERS,
    scheduler: str | None = SCHEDULER,
    as_json: bool = AS_JSON,
) -> None:
    """Read every recording once into a catalogue; again, only what changed.

    Example: [bold]groundstation fleet index flights/ -o fleet[/bold]
    """
    from dataclasses import asdict

    from groundstation.fleet.engine import cores, held
    from groundstation.fleet.index import UNFIT, recordings_of, usable
    from groundstation.fleet.index import index as brought_up

    with shown("looking") as progress, held(output):
        counts = brought_up(
            output,
            sources,
            vehicle=vehicle,
            workers=workers or cores(),
            scheduler=scheduler,
            progress=progress,
        )
        rows = recordings_of(output, ("craft", "state", "reason", "sha256"))
    crafts = sorted({row["craft"] for row in rows if row["craft"]})
    copies = sum(row["state"] not in UNFIT for row in rows) - len(usable(rows))
    told = {"recordings": len(rows), "copies": copies, "crafts": crafts}
    lines = [
        f"{output}: {len(rows)} recordings of {len(crafts)} crafts; {counts.read} read,"
        f" {counts.unchanged} unchanged, {counts.gone} gone"
    ]
    if copies:
        lines.append(f"  {copies} are copies of others by their content, and count once")
    damaged = [row for row in rows if row["state"] == "damaged"]
    lines += [f"  damaged: {row['address']}: {row['reason']}" for row in damaged]
    answer(as_json, {**asdict(counts), **told}, lines)


def fit(
    catalogue: Path = CATALOGUE,
    vehicle: str | None = VEHICLE,
    effects: str | None = typer.Option(
        None,
        "--with",
        help="Effects that every craft has (default: its dead time, and the torque of rotors that"
        " accelerate).",
    ),
    workers: int | None = WORKERS,
    scheduler: str | None = SCHEDULER,
    as_json: bool = AS_JSON,
) -> None:
    """Fit each flight by itself; stopped, it goes on where it was.

    Example: [bold]groundstation fleet fit fleet --workers 8[/bold]
    """
    from dataclasses import asdict

    from groundstation.dynamics.registry import DELAY, SPIN_UP
    from groundstation.fleet.engine import cores, held
    from groundstation.fleet.fit import fit_all

    always = tuple(key.partition(".")[0] for key in (DELAY, SPIN_UP))
    with shown("looking") as progress, held(catalogue):
        counts = fit_all(
            catalogue,
            vehicle=vehicle,
            effects=always if effects is None else effect_names(effects),
            workers=workers or cores(),
            scheduler=scheduler,
            progress=progress,
        )
    line = (
        f"{catalogue}: {counts.fitted} flights fitted, {counts.refused} of them told nothing;"
        f" {counts.unchanged} were fitted already, {counts.short} too short"
    )
    answer(as_json, asdict(counts), [line])


def discrepancy(
    catalogue: Path = CATALOGUE,
    model: str | None = typer.Option(
        None, "--model", help="What every craft is held against (default: its own body fit)."
    ),
    vehicle: str | None = VEHICLE,
    flights: int = typer.Option(6, "--flights", min=2, help="Of each craft, those that tell most."),
    workers: int | None = WORKERS,
    scheduler: str | None = SCHEDULER,
    as_json: bool = AS_JSON,
) -> None:
    """Find which effects each craft's model is missing, from several of its flights together.

    Example: [bold]groundstation fleet discrepancy fleet --model body.json[/bold]
    """
    from dataclasses import asdict

    from groundstation.fleet.engine import cores, held
    from groundstation.fleet.search import effects_table, search_all

    loaded = None if model is None else model_for(model, vehicle)
    with shown("looking") as progress, held(catalogue):
        counts = search_all(
            catalogue,
            model=loaded,
            vehicle=vehicle,
            flights=flights,
            workers=workers or cores(),
            scheduler=scheduler,
            progress=progress,
        )
        rows = effects_table(catalogue).rows()
    lines = [
        f"{catalogue}: {counts.searched} crafts searched, {counts.refused} of them told nothing;"
        f" {counts.unchanged} were searched already, {counts.few} have fewer than two flights"
    ]
    for craft, row in rows.items():
        if row["reason"] is not None:
            lines.append(f"  {craft}: not searched: {row['reason']}")
            continue
        named = ", ".join(row["effects"]) or "nothing named"
        lines.append(f"  {craft}: {named}; gap {row['gap_before']:.2f} -> {row['gap_after']:.2f}")
        lines += [f"    warning: {words}" for words in row["warnings"] or ()]
    answer(as_json, {**asdict(counts), "crafts": list(rows.values())}, lines)


def report(
    catalogue: Path = CATALOGUE,
    compare_before: str | None = typer.Option(
        None, "--compare-before", metavar="DATE", help="Did it help: all crafts before and since."
    ),
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Say what changed since when, which craft differs from the others, and what to fly next.

    Example: [bold]groundstation fleet report fleet --html fleet.html[/bold]
    """
    from dataclasses import asdict

    from groundstation.fleet.findings import findings_of, parse_date, shifts
    from groundstation.fleet.fit import VALUES, fits_table
    from groundstation.fleet.index import recordings_of, usable
    from groundstation.fleet.report import to_fly
    from groundstation.fleet.search import effects_table

    require_new(html)
    date = None if compare_before is None else parse_date(compare_before)
    recordings = recordings_of(catalogue, ("craft", "begun", "state", "reason", "sha256"))
    fits = fits_table(catalogue).rows(VALUES)
    fleet = findings_of(usable(recordings), fits)
    effects = effects_table(catalogue).rows()
    since = () if date is None else shifts(fleet.series, date)
    needed = to_fly(fleet, effects)
    if html is not None:
        from groundstation.fleet.report import More
        from groundstation.fleet.report import report as page

        more = More(effects, needed, compare_before, since)
        page(fleet, recordings, fits, catalogue.name, more).write(html)
    compared = None if date is None else [asdict(one) for one in since]
    further = {"effects": list(effects.values()), "to_fly": needed, "since": compared}
    crafts = {one.craft for one in fleet.series}
    lines = [
        f"{catalogue}: {len(crafts)} crafts, {len(recordings)} recordings, {fleet.tests} tests",
        *(f"  {one.text}" for one in fleet.findings),
    ]
    if not fleet.findings:
        tested = "no craft changed or differs" if fleet.tests else "nothing could be tested yet"
        lines.append(f"  {tested}" if crafts else "  nothing is fitted: fleet fit first")
    if date is not None:
        none = "" if since else " no craft has two fitted flights on both sides"
        lines += [f"since {compare_before}:{none}", *(f"  {shift.text}" for shift in since)]
    for craft, row in effects.items():
        lacks = ", ".join(row["effects"] or ()) or "nothing that has a name"
        lines.append(f"  {craft} lacks {lacks}")
    lines += [f"  to fly with {craft}: {'; '.join(which)}" for craft, which in needed.items()]
    answer(as_json, {**fleet.as_dict(), **further}, lines, html)
