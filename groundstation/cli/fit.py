"""``fit``: identify a motor, a body or ARX models from recordings."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

import groundstation
from groundstation import BadInputError
from groundstation.cli.model_files import (
    AS_JSON,
    HTML,
    MASS,
    VEHICLE,
    bridged_runs_in,
    effect_names,
    model_before,
    motor_runs_in,
    open_one,
    require_apart,
    require_new,
    runs_in,
    say_written,
    with_reasons,
)
from groundstation.cli.terminal import Commands, show, show_json, shown, tell_found
from groundstation.paths import digest

if TYPE_CHECKING:
    from groundstation import Model, Recording, Run, Vehicle
    from groundstation.identification.estimate import Identified, Progress
    from groundstation.identification.runs import Selection

RECORDINGS = typer.Argument(metavar="REC...", help="Recordings; several are fitted together.")
VALIDATE = typer.Option(
    None, "--validate", help="Recordings to judge on (default: a third of all rows)."
)
OUTPUT = typer.Option(..., "-o", "--output", help="The new model file.")
MODEL = typer.Option(
    None, "--model", help="Model to start from: its motor, its effects, what is not fitted."
)
WITH = typer.Option("", "--with", help="Effects known to be there, separated by commas.")
SEGMENT = typer.Option(
    None, "--segment", metavar="FROM:TO", help="Only these seconds of each recording; repeatable."
)


def add_commands(app: typer.Typer) -> None:
    fit = Commands(
        no_args_is_help=True,
        help="Identify a motor, a body or ARX models."
        "\n\nExample: [bold]groundstation fit body flight.mcap -o body.json[/bold]",
    )
    fit.command("motor")(fit_motor)
    fit.command("body")(fit_body)
    fit.command("arx")(fit_arx)
    app.add_typer(fit, name="fit")


def fit_motor(
    recordings: list[Path] = RECORDINGS,
    output: Path = OUTPUT,
    validate: list[Path] | None = VALIDATE,
    vehicle: str | None = VEHICLE,
    mass: float | None = MASS,
    model: str | None = MODEL,
    effects: str = WITH,
    motor: int = typer.Option(1, min=1, max=4, help="Motor that carries the speed sensor."),
    segment: list[str] | None = SEGMENT,
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Fit a0, a1, a2 on recordings of the motor bench, or of each rotor on flights with recorded
    rotor speeds.

    Example: [bold]groundstation fit motor bench.mcap -o motor.json
    --with battery_reading_lag,supply_sag[/bold]
    """

    def identify(task: _Task, chosen: Selection, progress: Progress) -> Identified:
        named = effect_names(effects)
        return groundstation.fit_motor(*task, named, motor - 1, chosen, progress)

    given = _Given(recordings, validate, output, vehicle, mass, model, segment, html, as_json)
    _carry_out(identify, given, motor_runs_in)


