"""``pid``: evaluate gains on a model, design them, fly them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation.cli import pid_fly
from groundstation.cli.model_files import AS_JSON, HTML, fitted_model, require_new, say_written
from groundstation.cli.progress import shown
from groundstation.cli.terminal import show, show_json
from groundstation.errors import BadInputError
from groundstation.paths import taken

if TYPE_CHECKING:
    from groundstation.control.design import Design
    from groundstation.control.firmware_design import AxisDesign, Robustness
    from groundstation.control.firmwares import Release
    from groundstation.control.pid import PidGains
    from groundstation.dynamics.model import Model

MODEL = typer.Option(..., "--model", help="Model file, or the built-in 'thesis'.")
DELAY = typer.Option(None, "--delay", help="Samples of delay instead of the model's.")
FIRMWARE = typer.Option(
    None, "--firmware", help="2014 or 2.x: whose loops and gains (default: the vehicle's)."
)
AXIS = typer.Option(None, "--axis", help="roll, pitch or yaw; repeatable (default: all).")


def add_commands(app: typer.Typer) -> None:
    pid = typer.Typer(
        no_args_is_help=True,
        help="Controllers: evaluate gains on a model, design them, fly them."
        "\n\nExample: [bold]groundstation pid evaluate --thesis[/bold]",
    )
    pid.command("evaluate")(evaluate)
    pid.command("design")(design)
    pid.command("fly")(pid_fly.fly)
    app.add_typer(pid, name="pid")


def evaluate(
    model: str = typer.Option("thesis", "--model", help="Model file, or 'thesis'."),
    gains: Path | None = typer.Option(None, "--gains", help="TOML file of gains."),
    loop: str = typer.Option(
        "", "--loop", help="direct (u' in (rev/s)^2), whole (Figure 8.10) or firmware."
    ),
    thesis: bool = typer.Option(
        False, "--thesis", help="The printed controllers beside the printed tables 8.5-8.7."
    ),
    delay: int | None = DELAY,
    firmware: str | None = FIRMWARE,
    seconds: float = typer.Option(1.5, help="Window of the step response."),
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """What a step gives with some gains, and what margins are left.

    Without --gains the firmware's stock gains are taken. The direct loop is the one on which the
    thesis's printed gains act; the whole simulation takes gains in PWM counts per rad.

    Example: [bold]groundstation pid evaluate --model body.json --gains gains.toml
    --html pid.html[/bold]
    """
    from groundstation.control.evaluate import LOOPS
    from groundstation.control.evaluate import evaluate as evaluate_gains
    from groundstation.control.gains_file import load_gains, require_gains_of
    from groundstation.control.pid import PidGains
    from groundstation.control.report import (
        METRICS_HEAD,
        evaluation_page,
        metrics_row,
        table_lines,
    )

    if html is not None:
        require_new(html)
    if thesis:
        _evaluate_thesis(delay, html, as_json)
        return
    if not 0.1 <= seconds <= 60.0:
        raise BadInputError(f"--seconds {seconds}: must be 0.1..60")
    given: dict[str, PidGains] | dict[str, float] = {} if gains is None else load_gains(gains)
    form = "direct" if any(isinstance(g, PidGains) for g in given.values()) else "firmware"
    chosen = loop or form
    if chosen not in LOOPS:
        raise BadInputError(f"--loop {loop}: there are {', '.join(LOOPS)}")
    loaded = fitted_model(model, attitude=chosen != "firmware")
    if chosen == "firmware":
        _tell_polynomials_rest(loaded, "--loop direct or whole")
    release = _release_of(loaded, firmware) if chosen == "firmware" else None
    if release is not None and gains is not None and form == "firmware":
        require_gains_of(gains, release, f"the craft of {model}", said=firmware)
    results = evaluate_gains(loaded, given, chosen, seconds, delay, release)
    if html is not None:
        name = "stock gains" if gains is None else gains.name
        evaluation_page(results, f"{name} on {model}", chosen).write(html)
    if as_json:
        axes = {one.axis: one.as_dict() for one in results}
        show_json({"loop": chosen, "firmware": release, "model": model, "axes": axes})
        return
    for line in table_lines(METRICS_HEAD, [metrics_row(one) for one in results]):
        show(line)
    say_written(html)


def _tell_polynomials_rest(model: Model, instead: str) -> None:
    if model.arx is not None:
        show(
            "the firmware's loops are closed around the model's body; its ARX polynomials rest"
            f" ({instead} closes loops around them)",
            error=True,
        )


def _release_of(model: Model, said: str | None) -> Release:
    """Whose loops fly the craft of a model, or what the user says instead."""
    from groundstation.control.firmwares import firmware_of_vehicle
    from groundstation.dynamics.model import model_vehicle

    return firmware_of_vehicle(model_vehicle(model), said).name


def _evaluate_thesis(delay: int | None, html: Path | None, as_json: bool) -> None:
    import numpy as np

    from groundstation.control.linear_loop import run_direct
    from groundstation.control.report import THESIS_HEAD, table_lines, thesis_page, thesis_rows
    from groundstation.control.thesis_tables import (
        DELAYS,
        FINDING,
        GAINS,
        printed_cases,
        printed_plant,
        window_s,
    )

    delays = DELAYS if delay is None else (delay,)
    cases = printed_cases(delays)
    if html is not None:
        responses = {}
        for case in cases:
            plant = printed_plant(case.axis, case.delay)
            rows = round(window_s(case.axis) / plant.ts)
            gains = GAINS[case.controller][case.axis.split(",")[0]]
            key = case.controller, case.axis, case.delay
            responses[key] = run_direct(plant, gains, np.ones(rows)).y
        thesis_page(cases, responses).write(html)
    if as_json:
        show_json(
            {
                "finding": FINDING,
                "cases": [
                    {
                        "axis": case.axis,
                        "controller": case.controller,
                        "delay_samples": case.delay,
                        "stable": case.stable,
                        "most_delay_samples": case.most_delay,
                        **case.metrics.as_dict(),
                        "printed": dict(
                            zip(
                                ("rms", "overshoot_pct", "settling_s"),
                                case.printed,
                                strict=True,
                            )
                        ),
                    }
                    for case in cases
                ],
            },
        )
        return
    for line in table_lines(THESIS_HEAD, thesis_rows(cases)):
        show(line)
    show()
    show(FINDING)
    say_written(html)


def design(
    model: str = MODEL,
    output: Path | None = typer.Option(None, "-o", "--output", help="A new TOML file of gains."),
    form: str = typer.Option("firmware", help="firmware (cascaded) or thesis (a PID on u')."),
    firmware: str | None = FIRMWARE,
    axis: list[str] | None = AXIS,
    sensitivity: float = typer.Option(2.0, help="Largest maximum sensitivity."),
    spare_ms: float = typer.Option(2.0, help="More delay that the loops must bear, ms."),
    draws: int = typer.Option(1000, help="Models drawn from the fit's covariance to try it on."),
    delay: int | None = DELAY,
    rounding: bool = typer.Option(
        False, "--rounding", help="Thesis form: hold for all that the printed digits stand for."
    ),
    seed: int = typer.Option(0, help="Of the search and the draws."),
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Gains by optimisation: the best tracking that the stated robustness allows.

    Example: [bold]groundstation pid design --model body.json -o gains.toml
    --html design.html[/bold]
    """
    from groundstation.control.pid import AXES

    for path in (output, html):
        if path is not None:
            require_new(path)
    axes = tuple(axis or AXES)
    for one in axes:
        if one not in AXES:
            raise BadInputError(f"--axis {one}: there are {', '.join(AXES)}")
    if not 1.1 <= sensitivity <= 10.0:
        raise BadInputError(f"--sensitivity {sensitivity}: must be 1.1..10")
    if not 0.0 <= spare_ms <= 100.0:
        raise BadInputError(f"--spare-ms {spare_ms}: must be 0..100")
    if draws < 0:
        raise BadInputError(f"--draws {draws}: must not be negative")
    loaded = fitted_model(model, attitude=form != "firmware")
    gains: dict[str, float] | dict[str, PidGains]
    release: Release | None = None
    if form == "firmware":
        _tell_polynomials_rest(loaded, "--form thesis")
        release = _release_of(loaded, firmware)
        report, gains, page = _design_firmware(
            loaded, release, axes, sensitivity, spare_ms / 1e3, draws, seed, model
        )
    elif form == "thesis":
        report, gains, page = _design_thesis(
            loaded, axes, sensitivity, spare_ms / 1e3, delay, rounding, seed, model
        )
    else:
        raise BadInputError(f"--form {form}: there are firmware, thesis")
    from groundstation.control.gains_file import gains_text

    if output is not None:
        _write_new(output, gains_text(gains, release))
        report["output"] = str(output)
    if html is not None:
        page.write(html)
    if as_json:
        show_json(report)
        return
    _print_design(report)
    if output is not None:
        show(f"{output}: to fly them: pid fly --model {model} --gains {output}")
    say_written(html)


