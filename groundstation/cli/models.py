"""``groundstation models``: what jobs have identified, and what can be done with it."""

from __future__ import annotations

from typing import Any

import typer

from groundstation.cli.command_group import Commands
from groundstation.cli.model_files import AS_JSON
from groundstation.cli.terminal import show, show_json
from groundstation.service.client import ask
from groundstation.service.config import socket_path

models = Commands(
    help=(
        "The models that the running daemon's jobs have made, beside the recordings."
        "\n\nExample: [bold]groundstation models list[/bold]"
    ),
    no_args_is_help=True,
)
NAME = typer.Argument(help="The model, as 'groundstation models list' names it.")


def add_commands(app: typer.Typer) -> None:
    app.add_typer(models, name="models")


@models.command("list")
def list_models(as_json: bool = AS_JSON) -> None:
    """Every model: what it was made from, its numbers with 95 % intervals, its effects.

    Example: [bold]groundstation models list[/bold]
    """
    found = ask(socket_path(), "GET", "/models")
    if as_json:
        show_json(found)
        return
    for one in found:
        made_from = f", from {' '.join(one['recordings'])}" if one["recordings"] else ""
        show(f"{one['id']}: {one['problem'] or one['vehicle'] + made_from}")
        for number in one["parameters"]:
            show(f"  {number['name']:<38} {_value(number)}")


@models.command("fly")
def fly(name: str = NAME, as_json: bool = AS_JSON) -> None:
    """Let the stand-in fly a model: it becomes the daemon's link.

    Example: [bold]groundstation models fly 2026-11-22T20-00-00-000Z_fit[/bold]
    """
    status = ask(socket_path(), "POST", "/link", {"name": f"stand-in:{name}"})
    if as_json:
        show_json(status)
    else:
        show(f"receiving from {status['link']['name']}")


@models.command("watch")
def watch(
    name: str = typer.Argument("", help="The model; none: watch no more."),
    as_json: bool = AS_JSON,
) -> None:
    """Let a model fly beside the craft: the live twin tells where they disagree.

    Example: [bold]groundstation models watch 2026-11-22T20-00-00-000Z_fit[/bold]
    """
    status = ask(socket_path(), "POST", "/models/watch", {"model": name})
    if as_json:
        show_json(status)
    else:
        show(f"the twin flies {name}" if status["twin"] else "no twin flies")


def _value(number: dict[str, Any]) -> str:
    text = f"{number['value']:.5g} {number['unit']}"
    if number["low"] is None:
        return f"{text} ({number['origin']})"
    return f"{text}, 95 % from {number['low']:.5g} to {number['high']:.5g}"
