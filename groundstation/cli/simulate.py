"""``simulate``: an identified model on recorded inputs, or along a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import BadInputError
from groundstation.cli.model_files import (
    AS_JSON,
    ATTITUDE,
    answer,
    fitted_model,
    require_new,
    runs_from,
    told_turning,
    write_table,
)

if TYPE_CHECKING:
    from groundstation import Model
    from groundstation.dynamics.model import Turning

HEAD = (
    "time_s,rotor1_rev_s,rotor2_rev_s,rotor3_rev_s,rotor4_rev_s,"
    "gyro_x_dps,gyro_y_dps,gyro_z_dps,accelerometer_x_g,accelerometer_y_g,accelerometer_z_g,"
    "roll_deg,pitch_deg,yaw_deg"
)
NAMES = HEAD.split(",")[5:]
LONGEST_WINDOW_S = 60.0
"""An unstable craft's free run says nothing after a few seconds."""


def add_commands(app: typer.Typer) -> None:
    app.command("simulate")(simulate)


def simulate(
    model: str = typer.Option(..., "--model", help="Model file, or the built-in 'thesis'."),
    recording: Path | None = typer.Option(
        None, "--recording", help="Whose PWM and battery drive it."
    ),
    reference: str | None = typer.Option(
        None,
        "--reference",
        help="hover, step, doublet, sine, or a CSV file: time_s, roll_deg, pitch_deg, yaw_deg"
        " (and height_m).",
    ),
    output: Path = typer.Option(..., "-o", "--output", help="A new CSV file."),
    window: float = typer.Option(
        0.5,
        max=LONGEST_WINDOW_S,
        help="On a recording: start afresh from the observed state after so many seconds.",
    ),
    attitude: str | None = ATTITUDE,
    supply_v: float = typer.Option(3.7, help="Along a reference: steady supply voltage."),
    as_json: bool = AS_JSON,
) -> None:
    """Fly the identified model, with its effects, and write what it would have reported.

    On a recording's inputs it says how far the model goes astray. Along a reference the craft is
    kept in the air by a simple controller that knows the true state.

    Example: [bold]groundstation simulate --model body.json --recording flight.mcap
    -o simulated.csv[/bold]

    Example: [bold]groundstation simulate --model body.json --reference doublet -o made.csv[/bold]
    """
    if (recording is None) == (reference is None):
        raise typer.BadParameter("give one of --recording and --reference")
    if not 2.0 <= supply_v <= 10.0:
        raise BadInputError(f"--supply-v {supply_v:g}: must be 2..10 V")
    require_new(output)
    loaded = fitted_model(model)
    if recording is not None:
        turning = told_turning(loaded, attitude)
        report = _on_recording(loaded, recording, output, window, turning)
    elif attitude is not None:
        raise typer.BadParameter("--attitude: along a reference the body turns the craft")
    else:
        report = _along_reference(loaded, str(reference), output, supply_v)
    effects = ", ".join(term.name for term in loaded.effects) or "none"
    errors = (f"  RMS error {name:<20}{value:10.3f}" for name, value in report["rms"].items())
    what = f"{output}: {report['rows']} rows, {report['what']}; effects: {effects}"
    answer(as_json, report, [what, *errors])


def _on_recording(
    model: Model,
    recording: Path,
    output: Path,
    window: float,
    turning: Turning,
) -> dict[str, Any]:
    import numpy as np

    from groundstation import simulate_run
    from groundstation.identification.report import channels_of, errors_of, rms_of

    runs = runs_from([recording])
    done = [simulate_run(model, run, window, turning) for run in runs]
    table = [
        np.column_stack(
            [
                run.time_s,
                one.rotor_rev_s,
                channels_of(one.gyro, one.accelerometer, one.attitude),
            ]
        )
        for run, one in zip(runs, done, strict=True)
    ]
    error = np.vstack([errors_of(run, one) for run, one in zip(runs, done, strict=True)])
    if not np.isfinite(error).any():
        raise BadInputError(
            f"{recording}: by the model's thrust the craft never leaves the ground; nothing to"
            " simulate (another vehicle's model?)"
        )
    write_table(output, HEAD, np.vstack(table))
    return {
        "what": f"fresh start every {window:g} s",
        "rows": len(error),
        "rows_in_the_air": int(np.isfinite(error[:, 0]).sum()),
        "window_s": window,
        "rms": _by_name(rms_of(error)),
        "effects": [term.name for term in model.effects],
        "attitude": turning,
    }


def _along_reference(
    model: Model,
    source: str,
    output: Path,
    supply_v: float,
) -> dict[str, Any]:
    import numpy as np

    from groundstation import fly_reference, load_reference
    from groundstation.identification.report import channels_of

    reference = load_reference(source)
    made = fly_reference(model, reference, supply_v)
    time = np.arange(len(made.duty)) * made.period_s
    table = np.column_stack(
        [
            time,
            made.rotor_rev_s,
            channels_of(made.gyro, made.accelerometer, made.attitude),
            made.duty,
            made.supply_v,
            np.degrees(made.reference),
        ]
    )
    more = "duty1,duty2,duty3,duty4,battery_v,reference_roll_deg,reference_pitch_deg"
    write_table(output, f"{HEAD},{more},reference_yaw_deg", table)
    error = np.degrees(np.angle(np.exp(1j * (made.reference - made.attitude))))
    rms = np.sqrt(np.mean(np.square(error), axis=0))
    return {
        "what": f"along {reference.name}, reference less reported angle",
        "rows": len(table),
        "supply_v": supply_v,
        "rms": dict(zip(NAMES[6:], rms.tolist(), strict=True)),
        "effects": [term.name for term in model.effects],
    }


def _by_name(rms: Any) -> dict[str, float]:
    """RMS per channel; a channel that the recording lacks is left out."""
    pairs = zip(NAMES, rms.tolist(), strict=True)
    return {name: value for name, value in pairs if value == value}
