"""``groundstation run``: the daemon in the foreground."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import typer

from groundstation import BadInputError, GroundStationError
from groundstation.cli.model_files import assignments
from groundstation.cli.terminal import own_terminal, say
from groundstation.links.factory import KINDS, split_name
from groundstation.viewer.child import ViewerMode

if TYPE_CHECKING:
    from groundstation.links.command import LinkEvent
    from groundstation.service.config import Config
    from groundstation.service.station import Station

# What Ctrl-C and its relatives do to the daemon.


PATIENCE_S = 1.0
"""What an orderly end is still given after the second signal."""
_NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextlib.contextmanager
def stopped_by_signals(stop: Callable[[], None], last_resort: Callable[[], None]) -> Iterator[None]:
    """While inside, SIGINT, SIGTERM or SIGHUP calls ``stop`` on the running loop.

    A second signal ends the process with status 128 + its number, unless it ends by itself
    within a second: after ``last_resort``, called from another thread, whatever the loop does.
    """
    loop = asyncio.get_running_loop()
    ended = threading.Event()
    received: list[int] = []

    def give_up() -> None:
        if not ended.wait(PATIENCE_S):
            try:
                last_resort()
            finally:
                os._exit(128 + received[1])

    def handle(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) == 1:
            loop.call_soon_threadsafe(stop)
        elif len(received) == 2:
            threading.Thread(target=give_up, name="give-up", daemon=True).start()

    # nohup: a signal that is ignored stays so
    numbers = [n for n in _NUMBERS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    # not the loop's own handlers: those say nothing while the loop is blocked
    before = {number: signal.signal(number, handle) for number in numbers}
    # a signal that comes just before the loop waits would wait with it
    awake, wake = socket.socketpair()
    for end in (awake, wake):
        end.setblocking(False)
    former = signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)
    loop.add_reader(awake, awake.recv, 64)
    try:
        yield
    finally:
        ended.set()
        loop.remove_reader(awake)
        signal.set_wakeup_fd(former)
        awake.close()
        wake.close()
        for number, handler in before.items():
            signal.signal(number, handler)


DISPLAY_S = 0.5
LONGEST_S = 10 * 365 * 86400.0
"""Ten years: what is longer is a slip of the keyboard."""


def add_commands(app: typer.Typer) -> None:
    app.command("run")(run)


def run(
    config: Path | None = typer.Option(None, help="TOML configuration file."),
    link: str | None = typer.Option(None, help=f"{KINDS} (default: stand-in)."),
    command: str | None = typer.Option(
        None, help="Command link: udp://HOST:PORT (stand-in) or radio://... (craft)."
    ),
    rate_hz: int | None = typer.Option(
        None,
        "--rate",
        help="Rows a second of a stock craft: 50 to 1000 (default: what the link bears, to 250).",
    ),
    log: str | None = typer.Option(
        None, metavar="VARIABLE,...", help="Further log variables of a stock craft."
    ),
    duration_s: float | None = typer.Option(
        None, "--for", min=0.0, max=LONGEST_S, help="Stop after so many seconds."
    ),
    recordings: Path | None = typer.Option(None, help="Folder for recordings (default: sessions)."),
    record: bool | None = typer.Option(None, "--record/--no-record", help="Record at once."),
    viewer: ViewerMode | None = typer.Option(
        None, help="Live view: off, serve (browser) or spawn (window)."
    ),
    page: bool | None = typer.Option(
        None, "--page/--no-page", help="Serve the operator's page to browsers of this machine."
    ),
    twin: Path | None = typer.Option(
        None, metavar="MODEL", help="Fly this model beside the craft and tell where they disagree."
    ),
    speed: str | None = typer.Option(
        None, help="Of a stand-in or replay: 1 is real time, 'max' as fast as possible."
    ),
    assign: list[str] = typer.Option(
        [], "--set", metavar="KEY=VALUE", help="Any key of 'groundstation config'."
    ),
) -> None:
    """Receive telemetry, record it and show it live, until Ctrl-C.

    Example: [bold]groundstation run --link stand-in --viewer serve[/bold]
    """
    from groundstation.service.config import ConfigSource

    options = {
        "link.name": _link(link),
        "link.speed": _speed(speed),
        "recording.folder": None if recordings is None else str(recordings),
        "recording.enabled": record,
        "viewer.mode": viewer and viewer.value,
        "page.enabled": page,
        "twin.model": None if twin is None else str(twin),
        "command": command,
        "radio.rate_hz": rate_hz,
        "radio.log": log,
        **assignments(assign),
    }
    changes = {key: value for key, value in options.items() if value is not None}
    own_terminal()
    source = ConfigSource(config, changes)
    asyncio.run(_serve(source.load(), duration_s))


async def _serve(config: Config, duration_s: float | None) -> None:
    from groundstation import socket_path
    from groundstation.allocator import limit_arenas
    from groundstation.service.config import ControlSocket, notify, pat_watchdog
    from groundstation.service.control import ControlServer
    from groundstation.service.station import Station

    limit_arenas()
    live = sys.stdout.isatty()
    station = Station(config)
    station.journal.log = _log(live, as_json=config.log.format == "json")
    control = ControlSocket(socket_path(config.control.socket))
    server = ControlServer(station, control)
    tasks: list[asyncio.Task[None]] = []

    def ready() -> None:
        _introduce(station, control.path, live)
        notify("READY=1")

    def last_resort() -> None:
        station.sessions.wait()
        control.path.unlink(missing_ok=True)

    interrupted = False

    def stop() -> None:
        nonlocal interrupted
        interrupted = True
        station.stop()

    with stopped_by_signals(stop, last_resort):
        try:
            await server.start()
            tasks.append(asyncio.create_task(pat_watchdog(), name="watchdog"))
            if duration_s is not None:
                tasks.append(asyncio.create_task(_stop_after(station, duration_s), name="timer"))
            if live:
                tasks.append(asyncio.create_task(_display(station), name="display"))
            if config.page.enabled and live and _has_screen():
                tasks.append(asyncio.create_task(_open_page(station), name="browser"))
            await station.run(announce=ready)
        finally:
            notify("STOPPING=1")
            for task in tasks:
                task.cancel()
            if live:
                say("", end="", clear=True)
            await server.stop()
            control.close()
    _conclude(station)
    if not interrupted:
        _require_something(station)


def _has_screen() -> bool:
    """Whether a browser that is opened here would be seen by somebody."""
    shown = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return shown and not os.environ.get("CI")


async def _open_page(station: Station) -> None:
    """Open the page in the user's browser once it is served; the printed address stays good."""
    import webbrowser

    while station.page.status()["state"] != "serving":
        await asyncio.sleep(DISPLAY_S)
    # a browser may keep its caller waiting, and there may be none
    await asyncio.to_thread(webbrowser.open, station.page.address())


