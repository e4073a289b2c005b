"""Commands that talk to a running daemon."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import Client, socket_path
from groundstation.cli.command_group import Commands
from groundstation.cli.config import add_commands as add_config
from groundstation.cli.model_files import AS_JSON
from groundstation.cli.motors import add_commands as add_motors
from groundstation.cli.page import add_commands as add_page
from groundstation.cli.progress import own_terminal
from groundstation.cli.terminal import show, show_json
from groundstation.links.factory import KINDS
from groundstation.service.client import ask
from groundstation.text import printable

if TYPE_CHECKING:
    from rich.table import Table

WATCH_S = 0.5

record = Commands(
    help=(
        "Start, stop or mark a recording of the running daemon."
        "\n\nExample: [bold]groundstation record stop[/bold]"
    ),
    no_args_is_help=True,
)


def add_commands(app: typer.Typer) -> None:
    app.command("status")(status)
    app.command("events")(events)
    app.command("link")(link)
    app.add_typer(record, name="record")
    add_motors(app)
    add_page(app)
    add_config(app)


def status(
    as_json: bool = AS_JSON,
    watch: bool = typer.Option(False, "--watch", help="Keep showing it, until Ctrl-C."),
) -> None:
    """What the running daemon is doing.

    Example: [bold]groundstation status --watch[/bold]
    """
    if watch:
        _watch(as_json)
        return
    answer = ask(socket_path(), "GET", "/status")
    if as_json:
        show_json(answer)
        return
    for name, text in status_rows(answer):
        show(f"{name:<11}{text}")


def status_rows(answer: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """A status in words: what it is about, and one line each."""
    link, recording, viewer = answer["link"], answer["recording"], answer["viewer"]
    command, stream, health = answer["command"], answer["stream"], answer["health"]
    statistics = answer["statistics"]
    latency = "" if link["latency_ms"] is None else f", {link['latency_ms']:.1f} ms late"
    yield "link", f"{link['name']}  {link['state']}"
    yield "", f"{link['rate_hz']:.1f} samples/s, {link['lost']} lost{latency}"
    if statistics is not None:
        copies = statistics["copies"]
        yield (
            "",
            f"{statistics['packets_hz']:.0f} packets/s, {statistics['loss_pct']:.2f} % lost lately"
            + ("" if copies is None else f", {copies:.1f} copies"),
        )
    yield "recording", _recording_line(recording)
    if recording["rotations"] or recording["resumed"] or recording["deleted"]:
        yield (
            "",
            f"{recording['rotations']} rotations, resumed {recording['resumed']} times, "
            f"{recording['deleted']} old files deleted",
        )
    free = recording["free_mb"]
    if free is not None:
        yield "disk", f"{free / 1e3:.1f} GB free"
    yield "viewer", f"{viewer['state']}, {viewer['dropped']} dropped"
    yield from (("", url) for url in viewer["urls"])
    page = answer["page"]
    yield "page", page["state"] + (f"  {page['url']}" if page["url"] else "")
    if command is None:
        yield "command", "off"
    else:
        holder = f", {command['client']} commands" if command["client"] else ""
        yield "command", f"{command['uri']}  {command['state']}{holder}"
        if command["stored"]:
            stored = ", ".join(f"{name} {value:g}" for name, value in command["stored"].items())
            yield "stored", stored
    yield "stream", f"{stream['clients']} clients, {stream['dropped']} dropped"
    yield (
        "daemon",
        f"up {_duration(answer['uptime_s'])}, {health['memory_mb']:.0f} MB, "
        f"{health['descriptors']} descriptors, {health['threads']} threads, "
        f"{answer['faults']} faults",
    )
    yield "health", "good" if health["healthy"] else "; ".join(health["problems"])


def events(as_json: bool = AS_JSON) -> None:
    """The latest events of the running daemon, oldest first.

    Example: [bold]groundstation events[/bold]
    """
    answer = ask(socket_path(), "GET", "/events")
    if as_json:
        show_json(answer)
        return
    for event in answer:
        moment = time.strftime("%H:%M:%S", time.localtime(event["time_ns"] * 1e-9))
        show(f"{moment}  {event['link']:<24} {event['kind']:<11}{event['text']}")


def link(
    name: str = typer.Argument(help=f"{KINDS}."),
    as_json: bool = AS_JSON,
) -> None:
    """Let the running daemon receive from another link; the recording goes on.

    Example: [bold]groundstation link usb[/bold]
    """
    kind, _, file = name.partition(":")
    if kind == "replay" and Path(file).exists():  # from here, which need not be the daemon's folder
        name = f"replay:{Path(file).absolute()}"
    answer = ask(socket_path(), "POST", "/link", {"name": name})
    if as_json:
        show_json(answer)
        return
    show(f"{answer['link']['name']}  {answer['link']['state']}")


@record.command("start")
def record_start(as_json: bool = AS_JSON) -> None:
    """Begin a new recording.

    Example: [bold]groundstation record start[/bold]
    """
    _report(ask(socket_path(), "POST", "/record/start"), as_json)


@record.command("stop")
def record_stop(as_json: bool = AS_JSON) -> None:
    """Finish the present recording.

    Example: [bold]groundstation record stop[/bold]
    """
    _report(ask(socket_path(), "POST", "/record/stop"), as_json)


@record.command("mark")
def record_mark(text: str = typer.Argument(help="The note."), as_json: bool = AS_JSON) -> None:
    """Put a note into the recording, at this moment.

    Example: [bold]groundstation record mark "new propellers"[/bold]
    """
    answer = ask(socket_path(), "POST", "/record/mark", {"text": text})
    if as_json:
        show_json(answer, indent=None)
    else:
        show("marked")


def _watch(as_json: bool) -> None:
    """Show the status until Ctrl-C or the end of the daemon; as JSON one line each time."""
    from rich.live import Live

    own_terminal()
    with Client(socket_path()) as client:
        if as_json:
            while True:
                show_json(client.ask("GET", "/status"), indent=None)
                time.sleep(WATCH_S)
        if not sys.stdout.isatty():
            while True:
                rows = status_rows(client.ask("GET", "/status"))
                show("; ".join(f"{name} {text}" for name, text in rows if text))
                time.sleep(WATCH_S)
        first = _screen(client.ask("GET", "/status"))
        # an end while the screen is being set up would leave stderr turned to the screen
        with Live(first, auto_refresh=False, redirect_stderr=False) as screen:
            while True:
                time.sleep(WATCH_S)
                screen.update(_screen(client.ask("GET", "/status")), refresh=True)


def _screen(answer: dict[str, Any]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, title=f"groundstation  {time.strftime('%H:%M:%S')}")
    table.add_column(style="bold")
    table.add_column()
    healthy = answer["health"]["healthy"]
    for name, text in status_rows(answer):
        style = ("green" if healthy else "bold red") if name == "health" else ""
        table.add_row(name, Text(printable(text), style=style))
    return table


def _report(recording: dict[str, Any], as_json: bool) -> None:
    if as_json:
        show_json(recording)
    else:
        show(_recording_line(recording))


def _recording_line(recording: dict[str, Any]) -> str:
    if recording["file"] is None:
        return "off"
    return (
        f"{recording['state']}  {recording['file']}  {recording['bytes'] / 1e6:.1f} MB, "
        f"{recording['samples']} samples"
    )


def _duration(seconds: float) -> str:
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    days, hour = divmod(hours, 24)
    return (
        f"{days} d {hour:02d}:{minute:02d}:{second:02d}"
        if days
        else (f"{hour}:{minute:02d}:{second:02d}" if hour else f"{minute}:{second:02d} min")
    )
