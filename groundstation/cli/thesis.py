"""``thesis``: every table and figure that has a counterpart, beside the printed one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from groundstation.cli.model_files import AS_JSON, answer
from groundstation.cli.terminal import shown

if TYPE_CHECKING:
    from groundstation.thesis.workshop import Entry

PAGE = "index.html"


def add_commands(app: typer.Typer) -> None:
    app.command("thesis")(thesis)


def thesis(
    output: Path = typer.Option(..., "-o", "--output", help="A new or empty folder."),
    only: list[str] | None = typer.Option(
        None, "--only", metavar="NUMBER", help="Only this table or figure, 7.1 say; repeatable."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Repeat the thesis: every table and figure that has a counterpart, beside the printed numbers.

    Flies the stand-in, fits, designs, and leaves one page with the command behind each number, all
    files, and the commands as a script. Takes one to three minutes.

    Example: [bold]groundstation thesis -o repeated[/bold]

    Example: [bold]groundstation thesis --only 7.3 --only 8.5 -o some[/bold]
    """
    from groundstation.shell import Shell
    from groundstation.thesis.catalogue import as_json as whole
    from groundstation.thesis.catalogue import chosen, make, page
    from groundstation.thesis.workshop import Workshop, inputs

    entries = chosen(only or [])
    with (
        Shell(output, inputs(), lambda line: None, "groundstation thesis") as shell,
        shown("reading") as progress,
    ):

        def begin(number: int, entry: Entry) -> None:
            progress(number / len(entries), entry.number)

        done = make(Workshop(shell), entries, begin)
        progress(0.95, "drawing the page")
        seconds = shell.spent.wall_s
        page(done, seconds).write(output / PAGE)
    told = {**whole(done, seconds), "page": str(output / PAGE)}
    answer(as_json, told, [f"{len(done)} tables and figures in {seconds:.0f} s"], output / PAGE)
