"""Commands that talk to a running daemon."""

from __future__ import annotations

import json
import time
from typing import Any

import typer

from groundstation.service.client import ask
from groundstation.service.config import socket_path

JSON_OPTION = typer.Option(False, "--json", help="Print JSON for programs.")

record = typer.Typer(
    help=(
        "Start or stop a recording of the running daemon."
        "\n\nExample: [bold]groundstation record stop[/bold]"
    ),
    no_args_is_help=True,
)


def add_commands(app: typer.Typer) -> None:
    app.command("status")(status)
    app.command("events")(events)
    app.add_typer(record, name="record")


def status(as_json: bool = JSON_OPTION) -> None:
    """What the running daemon is doing.

    Example: [bold]groundstation status --json[/bold]
    """
    answer = ask(socket_path(), "GET", "/status")
    if as_json:
        typer.echo(json.dumps(answer, indent=2))
        return
    link, recording, viewer = answer["link"], answer["recording"], answer["viewer"]
    command = answer["command"]
    latency = "" if link["latency_ms"] is None else f", {link['latency_ms']:.1f} ms late"
    rows = [
        ("link", f"{link['name']}  {link['state']}"),
        ("", f"{link['rate_hz']:.1f} samples/s, {link['lost']} lost{latency}"),
        ("recording", _recording_line(recording)),
        ("viewer", f"{viewer['state']}, {viewer['dropped']} dropped"),
        *(("", url) for url in viewer["urls"]),
        ("command", "off" if command is None else f"{command['uri']}  {command['state']}"),
        ("up", f"{answer['uptime_s']:.0f} s"),
    ]
    for name, text in rows:
        typer.echo(f"{name:<11}{text}")


def events(as_json: bool = JSON_OPTION) -> None:
    """The latest events of the running daemon, oldest first.

    Example: [bold]groundstation events[/bold]
    """
    answer = ask(socket_path(), "GET", "/events")
    if as_json:
        typer.echo(json.dumps(answer, indent=2))
        return
    for event in answer:
        moment = time.strftime("%H:%M:%S", time.localtime(event["time_ns"] * 1e-9))
        typer.echo(f"{moment}  {event['link']:<24} {event['kind']:<11}{event['text']}")


@record.command("start")
def record_start(as_json: bool = JSON_OPTION) -> None:
    """Begin a new recording.

    Example: [bold]groundstation record start[/bold]
    """
    _report(ask(socket_path(), "POST", "/record/start"), as_json)


@record.command("stop")
def record_stop(as_json: bool = JSON_OPTION) -> None:
    """Finish the present recording.

    Example: [bold]groundstation record stop[/bold]
    """
    _report(ask(socket_path(), "POST", "/record/stop"), as_json)


def _report(recording: dict[str, Any], as_json: bool) -> None:
    typer.echo(json.dumps(recording, indent=2) if as_json else _recording_line(recording))


def _recording_line(recording: dict[str, Any]) -> str:
    if recording["file"] is None:
        return "off"
    return (
        f"{recording['state']}  {recording['file']}  {recording['bytes'] / 1e6:.1f} MB, "
        f"{recording['samples']} samples"
    )
