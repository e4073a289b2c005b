"""``compare`` and ``discrepancy``: where a model and recordings disagree, named, added and
proven.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
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

if TYPE_CHECKING:
    from groundstation import Model
    from groundstation.comparison.comparison import Place
    from groundstation.discrepancy.engine import Discrepancy
    from groundstation.discrepancy.report_json import DiscrepancyReport, EffectFound, Gap
    from groundstation.identification.likelihood.motion import Variant

# ``compare``: where a model and recordings disagree.


RECORDINGS = typer.Argument(metavar="REC...", help="Recordings of flights.")
ROWS = 8
CLEAR = 3.0
"""Standard deviations of noise energy from which a place is worth naming."""


def add_compare(app: typer.Typer) -> None:
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


# ``discrepancy``: find, name and add what a model is missing, and prove it.


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
    add_compare(app)
    app.command("discrepancy")(discrepancy)


def discrepancy(
    recordings: list[Path] = RECORDINGS,
    model: str = MODEL,
    validate: list[Path] | None = VALIDATE,
    vehicle: str | None = VEHICLE,
    effects: Path | None = EFFECTS,
    output: Path | None = OUTPUT,
    json: Path | None = JSON,
    html: Path | None = HTML,
    rerun: Path | None = RERUN,
) -> None:
    """Find which physical effects a model is missing, add them, and prove it on other flights.

    Example: [bold]groundstation discrepancy flight1.mcap flight2.mcap --model body.json
    --validate flight3.mcap -o improved.json --html report.html[/bold]
    """
    import msgspec

    from groundstation import __version__, find_discrepancy
    from groundstation.discrepancy.report_json import discrepancy_report

    printed = json == STDOUT
    files = _Outputs(output, None if printed else json, html, rerun)
    files.require_new()
    require_apart(recordings, validate or [])
    loaded = model_for(model, vehicle)
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
            progress=lambda what, share: progress(share, what),
        )
        report = discrepancy_report(
            found,
            recordings=[path.name for path in recordings],
            validation=[path.name for path in validate] if validate else found.held_out,
            model=model,
            created_by=f"groundstation {__version__}",
        )
        _write(files, found, report)
    if printed:
        show_json(msgspec.to_builtins(report))
        return
    _say(report, written=output is not None)
    say_written(files.model, files.json, files.html, files.rerun)


def _own(path: Path | None) -> list[Variant]:
    from groundstation.dynamics.craft import consent
    from groundstation.identification.likelihood.motion import own_effects

    if path is None:
        return []
    with contextlib.suppress(OSError):  # whoever reads it says why it cannot be read
        consent(path)
    return own_effects(path)


def _write(files: _Outputs, found: Discrepancy, report: DiscrepancyReport) -> None:
    import msgspec

    from groundstation import BadInputError

    if files.model is not None:
        from groundstation import save_model

        save_model(_improved(found.findings.model, report), files.model)
    if files.json is not None:
        text = msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n"
        try:
            with files.json.open("xb") as file:
                file.write(text)
        except OSError as error:
            raise BadInputError(f"{files.json}: cannot be written: {error.strerror}") from error
    if files.html is not None:
        from groundstation.discrepancy.report_html import discrepancy_page

        discrepancy_page(found.proof, report).write(files.html)
    if files.rerun is not None:
        from groundstation.discrepancy.rerun_overlay import overlay_of
        from groundstation.viewer.overlay import write_overlay

        write_overlay(overlay_of(found.proof, report), files.rerun)


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


def _say(report: DiscrepancyReport, *, written: bool) -> None:
    """The outcome in plain words."""
    from groundstation.discrepancy.report_html import (
        by_weight,
        flight_plan,
        found_in_words,
        meaning,
        next_in_words,
        possible_in_words,
    )
    from groundstation.discrepancy.report_json import why_lost

    count = len(report.effects)
    verdict = {
        "effects_found": f"{count} effect{'s' if count != 1 else ''} found",
        "no_discrepancy": "no discrepancy",
        "unexplained": "unexplained",
    }[report.verdict]
    show(verdict)
    show(found_in_words(report))
    show(f"next: {next_in_words(report, written)}")
    say_good_for(report.good_for)
    if report.explained is not None:
        show(report.explained.words(report.disturbance))
    found = [f"changed: {change.words}" for change in report.base_changes]
    for line in found:
        show(line)
    for number, effect in enumerate(by_weight(report.effects), 1):
        found.append(f"{number}. {effect.name}: {meaning(effect)}")
        show(found[-1])
        _say_numbers(effect)
    tell_found(", ".join([verdict, *found]))
    for line in possible_in_words(report):
        show(line)
    for small in report.candidates:
        if small.refused_by == "negligible":
            show(f"{small.name}: {small.reason}")
    if report.residual == "structured":
        left = report.residual_detail
        where = ", ".join(f"{f:.3g}" for f in left.frequencies_hz)
        show(
            f"left over: structure in {left.channel}"
            + (f" at {where} Hz" if where else "")
            + (f", like {left.signal}" if left.signal else "")
        )
    for one in report.left:
        show(f"left in {one.words}")
    say_gap(report.gap)
    say_where(report.where)
    if report.not_shown:
        show("these recordings cannot show the rest; one flight with these parts would:")
        for number, (fly, names) in enumerate(flight_plan(report.not_shown), 1):
            show(f"  {number}. {fly}: {', '.join(names)}")
    for reason in dict.fromkeys(report.lost.values()):
        lost = ", ".join(name for name, why in report.lost.items() if why == reason)
        show(f"not looked for ({why_lost(reason)}): {lost}")
    for line in report.warnings:
        show(f"warning: {line}")


def _say_numbers(effect: EffectFound) -> None:
    from groundstation.discrepancy.report_html import chosen_in_words, is_zero

    for name, estimate in effect.parameters.items():
        spread = "" if estimate.stderr is None else f" +- {estimate.stderr:.2g}"
        zero = ", not distinguishable from zero" if is_zero(estimate) else ""
        show(f"     {name} {estimate.value:.4g}{spread} {estimate.unit}".rstrip() + zero)
    again = "" if effect.recurrence is None else f", {chosen_in_words(effect.recurrence)}"
    show(f"     gap {effect.gap.before:.3f} -> {effect.gap.after:.3f}{again}")
    for other in effect.alternatives:
        show(f"     could also be {other.name}; to tell: {other.manoeuvre}")
