"""``groundstation page``: another address of the running daemon's page."""

from __future__ import annotations

import typer

from groundstation import socket_path
from groundstation.cli.model_files import AS_JSON
from groundstation.cli.terminal import show, show_json
from groundstation.service.client import ask


def add_commands(app: typer.Typer) -> None:
    app.command("page")(page)


def page(as_json: bool = AS_JSON) -> None:
    """A new address of the operator's page: it lets one browser in.

    Example: [bold]groundstation page[/bold]
    """
    answer = ask(socket_path(), "POST", "/page/address")
    if as_json:
        show_json(answer)
    else:
        show(answer["url"])
