"""``attitude`` and ``axes``: sensor fusion and axis check on a recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation import BadInputError
from groundstation.cli.model_files import (
    AS_JSON,
    HTML,
    answer,
    open_one,
    require_new,
    tell_rejected,
    with_reasons,
    write_table,
)

if TYPE_CHECKING:
    from groundstation.attitude.fusion import KalmanNoise


def add_commands(app: typer.Typer) -> None:
    app.command("attitude")(attitude)
    app.command("axes")(axes)


def attitude(
    recording: Path = typer.Argument(
        metavar="REC", help="Any recording with gyro and accelerometer."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Write the angles as CSV."),
    weight: float = typer.Option(
        0.998, help="Complementary filter: W, how much of each step is the gyro's, 0..1."
    ),
    noise: str = typer.Option(
        "0.001,0.001,5",
        help="Kalman filter: Q of angle (deg^2) and offset ((deg/s)^2), R of the accelerometer's"
        " angle (deg^2). Only their ratios matter.",
    ),
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Attitude by integration, complementary and Kalman filter, beside the reported one.

    Example: [bold]groundstation attitude hand_rotation.mcap --html attitude.html[/bold]
    """
    import numpy as np

    from groundstation.attitude.fusion import fuse

    require_new(output, html)
    given = _noise(noise)
    opened = open_one(recording)
    with with_reasons([opened], f"{recording}: "):
        fused = fuse(opened.samples, weight, given)
    moved = {name: v for name, v in fused.moved_deg().items() if name != "accelerometer"}
    if output is not None:
        drawn = {name: np.degrees(fused.angles[name]) for name in moved}
        axes_names = ("roll", "pitch", "yaw")
        head = "time_s," + ",".join(f"{n}_{a}_deg" for n in drawn for a in axes_names)
        write_table(output, head, np.column_stack([fused.time_s, *drawn.values()]))
    if html is not None:
        from groundstation.attitude.fusion import fusion_page

        fusion_page(fused, recording.name).write(html)
    bias, used = fused.rest_bias, fused.noise
    report = {
        "samples": len(fused.time_s),
        "rest_bias_dps": None if bias is None else np.degrees(bias).tolist(),
        "weight": fused.weight,
        "noise": [used.angle, used.bias, used.accelerometer],
        "end_minus_start_deg": moved,
    }
    tell_rejected([opened])
    lines = ["end minus start, deg      roll     pitch       yaw"]
    for name, values in moved.items():
        known = "".join(f"{value:10.2f}" for value in values)
        there = any(math.isfinite(value) for value in values)
        lines.append(f"  {name:<18}" + (known if there else "    not in the file"))
    if bias is None:
        lines.append(
            "no rest at the start: the gyro's offset was not subtracted from the Kalman input"
        )
    answer(as_json, report, lines, output, html)


def _noise(text: str) -> KalmanNoise:
    from groundstation.attitude.fusion import KalmanNoise

    try:
        angle, bias, accelerometer = (float(part) for part in text.split(","))
    except ValueError:
        raise BadInputError(f"--noise {text}: three numbers, for example 0.001,0.001,5") from None
    if not all(0 < one < math.inf for one in (angle, bias, accelerometer)):
        raise BadInputError(f"--noise {text}: all three must be positive and finite")
    return KalmanNoise(angle, bias, accelerometer)


def axes(
    recording: Path = typer.Argument(metavar="REC", help="A recording of the three hand turns."),
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Are the axes right? Turn by hand: roll (left up), pitch (nose down), yaw (left) and back.

    Any other recording that turns about all axes still shows whether attitude and gyro agree.

    Example: [bold]groundstation axes turned.mcap --html axes.html[/bold]
    """
    from groundstation import check_axes
    from groundstation.recording.quality import contradictions

    require_new(html)
    opened = open_one(recording)
    tell_rejected([opened])
    samples = opened.samples
    check = check_axes(samples)
    apart = contradictions(samples)
    if html is not None:
        from groundstation.attitude.fusion import axis_page

        axis_page(samples, check, apart, recording.name).write(html)
    report = {
        "verdict": check.verdict,
        "faults": [str(finding) for finding in check.faults],
        "findings": [str(finding) for finding in check.findings],
        "unclear": list(check.unclear),
        "contradictions": apart,
    }
    details = (f"  {line}" for line in (*report["findings"], *report["unclear"], *apart))
    answer(as_json, report, [check.verdict.replace("_", " "), *details], html)
