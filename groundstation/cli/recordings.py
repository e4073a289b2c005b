"""``groundstation recordings``: what the recordings folder holds."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import typer

from groundstation.cli.model_files import AS_JSON
from groundstation.cli.terminal import show, show_json


def add_commands(app: typer.Typer) -> None:
    app.command("recordings")(recordings)


def recordings(
    folder: Path | None = typer.Argument(
        None, help="A folder; without one that of the running daemon, or of the configuration."
    ),
    config: Path | None = typer.Option(None, help="TOML configuration file."),
    as_json: bool = AS_JSON,
) -> None:
    """The recordings of a folder, oldest first: when, how long, from which link, how complete.

    Example: [bold]groundstation recordings sessions[/bold]
    """
    found = _found(folder, config)
    if as_json:
        show_json(found)
        return
    if not found:
        show(f"no recordings in {folder or 'the recordings folder'}")
    for entry in found:
        show(_line(entry))


def _found(folder: Path | None, config: Path | None) -> list[dict[str, Any]]:
    from groundstation.errors import BadInputError, GroundStationError
    from groundstation.recording.catalogue import catalogue
    from groundstation.service.client import ask
    from groundstation.service.config import ConfigSource, socket_path

    if folder is None and config is None:
        try:
            answer: list[dict[str, Any]] = ask(socket_path(), "GET", "/recordings")
            return answer
        except GroundStationError:
            pass  # none is running: the folder it would use
    if folder is None:
        folder = Path(ConfigSource(config).load().recording.folder)
    if not folder.is_dir():
        raise BadInputError(f"{folder}: there is no such folder")
    return [entry.as_dict() for entry in catalogue(folder)]


def _line(entry: dict[str, Any]) -> str:
    size = f"{entry['bytes'] / 1e6:8.1f} MB"
    if entry["state"] != "finished":
        hint = "" if entry["state"] == "recording" else "; see 'groundstation recover'"
        return f"{entry['file']:<44} {size}  {entry['state']}{hint}"
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(entry["start_ns"] * 1e-9))
    samples = "" if entry["samples"] is None else f", {entry['samples']} samples"
    part = f", part {entry['part']}" if (entry["part"] or 1) > 1 else ""
    marks = f", {entry['marks']} marks" if entry["marks"] else ""
    return (
        f"{entry['file']:<44} {size}  {began}  {entry['duration_s']:8.1f} s  {entry['link']}"
        f"{samples}{part}{marks}"
    )
