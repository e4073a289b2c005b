"""Commands on models: fit, simulate, attitude, axes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation.errors import BadInputError

if TYPE_CHECKING:
    from groundstation.dynamics.model import Model
    from groundstation.identification.runs import Run
    from groundstation.recording.session import Recording

RECORDINGS = typer.Argument(metavar="REC...", help="Recordings; several are fitted together.")
VALIDATE = typer.Option(
    None, "--validate", help="Recordings to judge on (default: the last third of each REC)."
)
VEHICLE = typer.Option("crazyflie1", help="Vehicle profile: built in, or a TOML file.")
OUTPUT = typer.Option(..., "-o", "--output", help="The new model file.")
MODEL = typer.Option(None, "--model", help="Model to start from: its motor, what is not fitted.")
WITH = typer.Option("", "--with", help="Effects known to be there, separated by commas.")
AS_JSON = typer.Option(False, "--json", help="Print JSON for programs.")


def add_commands(app: typer.Typer) -> None:
    fit = typer.Typer(no_args_is_help=True, help="Identify a motor, a body or ARX models.")
    fit.command("motor")(fit_motor)
    fit.command("body")(fit_body)
    fit.command("arx")(fit_arx)
    app.add_typer(fit, name="fit")
    app.command("simulate")(simulate)
    app.command("attitude")(attitude)
    app.command("axes")(axes)


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

    _require_new(output)
    profile = load_vehicle(vehicle)
    before = _model_before(model, vehicle)
    found, account = identify_motor(
        _runs(recordings), _runs(validate or []), profile, _names(effects), motor - 1
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

    _require_new(output)
    before = _model_before(model, vehicle)
    body, terms, account = identify_body(
        _runs(recordings),
        _runs(validate or []),
        load_vehicle(vehicle),
        before.motor,
        _names(effects),
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

    _require_new(output)
    if criterion not in tuple(Criterion):
        raise BadInputError(f"--criterion {criterion}: there are {', '.join(Criterion)}")
    before = _model_before(model, vehicle)
    found, account = identify_arx(
        _runs(recordings),
        _runs(validate or []),
        load_vehicle(vehicle),
        before.motor,
        Criterion(criterion),
    )
    after = msgspec.structs.replace(before, arx=found)
    _finish(after, account, recordings, validate, output, as_json)


def simulate(
    model: str = typer.Option(..., "--model", help="Model file, or the built-in 'thesis'."),
    recording: Path = typer.Option(..., "--recording", help="Whose PWM and battery drive it."),
    output: Path = typer.Option(..., "-o", "--output", help="A new CSV file."),
    window: float = typer.Option(
        0.5, help="Rates and attitude start afresh from measured ones after so many seconds."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Fly the identified model on a recording's inputs, and say how far it goes astray.

    Example: [bold]groundstation simulate --model body.json --recording flight.mcap
    -o simulated.csv[/bold]
    """
    import numpy as np

    from groundstation.dynamics.model import load_model
    from groundstation.identification.replayed import simulate_run

    _require_new(output)
    loaded = load_model(model)
    tables, errors = [], []
    for run in _runs([recording]):
        done = simulate_run(loaded, run, window)
        tables.append(
            np.column_stack(
                [
                    run.time_s,
                    done.rotor_rev_s,
                    np.degrees(done.gyro),
                    np.degrees(done.attitude),
                    done.accelerometer_z / 9.80665,
                ]
            )
        )
        errors.append(np.degrees(np.column_stack([done.gyro, done.attitude])))
        errors[-1] -= np.degrees(np.column_stack([run.gyro, run.attitude]))
    head = "time_s,rotor1_rev_s,rotor2_rev_s,rotor3_rev_s,rotor4_rev_s,gyro_x_dps,gyro_y_dps,"
    head += "gyro_z_dps,roll_deg,pitch_deg,yaw_deg,accelerometer_z_g"
    _write_csv(output, head, np.vstack(tables))
    rms = np.sqrt(np.mean(np.square(np.vstack(errors)), axis=0)).tolist()
    names = ("gyro_x_dps", "gyro_y_dps", "gyro_z_dps", "roll_deg", "pitch_deg", "yaw_deg")
    report = {
        "rows": sum(len(table) for table in tables),
        "window_s": window,
        "rms": dict(zip(names, rms, strict=True)),
    }
    if as_json:
        typer.echo(json.dumps(report, indent=2))
    else:
        typer.echo(f"{output}: {report['rows']} rows, fresh start every {window:g} s; RMS errors:")
        for name, value in zip(names, rms, strict=True):
            typer.echo(f"  {name:<12}{value:10.3f}")


