"""``pid``: evaluate gains on a model, design them, convert them, fly them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import BadInputError
from groundstation.cli import pid_fly
from groundstation.cli.model_files import (
    AS_JSON,
    HTML,
    answer,
    fitted_model,
    require_new,
)
from groundstation.cli.terminal import Commands, shown
from groundstation.paths import write_new

if TYPE_CHECKING:
    from groundstation import Model, PidGains
    from groundstation.control.design import AxisDesign, Design, Robustness
    from groundstation.control.firmwares import Release
    from groundstation.report.page import Page

# ``pid design``: gains by optimisation, for one of two loops; ``pid convert`` between forms.


MODEL = typer.Option(..., "--model", help="Model file, or the built-in 'thesis'.")
DELAY = typer.Option(None, "--delay", help="Samples of delay instead of the model's.")
FIRMWARE = typer.Option(
    None, "--firmware", help="2014 or 2.x: whose loops and gains (default: the vehicle's)."
)
AXIS = typer.Option(None, "--axis", help="roll, pitch or yaw; repeatable (default: all).")
LOOPS = ("firmware", "direct")


def design(
    model: str = MODEL,
    output: Path | None = typer.Option(None, "-o", "--output", help="A new TOML file of gains."),
    loop: str = typer.Option(
        "firmware", "--loop", help="firmware (cascaded) or direct (a PID on u' in (rev/s)^2)."
    ),
    firmware: str | None = FIRMWARE,
    axis: list[str] | None = AXIS,
    sensitivity: float | None = typer.Option(
        None,
        help="Largest maximum sensitivity (default: 2, or that of the stock gains where no gains"
        " within 2 follow as well).",
    ),
    spare_ms: float = typer.Option(2.0, help="More delay that the loops must bear, ms."),
    draws: int = typer.Option(300, help="Models drawn from the fit's covariance to try it on."),
    delay: int | None = DELAY,
    seed: int = typer.Option(0, help="Of the search and the draws."),
    html: Path | None = HTML,
    as_json: bool = AS_JSON,
) -> None:
    """Gains by optimisation: RMS, overshoot, settling and sensitivity together, within limits.

    Example: [bold]groundstation pid design --model body.json -o gains.toml
    --html design.html[/bold]
    """
    from groundstation import gains_text
    from groundstation.telemetry.arrays import AXES

    require_new(output, html)
    axes = tuple(axis or AXES)
    _require_sense(axes, sensitivity, spare_ms, draws, loop)
    cascaded = loop == "firmware"
    loaded = fitted_model(model, attitude=not cascaded)
    gains: dict[str, float] | dict[str, PidGains]
    release: Release | None = None
    if cascaded:
        release = release_of(loaded, firmware)
        report, gains, page = _design_firmware(
            loaded, release, axes, sensitivity, spare_ms / 1e3, draws, seed, model
        )
    else:
        report, gains, page = _design_thesis(
            loaded, axes, sensitivity, spare_ms / 1e3, delay, seed, model
        )

    if output is not None:
        write_new(output, gains_text(gains, release))
        report["output"] = str(output)
    if html is not None:
        page().write(html)
    lines = _design_lines(report)
    if output is not None:
        flies = f"to fly them: pid fly --model {model} --gains {output}"
        converts = "'pid convert --to firmware' makes of them what a craft flies"
        lines.append(f"{output}: {flies if cascaded else converts}")
    answer(as_json, report, lines, html)


def _require_sense(
    axes: tuple[str, ...], sensitivity: float | None, spare_ms: float, draws: int, loop: str
) -> None:
    from groundstation.telemetry.arrays import AXES

    for one in axes:
        if one not in AXES:
            raise BadInputError(f"--axis {one}: there are {', '.join(AXES)}")
    if sensitivity is not None and not 1.1 <= sensitivity <= 10.0:
        raise BadInputError(f"--sensitivity {sensitivity}: must be 1.1..10")
    if not 0.0 <= spare_ms <= 100.0:
        raise BadInputError(f"--spare-ms {spare_ms}: must be 0..100")
    if draws < 0:
        raise BadInputError(f"--draws {draws}: must not be negative")
    if loop not in LOOPS:
        raise BadInputError(f"--loop {loop}: there are {', '.join(LOOPS)}")


def _design_firmware(
    model: Model,
    release: Release,
    axes: tuple[str, ...],
    sensitivity: float | None,
    spare_s: float,
    draws: int,
    seed: int,
    name: str,
) -> tuple[dict[str, Any], dict[str, float], Callable[[], Page]]:
    from groundstation import cascade_limits, design_cascade, robustness
    from groundstation.control.report import firmware_page, firmware_report

    with shown("designing") as show:
        progress = _of_axes(axes, lambda share, what: show(0.9 * share, what))
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
    return report, gains, lambda: firmware_page(model, name, designs, tried, report)


def _design_thesis(
    model: Model,
    axes: tuple[str, ...],
    sensitivity: float | None,
    spare_s: float,
    delay: int | None,
    seed: int,
    name: str,
) -> tuple[dict[str, Any], dict[str, PidGains], Callable[[], Page]]:
    from groundstation.control.design import Limits, design_direct, require_certain
    from groundstation.control.linear_loop import axis_plant
    from groundstation.control.report import thesis_design_page, thesis_report
    from groundstation.dynamics.model import THESIS

    require_certain(model, [axis for axis in axes if axis not in (model.arx or {})])
    found: dict[str, tuple[PidGains, Design, Any, Any]] = {}
    limits = Limits(sensitivity=sensitivity or Limits().sensitivity, delay_s=spare_s)
    with shown("designing") as show:
        for number, axis in enumerate(axes):
            plant = axis_plant(model, axis, delay)

            def progress(share: float, number: int = number, axis: str = axis) -> None:
                show((number + share) / len(axes), f"designing {axis}")

            gains, one, margins = design_direct(plant, limits, seed=seed, progress=progress)
            found[axis] = gains, one, margins, plant
    printed = model.arx == THESIS.arx
    if not printed:
        _require_followed(model, {axis: gains for axis, (gains, *_) in found.items()}, delay)
    report = thesis_report(found, limits, printed)
    chosen = {axis: gains for axis, (gains, *_) in found.items()}
    return report, chosen, lambda: thesis_design_page(name, found, report)


def _require_followed(model: Model, found: dict[str, PidGains], delay: int | None) -> None:
    """Raises BadInputError for gains on u' that the model's motors cannot follow."""
    from groundstation.control.linear_loop import reason_not_followed

    reasons = [reason_not_followed(model, gains, axis, delay) for axis, gains in found.items()]
    beyond = "; ".join(reason for reason in reasons if reason)
    if beyond:
        raise BadInputError(
            f"no motor follows these gains. {beyond}. Design with the motors: --loop firmware"
        )


def _of_axes(
    axes: tuple[str, ...], show: Callable[[float, str], None]
) -> Callable[[str, float], None]:
    """What takes (axis, share) of designs that go on beside each other."""
    done: dict[str, float] = {}

    def progress(axis: str, share: float) -> None:
        done[axis] = share
        show(sum(done.values()) / len(axes), f"designing {axis}")

    return progress


def _design_lines(report: dict[str, Any]) -> list[str]:
    lines = []
    for axis, one in report["axes"].items():
        gain_up, delay_s = (  # None: no change of it makes the loop unstable
            math.inf if one[key] is None else one[key] for key in ("gain_up", "delay_margin_s")
        )
        lines += [
            f"{axis}: " + ", ".join(f"{k} {v:.6g}" for k, v in one["gains"].items()),
            f"  settles in {one['settling_s']:.3f} s, overshoot {one['overshoot_pct']:.1f} %,"
            f" RMS {one['rms']:.3f} of the step, maximum sensitivity {one['max_sensitivity']:.2f},"
            f" gain x{gain_up:.1f}, delay +{1e3 * delay_s:.1f} ms",
            *(f"  {line}" for line in (*one["reasons"], *one["notes"])),
        ]
    return [*lines, *report["notes"]]


def convert(
    gains: Path = typer.Argument(..., help="TOML file of gains."),
    model: str = MODEL,
    to: str = typer.Option(..., "--to", help="direct, whole or firmware (2014's)."),
    output: Path = typer.Option(..., "-o", "--output", help="A new TOML file of gains."),
    source: str = typer.Option(
        "", "--from", help="What they are, where the file does not say: direct or whole."
    ),
    supply_v: float = typer.Option(3.7, help="Battery at which the motors are taken, V."),
    as_json: bool = AS_JSON,
) -> None:
    """Gains of one loop as those of another: u' in (rev/s)^2, PWM counts, the firmware's cascade.

    Example: [bold]groundstation pid convert whole.toml --model body.json --to firmware
    -o gains.toml[/bold]
    """
    from groundstation import PidGains, gains_text, load_gains
    from groundstation.control.firmware_loop import loop_of_gains, require_gains_of
    from groundstation.control.linear_loop import FORMS as KNOWN
    from groundstation.control.linear_loop import convert_gains

    require_new(output)
    if to not in KNOWN:
        raise BadInputError(f"--to {to}: there are {', '.join(KNOWN)}")
    if not 2.5 <= supply_v <= 20.0:
        raise BadInputError(f"--supply-v {supply_v:g}: must be 2.5..20 V")
    given, named = load_gains(gains), loop_of_gains(gains)
    if not any(isinstance(value, PidGains) for value in given.values()):
        named = "firmware"
        require_gains_of(gains, "2014", "what can be converted")
    if source and named and source != named:
        raise BadInputError(f"--from {source}: {gains} holds gains of the {named} loop")
    kind = source or named or "direct"
    if kind not in KNOWN:
        raise BadInputError(f"--from {source}: there are direct, whole")
    if kind == "firmware" and named != "firmware":
        raise BadInputError(f"--from firmware: {gains} holds gains by axis")
    made = convert_gains(given, kind, to, fitted_model(model, attitude=True), 1e3 * supply_v)
    release: Release | None = "2014" if to == "firmware" else None
    write_new(output, gains_text(made, release, to if to == "whole" else None))
    told, lines = dict[str, Any](), []
    for name, value in made.items():
        if isinstance(value, PidGains):
            told[name] = dict(zip(("kp", "ki", "kd"), value.as_tuple(), strict=True))
            lines.append(f"{name}: kp {value.kp:.6g}, ki {value.ki:.6g}, kd {value.kd:.6g}")
        else:
            told[name] = value
            lines.append(f"{name} = {value:.6g}")
    whole = {"from": kind, "to": to, "gains": told, "output": str(output)}
    answer(as_json, whole, lines, output)


def release_of(model: Model, said: str | None) -> Release:
    """Whose loops fly the craft of a model, or what the user says instead."""
    from groundstation.control.firmwares import firmware_of_vehicle
    from groundstation.dynamics.model import model_vehicle

    return firmware_of_vehicle(model_vehicle(model), said).name


# ``pid``: evaluate gains on a model, design them, fly them.


def add_commands(app: typer.Typer) -> None:
    pid = Commands(
        no_args_is_help=True,
        help="Controllers: evaluate gains on a model, design them, fly them."
        "\n\nExample: [bold]groundstation pid evaluate --model body.json[/bold]",
    )
    pid.command("evaluate")(evaluate)
    pid.command("design")(design)
    pid.command("convert")(convert)
    pid.command("fly")(pid_fly.fly)
    app.add_typer(pid, name="pid")


def evaluate(
    model: str = typer.Option("thesis", "--model", help="Model file, or 'thesis'."),
    gains: Path | None = typer.Option(None, "--gains", help="TOML file of gains."),
    loop: str = typer.Option(
        "", "--loop", help="direct (u' in (rev/s)^2), whole (Figure 8.10) or firmware."
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
    from groundstation import PidGains, load_gains
    from groundstation import evaluate as evaluate_gains
    from groundstation.control.firmware_loop import loop_of_gains, require_gains_of
    from groundstation.control.linear_loop import LOOPS
    from groundstation.control.report import METRICS_HEAD, evaluation_page, metrics_row, table_lines

    require_new(html)
    if not 0.1 <= seconds <= 60.0:
        raise BadInputError(f"--seconds {seconds}: must be 0.1..60")
    given: dict[str, PidGains] | dict[str, float] = {} if gains is None else load_gains(gains)
    form = "direct" if any(isinstance(g, PidGains) for g in given.values()) else "firmware"
    named = None if gains is None else loop_of_gains(gains)
    chosen = loop or named or form
    if named is not None and chosen != named:
        raise BadInputError(f"--loop {chosen}: {gains} holds gains of the {named} loop")
    if chosen not in LOOPS:
        raise BadInputError(f"--loop {loop}: there are {', '.join(LOOPS)}")
    loaded = fitted_model(model, attitude=chosen != "firmware")
    release = release_of(loaded, firmware) if chosen == "firmware" else None
    if release is not None and gains is not None and form == "firmware":
        require_gains_of(gains, release, f"the craft of {model}", said=firmware)
    results = evaluate_gains(loaded, given, chosen, seconds, delay, release)
    if html is not None:
        name = "stock gains" if gains is None else gains.name
        evaluation_page(results, f"{name} on {model}", chosen).write(html)
    axes = {one.axis: one.as_dict() for one in results}
    told = {"loop": chosen, "firmware": release, "model": model, "axes": axes}
    lines = table_lines(METRICS_HEAD, [metrics_row(one) for one in results])
    answer(as_json, told, lines, html)
