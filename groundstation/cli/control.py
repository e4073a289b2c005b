"""Commands that talk to a running daemon, its motors and its page."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation import Client, GroundStationError, socket_path
from groundstation.cli.model_files import AS_JSON, answer, config
from groundstation.cli.terminal import Commands, own_terminal, require_yes, show, show_json
from groundstation.links.command import is_software
from groundstation.links.factory import KINDS
from groundstation.service.client import ask
from groundstation.service.lease import LANDED, STOPPED
from groundstation.text import printable

if TYPE_CHECKING:
    from rich.table import Table

# Commands that talk to a running daemon.


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
    app.add_typer(motors, name="motors")
    app.command("page")(page)
    app.command("config")(config)


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
    found = ask(socket_path(), "GET", "/status")
    answer(as_json, found, (f"{name:<11}{text}" for name, text in status_rows(found)))


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
    found = ask(socket_path(), "GET", "/events")
    lines = (
        f"{time.strftime('%H:%M:%S', time.localtime(event['time_ns'] * 1e-9))}"
        f"  {event['link']:<24} {event['kind']:<11}{event['text']}"
        for event in found
    )
    answer(as_json, found, lines)


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
    found = ask(socket_path(), "POST", "/link", {"name": name})
    answer(as_json, found, [f"{found['link']['name']}  {found['link']['state']}"])


@record.command("start")
def record_start(as_json: bool = AS_JSON) -> None:
    """Begin a new recording.

    Example: [bold]groundstation record start[/bold]
    """
    recording = ask(socket_path(), "POST", "/record/start")
    answer(as_json, recording, [_recording_line(recording)])


@record.command("stop")
def record_stop(as_json: bool = AS_JSON) -> None:
    """Finish the present recording.

    Example: [bold]groundstation record stop[/bold]
    """
    recording = ask(socket_path(), "POST", "/record/stop")
    answer(as_json, recording, [_recording_line(recording)])


@record.command("mark")
def record_mark(text: str = typer.Argument(help="The note."), as_json: bool = AS_JSON) -> None:
    """Put a note into the recording, at this moment.

    Example: [bold]groundstation record mark "new propellers"[/bold]
    """
    marked = ask(socket_path(), "POST", "/record/mark", {"text": text})
    answer(as_json, marked, ["marked"], indent=None)


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
    if days:
        return f"{days} d {hour:02d}:{minute:02d}:{second:02d}"
    return f"{hour}:{minute:02d}:{second:02d}" if hour else f"{minute}:{second:02d} min"


# ``motors``: what an operator may do to the motors, whoever commands.


motors = Commands(
    help=(
        "Land the craft that the running daemon commands, stop, arm or disarm its motors, or let it"
        " recover from a crash."
        "\n\nExample: [bold]groundstation motors stop[/bold]"
    ),
    no_args_is_help=True,
)


@motors.command("stop")
def stop(as_json: bool = AS_JSON) -> None:
    """Stop the motors immediately, whoever is flying. A craft in the air falls.

    Every program that was started before loses control, and learn ends. Fails if the telemetry
    does not confirm within 3 s that the motors stand.

    Example: [bold]groundstation motors stop[/bold]
    """
    _end("stop", (STOPPED,), as_json)


@motors.command("land")
def land(as_json: bool = AS_JSON) -> None:
    """Land the craft, whoever is flying, and stop its motors on the ground.

    Every program that was started before loses control, and learn ends. Takes up to 6 s. Needs a
    craft that holds its height. One that does not fly is said to be stopped. Fails if the telemetry
    does not confirm it.

    Example: [bold]groundstation motors land[/bold]
    """
    _end("land", (LANDED, STOPPED), as_json)


@motors.command("arm")
def arm(
    yes: bool = typer.Option(False, "--yes", help="Do not ask before a real craft is armed."),
    as_json: bool = AS_JSON,
) -> None:
    """Arm the motors of a craft that needs it, and wait for its answer.

    The motors of a Brushless idle as soon as they are armed. Firmware of 2014 knows no arming, and
    a Crazyflie 2.1 arms itself.

    Example: [bold]groundstation motors arm[/bold]
    """
    command = ask(socket_path(), "GET", "/status")["command"]
    if command is not None and not is_software(command["uri"]) and not yes:
        question = f"{command['uri']}: clear of people, propellers may turn; arm its motors?"
        require_yes(question, "not armed")
    ask(socket_path(), "POST", "/command/arm", {"on": True})
    answer(as_json, {"motors": "armed"}, ["armed"])


@motors.command("disarm")
def disarm(as_json: bool = AS_JSON) -> None:
    """Disarm the motors, whoever commands, and wait for the craft's answer.

    Example: [bold]groundstation motors disarm[/bold]
    """
    ask(socket_path(), "POST", "/command/arm", {"on": False})
    answer(as_json, {"motors": "disarmed"}, ["disarmed"])


@motors.command("recover")
def recover(as_json: bool = AS_JSON) -> None:
    """Let a craft that calls itself crashed be ready again, once it stands upright.

    Example: [bold]groundstation motors recover[/bold]
    """
    ask(socket_path(), "POST", "/command/recover")
    answer(as_json, {"motors": "recovered"}, ["recovered"])


def _end(how: str, done: tuple[str, ...], as_json: bool) -> None:
    """Ask for the end of whatever flies. Raises GroundStationError unless it is one of ``done``."""
    said = ask(socket_path(), "POST", f"/command/{how}")
    motors, ended = said["motors"], said["ended"]
    more = "".join(f"; {kind} was ended" for kind in ended) + "; nobody is in control now"
    if motors not in done:
        raise GroundStationError(motors + more)
    answer(as_json, {"motors": motors, "ended": ended}, [motors + more])


def page(as_json: bool = AS_JSON) -> None:
    """A new address of the operator's page: it lets one browser in.

    Example: [bold]groundstation page[/bold]
    """
    found = ask(socket_path(), "POST", "/page/address")
    answer(as_json, found, [found["url"]])
