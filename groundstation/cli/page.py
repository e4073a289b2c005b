"""``groundstation page``: another address of the running daemon's page."""

from __future__ import annotations

import typer

from groundstation.cli.terminal import show
from groundstation.service.client import ask
from groundstation.service.config import socket_path


def add_commands(app: typer.Typer) -> None:
    app.command("page")(page)


def page() -> None:
    """A new address of the operator's page: it lets one browser in.

    Example: [bold]groundstation page[/bold]
    """
    show(ask(socket_path(), "POST", "/page/address")["url"])
