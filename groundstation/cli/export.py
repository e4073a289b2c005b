"""``groundstation export``: what other programs build on."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import typer

from groundstation import BadInputError
from groundstation.cli.command_group import Commands
from groundstation.cli.model_files import require_new
from groundstation.cli.terminal import show

export = Commands(
    help="Files for whoever writes firmware or other programs."
    "\n\nExample: [bold]groundstation export header -o groundstation_telemetry.h[/bold]",
    no_args_is_help=True,
)


def add_commands(app: typer.Typer) -> None:
    app.add_typer(export, name="export")


@export.callback()
def _options() -> None:
    pass  # keeps the name of a single subcommand


@export.command("header")
def header(
    output: Path | None = typer.Option(None, "-o", "--output", help="A new file, not stdout."),
) -> None:
    """The packet, its serial frame and the bridge's USB descriptors as a C header.

    Example: [bold]groundstation export header -o groundstation_telemetry.h[/bold]
    """
    text = (resources.files("groundstation.telemetry") / "groundstation_telemetry.h").read_text()
    if output is None:
        for line in text.splitlines():
            show(line)
        return
    require_new(output)
    try:
        output.write_text(text)
    except OSError as error:
        raise BadInputError(f"{output}: {error.strerror or error}") from error