def _introduce(station: Station, socket: Path, live: bool) -> None:
    """Say what is served where. live: to a terminal, which is told the page's one-time address."""
    config = station.config
    lines = [("link", station.receiver.link.name)]
    folder = config.recording.folder if config.recording.enabled else "off"
    lines.append(("recordings", folder))
    lines += [("viewer", url) for url in station.viewer.status()["urls"]] or [("viewer", "off")]
    if config.page.enabled:
        # whoever reads a log, or a pipe's file, shall not get in
        lines.append(("page", station.page.address() if live else station.page.url))
    if config.twin.model:
        lines.append(("twin", config.twin.model))
    lines.append(("control", str(socket)))
    for name, text in lines:
        say(f"  {name:<11}{text}")
    if config.page.enabled and not live:
        say("  The page lets in who has an address of: groundstation page")
    say("  Ctrl-C stops and finishes the recording.")


def _conclude(station: Station) -> None:
    """Say what came of it; faults are an error."""
    totals, recording = station.receiver.totals(), station.sessions.status()
    if station.statistics is not None:
        say(
            f"received {totals['samples']} samples, {totals['lost']} lost, "
            f"{totals['packets']} packets; recording: {recording['file'] or 'none'}"
        )
    faults = station.sessions.faults
    if faults:
        last = recording["file"]
        whole = last and Path(last) not in faults and recording["state"] == "finished"
        raise GroundStationError(
            f"not complete: {'; '.join(faults.values())}" + (f" ({last} is complete)" * bool(whole))
        )
    if station.journal.damaged:
        raise GroundStationError(
            f"{station.receiver.link.name} is damaged; what could be read was delivered "
            "(see 'groundstation inspect')"
        )


def _require_something(station: Station) -> None:
    """A run that ended by itself and never did what it was asked to has failed."""
    events = station.journal.events
    troubles = {event.link: event.text for event in events if event.kind in _TROUBLES}
    if station.newest.telemetry() is None and troubles:
        # many texts begin with the link's name by themselves
        texts = "; ".join(f"{link}: {t.removeprefix(f'{link}: ')}" for link, t in troubles.items())
        raise GroundStationError(f"nothing was received: {texts}")
    command = station.config.command
    connected = any(event.link == command and event.kind == "connected" for event in events)
    if command in troubles and not connected:
        raise GroundStationError(f"{command} was never connected: {troubles[command]}")


_TROUBLES = ("waiting", "fault")


async def _stop_after(station: Station, duration_s: float) -> None:
    """Preparing the link does not count."""
    await station.receiver.tried.wait()
    await asyncio.sleep(duration_s)
    station.stop()


async def _display(station: Station) -> None:
    """One line that keeps the operator informed."""
    while True:
        await asyncio.sleep(DISPLAY_S)
        statistics, recording = station.statistics, station.sessions.status()
        if statistics is None:
            continue
        latency = "" if statistics.latency_ms is None else f"{statistics.latency_ms:6.1f} ms late"
        say(
            f"{station.receiver.link.state.value:<10}{statistics.rate_hz:7.1f} samples/s"
            f"{statistics.loss_pct:6.2f} % lost {latency}   "
            f"{recording['state']} {recording['bytes'] / 1e6:.1f} MB",
            end="",
            clear=True,
        )


def _log(live: bool, *, as_json: bool) -> Callable[[LinkEvent, bool], None]:
    """One event a line on stderr: time, source, kind, text; as text, or as a JSON object."""

    def as_text(event: LinkEvent, warns: bool) -> None:
        moment, mark = time.strftime("%H:%M:%S"), "!" if warns else " "
        line = f"{moment} {mark} {event.link:<10} {event.kind:<10} {event.text}"
        say(line, error=True, clear=live)

    def as_object(event: LinkEvent, warns: bool) -> None:
        line = {
            "source": event.link,
            "kind": event.kind,
            "event": event.text,
            "level": "warning" if warns else "info",
            "timestamp": f"{datetime.now(UTC).replace(tzinfo=None).isoformat()}Z",
        }
        say(json.dumps(line), error=True)

    return as_object if as_json else as_text


def _speed(text: str | None) -> float | str | None:
    if text is None or text == "max":
        return text
    with contextlib.suppress(ValueError):
        if float(text) > 0:
            return float(text)
    raise typer.BadParameter(f"{text!r}: give a number above 0, or max", param_hint="'--speed'")


def _link(name: str | None) -> str | None:
    try:
        split_name(name or "stand-in")
    except BadInputError as error:
        raise typer.BadParameter(str(error), param_hint="'--link'") from error
    return name