def _design_firmware(
    model: Model,
    release: Release,
    axes: tuple[str, ...],
    sensitivity: float,
    spare_s: float,
    draws: int,
    seed: int,
    name: str,
) -> tuple[dict[str, Any], dict[str, float], Any]:
    from groundstation.control.design_report import firmware_page, firmware_report
    from groundstation.control.firmware_design import cascade_limits, design_cascade, robustness

    done: dict[str, float] = {}
    with shown("designing") as show:

        def progress(axis: str, share: float) -> None:
            done[axis] = share
            show(0.9 * sum(done.values()) / len(axes), f"designing {axis}")

        limits = cascade_limits(sensitivity, spare_s)
        designs: list[AxisDesign] = design_cascade(
            model, axes, limits, seed, progress=progress, release=release
        )
        gains = {key: value for one in designs for key, value in one.gains.items()}
        show(0.9, f"trying {draws} models")
        tried: Robustness | None = (
            robustness(model, gains, axes, draws, seed, release=release) if draws else None
        )
    report = firmware_report(model, release, designs, tried, limits)
    return report, gains, firmware_page(model, name, designs, tried, report)


def _design_thesis(
    model: Model,
    axes: tuple[str, ...],
    sensitivity: float,
    spare_s: float,
    delay: int | None,
    rounding: bool,
    seed: int,
    name: str,
) -> tuple[dict[str, Any], dict[str, PidGains], Any]:
    from groundstation.control.design import Limits, design_direct, rounding_corners
    from groundstation.control.design_report import thesis_design_page, thesis_report
    from groundstation.control.linear_loop import axis_plant

    found: dict[str, tuple[PidGains, Design, Any, Any]] = {}
    limits = Limits(sensitivity=sensitivity, delay_s=spare_s)
    with shown("designing") as show:
        for number, axis in enumerate(axes):
            plant = axis_plant(model, axis, delay)
            plants = rounding_corners(plant) if rounding else [plant]

            def progress(share: float, number: int = number, axis: str = axis) -> None:
                show((number + share) / len(axes), f"designing {axis}")

            gains, one, margins = design_direct(plants, limits, seed=seed, progress=progress)
            found[axis] = gains, one, margins, plant
    report = thesis_report(found, limits, rounding)
    chosen = {axis: gains for axis, (gains, *_) in found.items()}
    return report, chosen, thesis_design_page(name, found, report)


def _print_design(report: dict[str, Any]) -> None:
    for axis, one in report["axes"].items():
        show(f"{axis}: " + ", ".join(f"{k} {v:.6g}" for k, v in one["gains"].items()))
        settling = one["settling_s"]
        show(
            f"  settles in {settling:.3f} s, overshoot {one['overshoot_pct']:.1f} %,"
            f" RMS {one['rms']:.3f} of the step, maximum sensitivity {one['max_sensitivity']:.2f},"
            f" gain x{one['gain_up'] or float('inf'):.1f},"
            f" delay +{1e3 * one['delay_margin_s']:.1f} ms"
        )
        for line in (*one["reasons"], *one["notes"]):
            show(f"  {line}")
    for line in report["notes"]:
        show(line)


def _write_new(path: Path, text: str) -> None:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise BadInputError(taken(path)) from error
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written: {error.strerror}") from error
