"""``pid``: evaluate gains on a model, design them, fly them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation import BadInputError
from groundstation.cli import pid_design, pid_fly
from groundstation.cli.command_group import Commands
from groundstation.cli.model_files import (
    AS_JSON,
    HTML,
    fitted_model,
    require_new,
    say_written,
)
from groundstation.cli.pid_design import DELAY, FIRMWARE, release_of
from groundstation.cli.terminal import show, show_json

if TYPE_CHECKING:
    from groundstation import PidGains


def add_commands(app: typer.Typer) -> None:
    pid = Commands(
        no_args_is_help=True,
        help="Controllers: evaluate gains on a model, design them, fly them."
        "\n\nExample: [bold]groundstation pid evaluate --model body.json[/bold]",
    )
    pid.command("evaluate")(evaluate)
    pid.command("design")(pid_design.design)
    pid.command("convert")(pid_design.convert)
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

    if html is not None:
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
    if as_json:
        axes = {one.axis: one.as_dict() for one in results}
        show_json({"loop": chosen, "firmware": release, "model": model, "axes": axes})
        return
    for line in table_lines(METRICS_HEAD, [metrics_row(one) for one in results]):
        show(line)
    say_written(html)
