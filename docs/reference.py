"""The reference pages: made from the code while MkDocs builds the site (``hooks`` there)."""

from __future__ import annotations

import ast
import asyncio
import inspect
import json
import re
import tomllib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import typer.main
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import groundstation
from groundstation.cli.app import app
from groundstation.discrepancy import proof as findings
from groundstation.dynamics.registry import EFFECTS
from groundstation.recording import formats as recording_formats
from groundstation.service.config import Config, settings

MAPS = Path(recording_formats.__file__).with_name("maps")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs asks for further pages here."""
    for name, make in PAGES.items():
        files.append(File.generated(config, f"reference/{name}.md", content=make()))
    return files


def commands() -> str:
    """Every command with its arguments, options and example."""
    parts = ["# Commands", "`groundstation COMMAND --help` says the same in the terminal."]
    for name, command in _commands(typer.main.get_command(app), ()):
        parts += [f"## groundstation {' '.join(name)}", _plain(command.help or "")]
        rows = [
            (_names(option), _plain(option.help or ""))
            for option in command.params
            if option.name != "help"
        ]
        if rows:
            parts.append(_table(("argument or option", "meaning"), rows))
    return "\n\n".join(parts) + "\n"


def configuration() -> str:
    """Every key of the configuration with its default."""
    rows = [
        (f"`{one.name}`", f"`{json.dumps(one.default)}`", one.text) for one in settings(Config())
    ]
    return (
        "# Configuration keys\n\nHow a file, the environment and the command line work together:"
        " [configuration](../configuration.md).\n\n"
        + _table(("key", "default", "meaning"), rows)
        + "\n"
    )


def effects() -> str:
    """Every physical effect that a model can have."""
    parts = [
        "# Effects",
        "What `discrepancy` searches, `fit --with` takes and a model file may hold. How the search"
        " decides: [find what is missing](../discrepancy.md).",
    ]
    for one in EFFECTS.values():
        parts += [
            f"## {one.name}",
            f"Adds {one.adds}. Acts on the stage `{one.stage}`. To see it, fly: {one.excited_by}.",
        ]
        if one.confused_with:
            others = ", ".join(f"[{other.other}](#{other.other})" for other in one.confused_with)
            parts.append(f"Some flights cannot tell it from {others}.")
        rows = [
            (f"`{p.name}`", f"{p.default:g}", f"{p.low:g} to {p.high:g}", p.unit or "1")
            for p in one.parameters
        ]
        parts.append(_table(("parameter", "default", "plausible range", "unit"), rows))
    parts += [
        "## Why a candidate is not named",
        "`refused_by` of each candidate in the search's report:",
        _table(("reason", "meaning"), [(f"`{name}`", why) for name, why in _reasons()]),
    ]
    return "\n\n".join(parts) + "\n"


def control_api() -> str:
    """Every request of the control API with its body."""
    from groundstation.service.control import openapi, operations
    from groundstation.service.station import Station

    async def document() -> dict[str, Any]:
        return openapi(operations(Station(Config())))

    schema = asyncio.run(document())
    parts = [
        "# Control API",
        "Made from the schema that `GET /openapi.json` answers with. Where the socket is, leases"
        " and the stream: [control API](../api.md).",
    ]
    for path, methods in schema["paths"].items():
        for method, one in methods.items():
            parts += [f"## {method.upper()} {path}", one["summary"] + "."]
            if "requestBody" in one:
                content = one["requestBody"]["content"]["application/json"]["schema"]
                parts += list(_body(schema, content))
    return "\n\n".join(parts) + "\n"


def formats() -> str:
    """What is read and written, and the column maps that are known by name."""
    rows = [
        (f"`{one.reader}`", f"`{one.suffix}`" if one.writer else "", "yes" if one.takes_map else "")
        for one in recording_formats.FORMATS
    ]
    parts = [
        "# Readers, writers and column maps",
        "A file is recognised by its first bytes, by these readers in this order. Units, signs and"
        " examples: [file formats](../formats.md).",
        _table(("reader", "written for the suffix", "takes a column map"), rows),
        "## Column maps",
        "`convert --list-columns` names them; `--columns NAME` or `--columns FILE` uses one.",
    ]
    rows = []
    for path in sorted(MAPS.glob("*.toml")):
        lines = path.read_text(encoding="utf-8").splitlines()
        about = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
        tomllib.loads("\n".join(lines))
        rows.append((f"`{path.stem}`", about))
    parts.append(_table(("map", "of"), rows))
    return "\n\n".join(parts) + "\n"


def python() -> str:
    """The public names, each with its docstring."""
    parts = [
        "# Python API",
        "All names are imported from `groundstation` itself. With examples: [the Python"
        " API](../python_api.md).",
    ]
    for name, place in groundstation.PUBLIC.items():
        parts.append(f"## {name}\n\n::: groundstation.{place}")
    return "\n\n".join(parts) + "\n"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Files of the repository outside docs/ are named, not linked: the site does not have them."""
    return re.sub(r"\[([^\]]+)\]\(\.\./([^)#]+)[^)]*\)", r"\1 (`\2`)", markdown)


PAGES = {
    "commands": commands,
    "configuration": configuration,
    "effects": effects,
    "control_api": control_api,
    "formats": formats,
    "python": python,
}
"""Name below ``reference/`` -> what makes the page."""


def _reasons() -> Iterator[tuple[str, str]]:
    """Value and docstring of each member of ``Reason``."""
    (body,) = ast.parse(inspect.getsource(findings.Reason)).body
    assert isinstance(body, ast.ClassDef)
    for member, text in pairwise(body.body):
        if isinstance(member, ast.Assign) and isinstance(text, ast.Expr):
            yield ast.literal_eval(member.value), ast.literal_eval(text.value)


def _commands(command: Any, name: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    if hasattr(command, "commands"):
        for one, below in command.commands.items():
            yield from _commands(below, (*name, one))
    else:
        yield name, command


def _names(option: Any) -> str:
    if option.param_type_name == "argument":
        return f"`{option.metavar or option.name.upper()}`"
    shown = [*option.opts, *option.secondary_opts]
    value = "" if option.is_flag else f" {option.metavar or option.name.upper()}"
    return ", ".join(f"`{name}{value}`" for name in shown)


def _body(schema: dict[str, Any], content: dict[str, Any]) -> Iterator[str]:
    name = content["$ref"].rpartition("/")[2]
    body = schema["components"]["schemas"][name]
    if body.get("description"):
        yield _plain(body["description"])
    required = body.get("required", [])
    rows = [
        (f"`{key}`", _kind(value), "yes" if key in required else json.dumps(value.get("default")))
        for key, value in body.get("properties", {}).items()
    ]
    yield _table(("field", "type", "required, or the default"), rows)


def _kind(value: dict[str, Any]) -> str:
    if "anyOf" in value:
        return " or ".join(_kind(one) for one in value["anyOf"])
    if "enum" in value:
        return ", ".join(f"`{one}`" for one in value["enum"])
    return str(value.get("type") or value.get("$ref", "any").rpartition("/")[2])


def _plain(text: str) -> str:
    """Help as Markdown: the terminal's bold becomes a code block of its own."""
    text = "\n".join(line.strip() for line in text.strip().splitlines())
    code = re.sub(
        r"\n*(?:Example|Examples): \[bold\](.*?)\[/bold\]",
        lambda found: f"\n\n```sh\n{' '.join(found[1].split())}\n```",
        text,
        flags=re.DOTALL,
    )
    return re.sub(r"\[/?bold\]", "`", code).replace("``", "`")


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    cells = ([" ".join(cell.split()).replace("|", "\\|") for cell in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)
