"""``groundstation config``: what can be set, and what is set."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from groundstation.cli import terminal
from groundstation.cli.model_files import AS_JSON
from groundstation.documents import decode_toml
from groundstation.service.config import ConfigSource, settings


def add_commands(app: typer.Typer) -> None:
    app.command("config")(config)


def config(
    file: Path | None = typer.Option(None, "--config", help="TOML configuration file."),
    assign: list[str] = typer.Option(
        [], "--set", metavar="KEY=VALUE", help="Any key, as on the command line of 'run'."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Show every key, its value and its default. A file is overridden by the environment
    (GROUNDSTATION_RECORDING_FOLDER for recording.folder), and that by the command line.

    Example: [bold]groundstation config --config station.toml[/bold]
    """
    found = settings(ConfigSource(file, assignments(assign)).load())
    if as_json:
        keys = {
            each.name: {"value": each.value, "default": each.default, "text": each.text}
            for each in found
        }
        terminal.show_json(keys)
        return
    table = ""
    for each in found:
        if isinstance(each.value, dict):
            for line in ("", f"# {each.text}", f"[{each.name}]", *_assigned(each.value)):
                terminal.show(line)
            continue
        place, _, key = each.name.rpartition(".")
        if place != table:
            table = place
            terminal.show()
            terminal.show(f"[{table}]")
        usual = "" if each.value == each.default else f" (default {_toml(each.default)})"
        terminal.show(f"{key + ' = ' + _toml(each.value):<32}  # {each.text}{usual}")


def assignments(given: list[str]) -> dict[str, Any]:
    """``KEY=VALUE`` of the command line as key -> value. Raises a usage error for another form."""
    from groundstation.service.config import FORMER, former, keys, todays_name

    known = keys()
    values: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if key in FORMER:
            raise typer.BadParameter(former(key), param_hint="'--set'")
        key = todays_name(key, "--set ")
        if not equals or key not in known:
            raise typer.BadParameter(
                f"{text!r}: give KEY=VALUE with a KEY of 'groundstation config'",
                param_hint="'--set'",
            )
        values[key] = _value(value)
    return values


def _value(text: str) -> Any:
    """A TOML value where it is one, otherwise the text itself."""

    try:
        return decode_toml(f"value = {text}".encode(), dict[str, Any])["value"]
    except ValueError:
        return text


def _assigned(table: dict[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        yield f"{_name(key)} = {_toml(value)}"


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(_assigned(value)) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)


def _name(key: str) -> str:
    return key if key.replace("_", "a").isalnum() and key.isascii() else json.dumps(key)
