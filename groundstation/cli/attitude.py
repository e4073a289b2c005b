"""``attitude`` and ``axes``: sensor fusion and axis check on a recording."""

from __future__ import annotations

from pathlib import Path

import typer

from groundstation.cli.model_files import AS_JSON, open_one, require_new, say_written, write_table
from groundstation.cli.terminal import show, show_json
from groundstation.errors import BadInputError


def add_commands(app: typer.Typer) -> None:
    app.command("attitude")(attitude)
    app.command("axes")(axes)


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

    samples = open_one(recording).samples
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
        require_new(output)
        axes_names = ("roll", "pitch", "yaw")
        head = "time_s," + ",".join(f"{n}_{a}_deg" for n in angles for a in axes_names)
        table = np.column_stack([time, *(np.degrees(values) for values in angles.values())])
        write_table(output, head, table)
    if as_json:
        show_json(report)
        return
    show("end minus start, deg      roll     pitch       yaw")
    for name, values in moved.items():
        show(f"  {name:<18}" + "".join(f"{value:10.2f}" for value in values))
    if bias is None:
        show("no rest at the start: the gyro's offset was not subtracted from the Kalman input")
    say_written(output)


def axes(
    recording: Path = typer.Argument(metavar="REC", help="A recording of the three hand turns."),
    as_json: bool = AS_JSON,
) -> None:
    """Are the axes right? Turn by hand: roll (left up), pitch (nose down), yaw (left) and back.

    Any other recording that turns about all axes still shows whether attitude and gyro agree.

    Example: [bold]groundstation axes turned.mcap[/bold]
    """
    from groundstation.attitude.axis_check import attitude_against_gyro, check_axes

    samples = open_one(recording).samples
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
        show_json(report)
        return
    show(f"{check.verdict.replace('_', ' ')}")
    for line in (*report["findings"], *report["unclear"]):
        show(f"  {line}")
    show("attitude against gyro:")
    for line in agreement:
        show(f"  {line}")
