"""``compare`` and ``discrepancy``: where a model and recordings disagree, named, added and
proven.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation.cli.model_files import (
    AS_JSON,
    ATTITUDE,
    HTML,
    MODEL,
    model_for,
    read_flights,
    require_apart,
    require_new,
    say_written,
    told_turning,
    with_filter,
)
from groundstation.cli.model_files import FLOWN_VEHICLE as VEHICLE
from groundstation.cli.terminal import show, show_json, shown, tell_found
from groundstation.paths import writing

if TYPE_CHECKING:
    from groundstation import Model
    from groundstation.discrepancy.engine import Discrepancy
    from groundstation.discrepancy.report_json import DiscrepancyReport
    from groundstation.identification.likelihood.motion import Variant

# ``compare``: where a model and recordings disagree.


RECORDINGS = typer.Argument(metavar="REC...", help="Recordings of flights.")


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
    from groundstation.discrepancy.report import compare_page, compared_in_lines
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
            progress(0.8, "drawing the report")
            compare_page(found, report).write(html)
    if as_json:
        show_json(msgspec.json.decode(msgspec.json.encode(report)))
        return
    tell_found(f"gap over all channels {report.gap.validation.before:.2f} (1.00: noise alone)")
    for line in compared_in_lines(report):
        show(line)
    say_written(html)


# ``discrepancy``: find, name and add what a model is missing, and prove it.


GIVEN = typer.Option(
    None, "--model", help="Model file, or the built-in 'thesis' (default: fitted on these flights)."
)
VALIDATE = typer.Option(
    None,
    "--validate",
    help="Recordings that are the proof and decide nothing (default: a third of each REC).",
)
OUTPUT = typer.Option(None, "-o", "--output", help="Write the improved model to this new file.")
EFFECTS = typer.Option(
    None,
    "--effects",
    help="A Python file with effects of your own to search as well; it is run.",
)
JSON = typer.Option(
    None, "--json", help="Write the report for programs to this new file, or print it: '-'."
)
STDOUT = Path("-")
RERUN = typer.Option(
    None, "--rerun", help="Write measured beside simulated, before and after, to this new .rrd."
)


def add_commands(app: typer.Typer) -> None:
    app.command("compare")(compare)
    app.command("discrepancy")(discrepancy)


def discrepancy(
    recordings: list[Path] = RECORDINGS,
    model: str | None = GIVEN,
    validate: list[Path] | None = VALIDATE,
    vehicle: str | None = VEHICLE,
    effects: Path | None = EFFECTS,
    output: Path | None = OUTPUT,
    json: Path | None = JSON,
    html: Path | None = HTML,
    rerun: Path | None = RERUN,
) -> None:
    """Find which physical effects a model is missing, add them, and prove it on other flights.

    Without --model the body is fitted on these flights first, beside the motors of --vehicle.

    Example: [bold]groundstation discrepancy flight1.mcap flight2.mcap --model body.json
    --validate flight3.mcap -o improved.json --html report.html[/bold]
    """
    import msgspec

    from groundstation import __version__, find_discrepancy
    from groundstation.discrepancy.report import found_in_lines, found_in_short
    from groundstation.discrepancy.report_json import discrepancy_report

    printed = json == STDOUT
    files = output, None if printed else json, html, rerun
    for path in files:
        if path is not None:
            require_new(path)
    require_apart(recordings, validate or [])
    loaded = _base(model, vehicle)
    own = _own(effects)
    with shown("reading") as progress:
        fitted, short = read_flights(recordings, loaded, vehicle)
        held, held_short = read_flights(validate or [], loaded, vehicle)
        loaded, given = with_filter(loaded, [*fitted, *held])
        found = find_discrepancy(
            [one.runs for one in fitted],
            loaded,
            [one.runs for one in held],
            own=own,
            left_out=[*short, *held_short, *given],
            fit_base=model is None,
            progress=lambda what, share: progress(share, what),
        )
        report = discrepancy_report(
            found,
            recordings=[path.name for path in recordings],
            validation=[path.name for path in validate] if validate else found.held_out,
            model=model or _fitted_here(found.findings.base),
            created_by=f"groundstation {__version__}",
        )
        _write(found, report, *files)
    if printed:
        show_json(msgspec.to_builtins(report))
        return
    tell_found(", ".join(found_in_short(report)))
    for line in found_in_lines(report, output is not None):
        show(line)
    say_written(*files)


def _base(model: str | None, vehicle: str | None) -> Model:
    """The given model, or that of the profile. Raises BadInputError where neither is given."""
    from groundstation import BadInputError, load_vehicle, vehicle_model

    if model is not None:
        return model_for(model, vehicle)
    if vehicle is None:
        raise BadInputError(
            "which model? Give its file with --model, or the craft with --vehicle: then its body is"
            " fitted on these flights first"
        )
    return vehicle_model(load_vehicle(vehicle))


def _fitted_here(base: Model) -> str:
    """What a search began with where no model was given."""
    body = "its body fitted on these flights" if "body" in base.fit else "the body of its profile"
    return f"{base.vehicle}, {body}"


def _own(path: Path | None) -> list[Variant]:
    from groundstation.dynamics.craft import consent
    from groundstation.identification.likelihood.motion import own_effects

    if path is None:
        return []
    with contextlib.suppress(OSError):  # whoever reads it says why it cannot be read
        consent(path)
    return own_effects(path)


def _write(
    found: Discrepancy,
    report: DiscrepancyReport,
    model: Path | None,
    json: Path | None,
    html: Path | None,
    rerun: Path | None,
) -> None:
    import msgspec

    from groundstation import BadInputError

    if model is not None:
        from groundstation import save_model

        save_model(_improved(found.findings.model, report), model)
    if json is not None:
        text = msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n"
        with writing(json, BadInputError), json.open("xb") as file:
            file.write(text)
    if html is not None:
        from groundstation.discrepancy.report import discrepancy_page

        discrepancy_page(found.proof, report).write(html)
    if rerun is not None:
        from groundstation.discrepancy.rerun_overlay import overlay_of
        from groundstation.viewer.overlay import write_overlay

        write_overlay(overlay_of(found.proof, report), rerun)


def _improved(model: Model, report: DiscrepancyReport) -> Model:
    """The model that was found, with the account of how."""
    import msgspec

    account = {
        "what": "discrepancy",
        "recordings": report.recordings,
        "held_out": report.validation,
        "verdict": report.verdict,
        "effects": [effect.name for effect in report.effects],
        "base_changes": msgspec.to_builtins(report.base_changes),
        "gap": msgspec.to_builtins(report.gap.validation),
    }
    return msgspec.structs.replace(
        model,
        fit={**model.fit, "discrepancy": account},
        created_by=report.created_by,
    )
