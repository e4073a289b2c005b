"""``simulate``: an identified model on recorded inputs."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from groundstation.cli.model_files import AS_JSON, require_new, runs_from, write_table


def add_commands(app: typer.Typer) -> None:
    app.command("simulate")(simulate)


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

    require_new(output)
    loaded = load_model(model)
    tables, errors = [], []
    for run in runs_from([recording]):
        done = simulate_run(loaded, run, window)
        tables.append(
            np.column_stack(
                [
                    run.time_s,
                    done.rotor_rev_s,
                    np.degrees(done.gyro),
                    np.degrees(done.attitude),
                    done.accelerometer[:, 2] / 9.80665,
                ]
            )
        )
        errors.append(np.degrees(np.column_stack([done.gyro, done.attitude])))
        errors[-1] -= np.degrees(np.column_stack([run.gyro, run.attitude]))
    head = "time_s,rotor1_rev_s,rotor2_rev_s,rotor3_rev_s,rotor4_rev_s,gyro_x_dps,gyro_y_dps,"
    head += "gyro_z_dps,roll_deg,pitch_deg,yaw_deg,accelerometer_z_g"
    write_table(output, head, np.vstack(tables))
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
