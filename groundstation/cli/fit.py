"""``fit``: identify a motor, a body or ARX models from recordings."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation.cli.model_files import (
    AS_JSON,
    VEHICLE,
    effect_names,
    model_before,
    require_new,
    runs_from,
)
from groundstation.errors import BadInputError

if TYPE_CHECKING:
    from groundstation.dynamics.model import Model

RECORDINGS = typer.Argument(metavar="REC...", help="Recordings; several are fitted together.")
VALIDATE = typer.Option(
    None, "--validate", help="Recordings to judge on (default: the last third of each REC)."
)
OUTPUT = typer.Option(..., "-o", "--output", help="The new model file.")
MODEL = typer.Option(None, "--model", help="Model to start from: its motor, what is not fitted.")
WITH = typer.Option("", "--with", help="Effects known to be there, separated by commas.")


def add_commands(app: typer.Typer) -> None:
    fit = typer.Typer(no_args_is_help=True, help="Identify a motor, a body or ARX models.")
    fit.command("motor")(fit_motor)
    fit.command("body")(fit_body)
    fit.command("arx")(fit_arx)
    app.add_typer(fit, name="fit")


def fit_motor(
    recordings: list[Path] = RECORDINGS,
    output: Path = OUTPUT,
    validate: list[Path] | None = VALIDATE,
    vehicle: str = VEHICLE,
    model: str | None = MODEL,
    effects: str = WITH,
    motor: int = typer.Option(1, min=1, max=4, help="Motor that carries the speed sensor."),
    as_json: bool = AS_JSON,
) -> None:
    """Fit a0, a1, a2 on recordings of the motor bench, or with measured rotor speed.

    Example: [bold]groundstation fit motor bench.mcap -o motor.json
    --with battery_reading_lag,supply_sag[/bold]
    """
    import msgspec

    from groundstation.dynamics.vehicle import load_vehicle
    from groundstation.identification.workflow import identify_motor

    require_new(output)
    profile = load_vehicle(vehicle)
    before = model_before(model, vehicle)
    found, account = identify_motor(
        runs_from(recordings), runs_from(validate or []), profile, effect_names(effects), motor - 1
    )
    _finish(
        msgspec.structs.replace(before, motor=found), account, recordings, validate, output, as_json
    )


def fit_body(
    recordings: list[Path] = RECORDINGS,
    output: Path = OUTPUT,
    validate: list[Path] | None = VALIDATE,
    vehicle: str = VEHICLE,
    model: str | None = MODEL,
    effects: str = WITH,
    tie: bool = typer.Option(False, "--tie-roll-pitch", help="One constant for both: c1 = c0."),
    measured: bool = typer.Option(
        False, "--measured-rotors", help="Use recorded rotor speeds instead of the motor model."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Fit c0, c1, c2 and thrust_per_mass on flights, in closed loop as they were flown.

    Example: [bold]groundstation fit body flight1.mcap flight2.mcap --model motor.json
    -o body.json --with dead_time,rotor_acceleration_torque[/bold]
    """
    import msgspec

    from groundstation.dynamics.vehicle import load_vehicle
    from groundstation.identification.workflow import identify_body

    require_new(output)
    before = model_before(model, vehicle)
    body, terms, account = identify_body(
        runs_from(recordings),
        runs_from(validate or []),
        load_vehicle(vehicle),
        before.motor,
        effect_names(effects),
        tie,
        measured,
    )
    fitted = {term.name for term in terms}
    kept = tuple(term for term in before.effects if term.name not in fitted)
    after = msgspec.structs.replace(before, body=body, effects=kept + terms)
    _finish(after, account, recordings, validate, output, as_json)


def fit_arx(
    recordings: list[Path] = RECORDINGS,
    output: Path = OUTPUT,
    validate: list[Path] | None = VALIDATE,
    vehicle: str = VEHICLE,
    model: str | None = MODEL,
    criterion: str = typer.Option("free_run", help="What chooses: free_run or prediction."),
    as_json: bool = AS_JSON,
) -> None:
    """Search ARX models of the angles, as the thesis does (its tables 7.3 and 7.5).

    Example: [bold]groundstation fit arx flight.mcap -o arx.json[/bold]
    """
    import msgspec

    from groundstation.dynamics.vehicle import load_vehicle
    from groundstation.identification.arx import Criterion
    from groundstation.identification.workflow import identify_arx

    require_new(output)
    if criterion not in tuple(Criterion):
        raise BadInputError(f"--criterion {criterion}: there are {', '.join(Criterion)}")
    before = model_before(model, vehicle)
    found, account = identify_arx(
        runs_from(recordings),
        runs_from(validate or []),
        load_vehicle(vehicle),
        before.motor,
        Criterion(criterion),
    )
    after = msgspec.structs.replace(before, arx=found)
    _finish(after, account, recordings, validate, output, as_json)


def _finish(
    model: Model,
    account: dict[str, Any],
    recordings: Sequence[Path],
    validate: Sequence[Path] | None,
    output: Path,
    as_json: bool,
) -> None:
    import msgspec

    from groundstation import __version__
    from groundstation.dynamics.model import save_model

    account = {
        **account,
        "recordings": [_fingerprint(path) for path in recordings],
        "held_out": [_fingerprint(path) for path in validate or []] or "last third",
    }
    whole = msgspec.structs.replace(
        model,
        fit={**model.fit, account["what"]: account},
        created_by=f"groundstation {__version__}",
    )
    save_model(whole, output)
    if as_json:
        typer.echo(output.read_text(), nl=False)
    else:
        _print_account(account, output)


def _fingerprint(path: Path) -> dict[str, str]:
    return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def _print_account(account: dict[str, Any], output: Path) -> None:
    echo: Callable[[str], None] = typer.echo
    echo(f"{output}: {account['what']} by {account['method']}, {account['samples']} samples")
    estimates = account.get("estimates")
    if estimates:
        for name, value, error in zip(
            estimates["names"], estimates["values"], estimates["stderr"], strict=True
        ):
            echo(f"  {name:<42}{value:14.6g} +- {error:.2g}")
    for axis, one in account.get("axes", {}).items():
        best = one["table"][0]["rms_validation_rad"]
        tests = ", ".join(
            f"{test.replace('_', ' ')} {'passes' if one[test]['passes'] else 'fails'}"
            for test in ("whiteness", "cross_correlation")
        )
        echo(f"  {axis:<6}{one['chosen']}: best validation RMS {best:.4f} rad; {tests}")
    held = account.get("validation")
    if isinstance(held, dict):
        for name, value in held.items():
            echo(f"  held out: {name:<32}{value:.4g}")
    for one in held if isinstance(held, list) else []:
        echo(
            f"  held out: {one['recording']}: fit {one['rotor_fit_percent']:.1f} %,"
            f" RMS {one['rotor_rms_rev_s']:.2f} rev/s"
        )
    for line in account["warnings"]:
        echo(f"  warning: {line}")