def fit_body(
    recordings: list[Path] = RECORDINGS,
    output: Path = OUTPUT,
    validate: list[Path] | None = VALIDATE,
    vehicle: str | None = VEHICLE,
    mass: float | None = MASS,
    model: str | None = MODEL,
    effects: str = WITH,
    tie: bool = typer.Option(False, "--tie-roll-pitch", help="One constant for both: c1 = c0."),
    measured: bool = typer.Option(
        False, "--measured-rotors", help="Use recorded rotor speeds instead of the motor model."
    ),
    segment: list[str] | None = SEGMENT,
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Fit c0, c1, c2 and thrust_per_mass on flights, in closed loop as they were flown.

    Example: [bold]groundstation fit body flight1.mcap flight2.mcap --model motor.json
    -o body.json --with dead_time,rotor_acceleration_torque[/bold]
    """

    def identify(task: _Task, chosen: Selection, progress: Progress) -> Identified:
        named = effect_names(effects)
        return groundstation.fit_body(*task, named, tie, measured, chosen, progress)

    given = _Given(recordings, validate, output, vehicle, mass, model, segment, html, as_json)
    _carry_out(identify, given, bridged_runs_in)


def fit_arx(
    recordings: list[Path] = RECORDINGS,
    output: Path = OUTPUT,
    validate: list[Path] | None = VALIDATE,
    vehicle: str | None = VEHICLE,
    mass: float | None = MASS,
    model: str | None = MODEL,
    criterion: str = typer.Option(
        None, help="What chooses: free_run (default for angles) or prediction (for rates)."
    ),
    gyro: bool = typer.Option(False, "--gyro", help="Model the body rates, not the angles."),
    decimate: int = typer.Option(1, min=1, max=20, help="Rows of a recording per model row."),
    order: list[str] | None = typer.Option(
        None,
        help="Structure na,nb,nk to choose from instead of all 88; repeat it to see several beside"
        " each other.",
    ),
    segment: list[str] | None = SEGMENT,
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Search ARX models of the angles, as the thesis does (its tables 7.3 and 7.5).

    Example: [bold]groundstation fit arx flight.mcap -o arx.json --gyro --html arx.html[/bold]
    """
    from groundstation import Criterion
    from groundstation.identification.arx import parse_orders

    named = criterion or ("prediction" if gyro else "free_run")
    if named not in tuple(Criterion):
        raise BadInputError(f"--criterion {named}: there are {', '.join(Criterion)}")
    how = Criterion(named), "gyro" if gyro else "attitude", decimate
    orders = parse_orders(order or ())

    def identify(task: _Task, chosen: Selection, progress: Progress) -> Identified:
        return groundstation.fit_arx(*task, *how, chosen, orders, progress)

    given = _Given(recordings, validate, output, vehicle, mass, model, segment, html, as_json)
    _carry_out(identify, given, runs_in)


class _Given(NamedTuple):
    """What all fits are given."""

    recordings: list[Path]
    validate: list[Path] | None
    output: Path
    vehicle: str | None
    mass_kg: float | None
    model: str | None
    segment: list[str] | None
    html: Path | None
    as_json: bool


class _Task(NamedTuple):
    runs: list[Run]
    held: list[Run]
    before: Model
    vehicle: Vehicle


def _carry_out(
    identify: Callable[[_Task, Selection, Progress], Identified],
    given: _Given,
    read: Callable[[Sequence[Recording]], list[Run]],
) -> None:
    from groundstation import load_model, parse_selection
    from groundstation.dynamics.model import model_vehicle
    from groundstation.recording.quality import rejected
    from groundstation.recording.session import vehicle_of

    held_out = given.validate or []
    for path in (given.output, given.html):
        if path is not None:
            require_new(path)
    require_apart(given.recordings, held_out)
    selection = parse_selection(tuple(given.segment or ()))
    with shown("reading") as progress:
        fit_on, held = ([open_one(path) for path in p] for p in (given.recordings, held_out))
        every = [*fit_on, *held]
        model = load_model(given.model) if given.model is not None else None
        before = model_before(model, vehicle_of(every, given.vehicle, model), given.mass_kg)
        with with_reasons(every):
            task = _Task(read(fit_on), read(held), before, model_vehicle(before))
            found = identify(task, selection, progress)
        rows = sum(map(len, task.runs))
        lost = rows - sum(len(one.samples) for one in fit_on)
        if lost > 0:
            found.account["warnings"].append(f"{lost} of {rows} rows were lost, and bridged")
        taken = [line for one in every for line in rejected(one)]
        found.account["warnings"] = [*taken, *found.account["warnings"]]
        found.account["warnings"] += _doubts(found, task, every)
        _finish(_with_curve(found, task, fit_on), given, progress)


def _with_curve(found: Identified, task: _Task, recordings: Sequence[Recording]) -> Identified:
    """The same with the thrust curve of the craft's firmware, where a body's flights show it."""
    import msgspec

    from groundstation.control.firmwares import against, firmware_of_vehicle, flown_curve

    if found.account["what"] != "body" or task.vehicle.firmware != "2.x":
        return found
    firmware = firmware_of_vehicle(task.vehicle)
    curve = flown_curve(recordings, firmware)
    if curve is None:
        return found
    found.account["thrust_curve"] = against(curve, firmware, found.model)
    model = msgspec.structs.replace(found.model, firmware_curve=curve)
    return replace(found, model=model)


def _doubts(found: Identified, task: _Task, recordings: Sequence[Recording]) -> list[str]:
    """What is doubtful of a fit and of what it was made on. Raises BadInputError where its
    estimates are none."""
    from groundstation.identification.estimate import require_results
    from groundstation.identification.runs import renewal_notes
    from groundstation.recording.quality import contradictions

    of_recordings = [
        f"{one.path.name}: {line}" for one in recordings for line in contradictions(one.samples)
    ]
    found.account["contradictions"] = of_recordings
    doubts = require_results(found.account, task.before, task.vehicle, of_recordings)
    slow = [line for one in recordings for line in renewal_notes(one.samples, one.path.name)]
    return [*of_recordings, *doubts, *(slow if found.account["what"] == "body" else [])]


def _finish(found: Identified, given: _Given, progress: Progress) -> None:
    import msgspec

    from groundstation import __version__, save_model
    from groundstation.dynamics.model import origin_notes

    fit_on, held = (
        [{"file": path.name, "sha256": digest(path)} for path in paths or ()]
        for paths in (given.recordings, given.validate)
    )
    documented = found.documented(recordings=fit_on, held_out=held or found.account["held_out"])
    account = documented.fit[found.account["what"]]
    whole = msgspec.structs.replace(documented, created_by=f"groundstation {__version__}")
    save_model(whole, given.output)
    if given.html is not None:
        from groundstation.identification.report import report

        progress(0.9, "drawing the report")
        report(whole, account, found.evidence).write(given.html)
    if given.as_json:
        show_json(json.loads(given.output.read_bytes()))
    else:
        _print_account(whole, account, given.output)
        for line in origin_notes(whole):
            show(f"  in the file: {line}")
        say_written(given.html)


def _unit_of(name: str) -> str:
    """Of a held-out figure, whose name tells what it is."""
    if "percent" in name:
        return " %"
    return " rad/s" if name.startswith("gyro") else " m/s^2"


def _print_account(whole: Model, account: dict[str, Any], output: Path) -> None:
    from groundstation.identification.estimate import numbers_of
    from groundstation.identification.flight import LAST
    from groundstation.identification.report import good_for, next_of

    show(f"{output}: {account['what']} by {account['method']}, {account['samples']} samples")
    show(f"  {good_for(whole, account)[0]}")
    show(f"  next: {next_of(account)}")
    if "thrust_curve" in account:
        show(f"  {account['thrust_curve']}")
    if isinstance(account["held_out"], str) and account["held_out"] != LAST:
        show(f"  held out: {account['held_out']} of all rows, so that every axis is fitted")
    found = numbers_of(account)
    width = max((len(name) for name, *_ in found), default=0)
    for name, value, error in found:
        show(f"  {name:<{width}}{value:14.6g} +- {error:.2g}")
    if found:
        tell_found(", ".join(f"{name} {value:.6g} +- {error:.2g}" for name, value, error in found))
    for axis, one in account.get("axes", {}).items():
        tests = ", ".join(
            f"{test.replace('_', ' ')} {'passes' if one[test]['passes'] else 'fails'}"
            for test in ("whiteness", "cross_correlation")
        )
        show(f"  {axis:<6}{one['chosen']}; residuals: {tests}")
    for line in account.get("findings", ()):
        show(f"  {line}")
    held = account.get("validation")
    if isinstance(held, dict):
        for name, value in held.items():
            show(f"  held out: {name:<30}{value:10.4g}{_unit_of(name)}")
    for one in held if isinstance(held, list) else []:
        show(
            f"  held out: {one['recording']}: fit {one['rotor_fit_percent']:.1f} %,"
            f" RMS {one['rotor_rms_rev_s']:.2f} rev/s"
        )
    for line in account["warnings"]:
        show(f"  warning: {line}")
