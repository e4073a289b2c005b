"""``discrepancy``: find, name and add what a model is missing, and prove it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation.cli.compare import RECORDINGS, say_gap, say_stretches, say_where
from groundstation.cli.flights import (
    HTML,
    MARKED,
    MODEL,
    STRETCH,
    VEHICLE,
    flights_from,
    marked_in,
    model_for,
    require_apart,
)
from groundstation.cli.model_files import require_new
from groundstation.cli.progress import shown

if TYPE_CHECKING:
    from groundstation.discrepancy.comparison import Comparison
    from groundstation.discrepancy.findings import Findings
    from groundstation.discrepancy.proof import Proof
    from groundstation.discrepancy.report_json import DiscrepancyReport, StretchReport
    from groundstation.discrepancy.stretches import Marked
    from groundstation.dynamics.model import Model
    from groundstation.identification.runs import Run

VALIDATE = typer.Option(
    None, "--validate", help="Recordings that no fit sees (default: the last third of each REC)."
)
OUTPUT = typer.Option(None, "-o", "--output", help="Write the improved model to this new file.")
EFFECTS = typer.Option(
    None, "--effects", help="A Python file with effects of your own, as further candidates."
)
JSON = typer.Option(None, "--json", help="Write the report for programs to this new file.")
RERUN = typer.Option(
    None, "--rerun", help="Write measured beside simulated, before and after, to this new .rrd."
)


@dataclass(frozen=True, slots=True)
class _Outputs:
    model: Path | None
    json: Path | None
    html: Path | None
    rerun: Path | None

    def require_new(self) -> None:
        for path in (self.model, self.json, self.html, self.rerun):
            if path is not None:
                require_new(path)


def add_commands(app: typer.Typer) -> None:
    app.command("discrepancy")(discrepancy)


def discrepancy(
    recordings: list[Path] = RECORDINGS,
    model: str = MODEL,
    validate: list[Path] | None = VALIDATE,
    vehicle: str | None = VEHICLE,
    effects: Path | None = EFFECTS,
    stretch: list[str] | None = STRETCH,
    marked: bool = MARKED,
    seed: int = typer.Option(0, min=0, help="Of whatever the search draws."),
    output: Path | None = OUTPUT,
    json: Path | None = JSON,
    html: Path | None = HTML,
    rerun: Path | None = RERUN,
) -> None:
    """Find which physical effects a model is missing, add them, and prove it on held-out flights.

    Example: [bold]groundstation discrepancy flight1.mcap flight2.mcap --model body.json
    --validate flight3.mcap -o improved.json --html report.html[/bold]
    """
    from groundstation.discrepancy.comparison import compare
    from groundstation.discrepancy.engine import find_effects
    from groundstation.discrepancy.own_candidates import own_effects
    from groundstation.discrepancy.proof import divide, prove
    from groundstation.discrepancy.refusals import require_channels

    files = _Outputs(output, json, html, rerun)
    files.require_new()
    require_apart(recordings, validate or [])
    loaded = model_for(model, vehicle)
    own = own_effects(effects) if effects is not None else []
    with shown("reading") as progress:
        flights = flights_from(recordings, loaded, vehicle)
        held = flights_from(validate or [], loaded, vehicle)
        paths = [*recordings, *(validate or [])]
        asked = marked_in(paths, [*flights, *held], stretch or [], marked)
        fit_on, held_out, judged = divide(flights, held)
        progress(0.05, "comparing")
        train = compare(fit_on, loaded)
        whole = [run for part in (*flights, *held) for run in part]
        asked_before = _before(asked, whole, train)
        require_channels(held_out)
        findings = find_effects(
            fit_on,
            loaded,
            held_out,
            own=own,
            seed=seed,
            progress=lambda what, share: progress(0.1 + 0.7 * max(share, 0.0), what),
        )
        progress(0.8, "proving it on held-out rows")
        proof = prove(findings, train, judged)
        looked = _after(asked, asked_before, findings.model)
        report = _report(findings, proof, model, recordings, validate, seed, looked)
        _write(files, findings, proof, report)
    _say(report)
    for path in (files.model, files.json, files.html, files.rerun):
        if path is not None:
            typer.echo(f"written: {path}")


def _before(asked: list[Marked], flights: list[Run], train: Comparison) -> Comparison | None:
    """The given model on the recordings of the stretches that were asked for.

    Raises BadInputError, before anything is searched, for one in which nothing flew.
    """
    from groundstation.discrepancy.comparison import compare
    from groundstation.discrepancy.stretches import within

    if not asked:
        return None
    names = {one.recording for one in asked}
    before = compare([run for run in flights if run.name in names], train.model, train.black_box)
    for one in asked:
        within(before, one)
    return before


def _after(asked: list[Marked], before: Comparison | None, model: Model) -> list[StretchReport]:
    """The given and the improved model on these stretches."""
    from groundstation.discrepancy.report_json import stretch_report

    after = None if before is None else before.with_model(model)
    return [stretch_report(one, before, after) for one in asked if before is not None]


def _report(
    findings: Findings,
    proof: Proof,
    model: str,
    recordings: list[Path],
    validate: list[Path] | None,
    seed: int,
    looked: list[StretchReport],
) -> DiscrepancyReport:
    from groundstation import __version__
    from groundstation.discrepancy.report_json import findings_report

    return findings_report(
        findings,
        proof,
        recordings=[path.name for path in recordings],
        validation=[path.name for path in validate] if validate else "last third",
        model=model,
        seed=seed,
        created_by=f"groundstation {__version__}",
        stretches=looked,
    )


def _write(files: _Outputs, findings: Findings, proof: Proof, report: DiscrepancyReport) -> None:
    import msgspec

    from groundstation.errors import BadInputError

    if files.model is not None:
        from groundstation.dynamics.model import save_model

        save_model(_improved(findings.model, report), files.model)
    if files.json is not None:
        text = msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n"
        try:
            with files.json.open("xb") as file:
                file.write(text)
        except OSError as error:
            raise BadInputError(f"{files.json}: cannot be written: {error.strerror}") from error
    if files.html is not None:
        from groundstation.discrepancy.report_html import discrepancy_page

        discrepancy_page(findings, proof, report).write(files.html)
    if files.rerun is not None:
        from groundstation.discrepancy.rerun_overlay import overlay_of
        from groundstation.viewer.overlay import write_overlay

        write_overlay(overlay_of(proof, report), files.rerun)


def _improved(model: Model, report: DiscrepancyReport) -> Model:
    """The model that was found, with the account of how."""
    import msgspec

    account = {
        "what": "discrepancy",
        "recordings": report.recordings,
        "held_out": report.validation,
        "verdict": report.verdict,
        "effects": [effect.name for effect in report.effects],
        "gap": msgspec.to_builtins(report.gap.validation),
    }
    return msgspec.structs.replace(
        model,
        fit={**model.fit, "discrepancy": account},
        created_by=report.created_by,
    )


def _say(report: DiscrepancyReport) -> None:
    """The outcome in plain words."""
    from groundstation.discrepancy.report_json import why_lost

    count = len(report.effects)
    verdict = {
        "effects_found": f"{count} effect{'s' if count != 1 else ''} found",
        "no_discrepancy": "no discrepancy: the model explains what these recordings show",
        "unexplained": "unexplained: something acts that no effect in the list describes",
    }[report.verdict]
    typer.echo(verdict)
    for effect in report.effects:
        typer.echo(f"{effect.order}. {effect.name}: {effect.adds}")
        for name, estimate in effect.parameters.items():
            spread = "" if estimate.stderr is None else f" +- {estimate.stderr:.2g}"
            typer.echo(f"     {name} {estimate.value:.4g}{spread} {estimate.unit}".rstrip())
        typer.echo(f"     gap {effect.gap.before:.3f} -> {effect.gap.after:.3f}")
        for other in effect.alternatives:
            typer.echo(f"     could also be {other.name}; to tell: {other.manoeuvre}")
    left = report.residual_detail
    if report.residual == "structured":
        where = ", ".join(f"{f:.3g}" for f in left.frequencies_hz)
        typer.echo(
            f"left over: structure in {left.channel}"
            + (f" at {where} Hz" if where else "")
            + (f", like {left.signal}" if left.signal else "")
        )
    say_stretches(report.stretches)
    say_gap(report.gap)
    say_where(report.where)
    if report.not_shown:
        typer.echo("these recordings cannot show (and would, if you fly):")
        for manoeuvre in dict.fromkeys(one.manoeuvre for one in report.not_shown):
            names = [one.name for one in report.not_shown if one.manoeuvre == manoeuvre]
            typer.echo(f"     {', '.join(dict.fromkeys(names))}: {manoeuvre}")
    for reason in dict.fromkeys(report.lost.values()):
        lost = ", ".join(name for name, why in report.lost.items() if why == reason)
        typer.echo(f"not looked for ({why_lost(reason)}): {lost}")
    for line in report.warnings:
        typer.echo(f"warning: {line}")