def attitude(
    recording: Path = typer.Argument(
        metavar="REC", help="Any recording with gyro and accelerometer."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Write the angles as CSV."),
    as_json: bool = AS_JSON,
) -> None:
    """Attitude by integration, complementary and Kalman filter, beside the reported one.

    Example: [bold]groundstation attitude hand_rotation.mcap -o angles.csv[/bold]
    """
    import numpy as np

    from groundstation.attitude.filters import complementary, kalman
    from groundstation.attitude.sensors import integrate_gyroscope, rest_bias

    samples = _open(recording).samples
    inertial = np.hstack([samples.gyro, samples.accelerometer])
    samples = samples[np.flatnonzero(np.isfinite(inertial).all(axis=1))]
    if len(samples) < 100:
        raise BadInputError(f"{recording}: too few rows with gyro and accelerometer")
    time = samples.time_s
    bias = rest_bias(time, samples.gyro)
    gyro = samples.gyro - (np.zeros(3) if bias is None else bias)
    angles = {
        "integrated": integrate_gyroscope(time, samples.gyro),
        "complementary": complementary(time, samples.gyro, samples.accelerometer),
        "kalman": kalman(time, gyro, samples.accelerometer).attitude,
        "reported": np.unwrap(samples.attitude.astype(np.float64), axis=0),
    }
    ends = max(1, min(len(samples) // 20, 500))
    moved = {
        name: np.degrees(values[-ends:].mean(axis=0) - values[:ends].mean(axis=0)).tolist()
        for name, values in angles.items()
    }
    report = {
        "samples": len(samples),
        "rest_bias_dps": None if bias is None else np.degrees(bias).tolist(),
        "end_minus_start_deg": moved,
    }
    if output is not None:
        _require_new(output)
        axes_names = ("roll", "pitch", "yaw")
        head = "time_s," + ",".join(f"{n}_{a}_deg" for n in angles for a in axes_names)
        table = np.column_stack([time, *(np.degrees(values) for values in angles.values())])
        _write_csv(output, head, table)
    if as_json:
        typer.echo(json.dumps(report, indent=2))
        return
    typer.echo("end minus start, deg      roll     pitch       yaw")
    for name, values in moved.items():
        typer.echo(f"  {name:<18}" + "".join(f"{value:10.2f}" for value in values))
    if bias is None:
        typer.echo(
            "no rest at the start: the gyro's offset was not subtracted from the Kalman input"
        )


def axes(
    recording: Path = typer.Argument(metavar="REC", help="A recording of the three hand turns."),
    as_json: bool = AS_JSON,
) -> None:
    """Are the axes right? Turn by hand: roll (left up), pitch (nose down), yaw (left) and back.

    Any other recording that turns about all axes still shows whether attitude and gyro agree.

    Example: [bold]groundstation axes turned.mcap[/bold]
    """
    from groundstation.attitude.axis_check import attitude_against_gyro, check_axes

    samples = _open(recording).samples
    check = check_axes(samples)
    try:
        agreement = [str(finding) for finding in attitude_against_gyro(samples)]
    except BadInputError as error:
        agreement = [str(error)]
    report = {
        "verdict": check.verdict,
        "faults": [str(finding) for finding in check.faults],
        "findings": [str(finding) for finding in check.findings],
        "unclear": list(check.unclear),
        "attitude_against_gyro": agreement,
    }
    if as_json:
        typer.echo(json.dumps(report, indent=2))
        return
    typer.echo(f"{check.verdict.replace('_', ' ')}")
    for line in (*report["findings"], *report["unclear"]):
        typer.echo(f"  {line}")
    typer.echo("attitude against gyro:")
    for line in agreement:
        typer.echo(f"  {line}")


def _open(path: Path) -> Recording:
    from groundstation.recording.open_recording import open_recording

    return open_recording(path)


def _runs(paths: Sequence[Path]) -> list[Run]:
    from groundstation.identification.runs import runs_of

    return [run for path in paths for run in runs_of(_open(path).samples, path.name)]


def _names(effects: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in effects.split(",") if name.strip())


def _model_before(model: str | None, vehicle: str) -> Model:
    """What a fit changes: a given model, or the base model of the profile."""
    import msgspec

    from groundstation.dynamics.model import load_model, vehicle_model
    from groundstation.dynamics.vehicle import BUILT_IN, load_vehicle

    profile = load_vehicle(vehicle)
    before = load_model(model) if model is not None else vehicle_model(profile)
    return msgspec.structs.replace(
        before,
        vehicle=profile.name,
        vehicle_profile=None if vehicle in BUILT_IN else profile,
    )


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


def _require_new(path: Path) -> None:
    if path.exists():
        raise BadInputError(f"{path} exists already; nothing is ever overwritten")


def _write_csv(path: Path, head: str, table: Any) -> None:
    import numpy as np

    try:
        np.savetxt(path, table, fmt="%.6f", delimiter=",", header=head, comments="")
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error
