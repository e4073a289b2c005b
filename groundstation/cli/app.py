"""The ``groundstation`` command line: every command, put together."""

from __future__ import annotations

from importlib import import_module

import typer

from groundstation import __version__
from groundstation.cli.terminal import Commands, Root, show

COMMANDS = (
    "run",
    "control",
    "files",
    "devices",
    "fit",
    "simulate",
    "discrepancy",
    "pid",
    "bench",
    "attitude",
    "fleet",
    "learn",
    "thesis",
    "install",
)
"""The modules whose ``add_commands(app)`` adds commands, in the order of ``--help``. What the page
may begin as well stands in ``service/jobs.py``."""

app = Commands(
    name="groundstation",
    cls=Root,
    help=(
        "Ground station for the Crazyflie quadrotor: receive, record, view and replay telemetry."
        "\n\nExample: [bold]groundstation run --link stand-in --viewer serve[/bold]"
    ),
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


def _show_version(value: bool) -> None:
    if value:
        show(f"groundstation {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_show_version, is_eager=True, help="Show the version."
    ),
    trust_effects: bool = typer.Option(
        False, "--trust-effects", help="Run the Python files that models name, now and from now on."
    ),
) -> None:
    if trust_effects:
        from groundstation.dynamics.craft import consent

        consent()


def add(name: str) -> None:
    """Add the commands of a module of this package."""
    import_module(f"groundstation.cli.{name}").add_commands(app)


for name in COMMANDS:
    add(name)
