"""The daemon: a link, a decoder, a recorder, a viewer, and what an operator can ask of them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import structlog

from groundstation.clock import steady_clock
from groundstation.errors import BadInputError, TakenError
from groundstation.links.base import Link, LinkEvent, LinkState
from groundstation.links.factory import (
    CRAFT,
    is_stand_in,
    make_command_link,
    make_link,
    serve_commands,
)
from groundstation.service.batteries import Batteries
from groundstation.service.commander import Commander, Motors
from groundstation.service.config import (
    DEFAULT_VEHICLE,
    MEBIBYTE,
    Config,
    ConfigSource,
    changed_keys,
    link_speed,
    require_sense,
    socket_path,
    with_reloaded,
)
from groundstation.service.devices import DeviceList
from groundstation.service.health import Health
from groundstation.service.jobs import Jobs
from groundstation.service.models import Models
from groundstation.service.page import PageService
from groundstation.service.receiver import Receiver
from groundstation.service.recording_manager import RecordingManager
from groundstation.service.requests import Telemetry
from groundstation.service.sessions import Sessions
from groundstation.service.stream import Stream
from groundstation.service.supervisor import Supervisor
from groundstation.service.thumbnails import Thumbnails
from groundstation.service.twin import BEGAN, SOURCE, TwinService
from groundstation.telemetry.decoder import Decoder
from groundstation.telemetry.samples import RawBatch, SampleBatch
from groundstation.telemetry.statistics import LinkStatistics
from groundstation.text import printable
from groundstation.viewer.viewer import Viewer, ViewerMode

if TYPE_CHECKING:
    from groundstation.links.command import CommandLink
    from groundstation.twin.twin import Shown

EVENTS_KEPT = 1000
STATISTICS_S = 1.0
QUEUE_MOST = 0.5
"""A source that can wait does so while the recorder's queue is fuller than this."""


class Station:
    """One link's telemetry, decoded, recorded and shown.

    ``run`` returns when ``stop`` was called or, without a viewer, when a finite link has ended.
    Statistics are stamped on the time base of the link's packets: that of the recording.

    source: where the configuration came from, for a reload; None where there is none.

    Raises BadInputError for settings that cannot work.
    """

    def __init__(self, config: Config, source: ConfigSource | None = None) -> None:
        require_sense(config)
        self.config = config
        self.clock = steady_clock()
        self.events: deque[LinkEvent] = deque(maxlen=EVENTS_KEPT)
        self.statistics: LinkStatistics | None = None
        self.damaged = False
        """Whether the source had parts that could not be read."""
        self.faults = 0
        """Faults of the program itself, each survived and told as an event."""
        self.turned_away = 0
        """Requests and connections beyond the control API's limits."""
        self._source = source
        self._craft_port = config.command  # at which a stand-in takes commands
        link = self._make_link(config.link.name)
        command = link.commands
        if config.command and (command is None or config.command != command.uri):
            command = make_command_link(config.command, clock=self.clock)
        self._command_uri = "" if command is None else command.uri
        self.commander = Commander(
            command,
            config.dead_man,
            note=lambda kind, text: self.note(kind, text, source=self._command_uri or "command"),
            telemetry=lambda: (self.link_state(), self._no_craft()),
            motors=self._motors,
        )
        self.stream = Stream()
        self._recorded = {
            "vehicle": {"profile": config.vehicle or DEFAULT_VEHICLE},
            "configuration": _recorded_configuration(config),
        }
        self.sessions = Sessions(
            Path(config.recording.folder),
            self._recorded,
            low_space_bytes=round(config.recording.low_space_mb * MEBIBYTE),
            ros2_hz=config.recording.ros2_hz,
            on_fault=self._recorder_fault,
            clock=self.clock,
        )
        self.recordings = RecordingManager(
            self.sessions,
            config.recording,
            link=lambda: self.link.name,
            settle=self._settle,
            note=lambda kind, text: self.note(kind, text, source="recorder"),
        )
        self.viewer = Viewer(
            ViewerMode(config.viewer.mode),
            port=config.viewer.port,
            web_port=config.viewer.web_port,
            twin=bool(config.twin.model),
            on_event=lambda kind, text: self.note(kind, text, source="viewer"),
        )
        self.page = PageService(config.page, socket_path(config.control.socket))
        self.jobs = Jobs(
            lambda: self.sessions.folder, lambda kind, text: self.note(kind, text, source="jobs")
        )
        self.batteries = Batteries(
            Path(config.recording.folder),
            # a simulated cell is another one than the real craft's
            lambda: f"{self.link.name.partition(':')[0]} {self._recorded['vehicle']['profile']}",
            lambda kind, text: self.note(kind, text, source="battery"),
        )
        self.devices = DeviceList(self._flies_by_dongle)
        self.thumbnails = Thumbnails(lambda: self.sessions.folder)
        self.models = Models(self.jobs.entries)
        self.twin = TwinService(
            config.twin.model,
            tell=self.take_event,
            note=lambda kind, text: self.note(kind, text, source=SOURCE),
            show=self._show_twin,
        )
        if command is not None:
            self._listen(command)
        self.receiver = Receiver(
            link,
            self,
            on_raw=self._take_raw,
            on_samples=self._take_samples,
            on_switch=self._split,
            fast=config.link.speed == "max",
            busy=lambda: max(self.sessions.fullness, self.twin.fullness) > QUEUE_MOST,
        )
        self.supervisor = Supervisor(lambda text, name: self.fault(text, source=name))
        self.health = Health()
        self._log = structlog.get_logger("groundstation")
        self._started_s = time.monotonic()
        self._newest: SampleBatch | None = None
        self._switching = False
        self._recording_ended = False  # with a replay, not by an operator
        self._stopping = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def link(self) -> Link:
        """The telemetry link of the moment."""
        return self.receiver.link

    @link.setter
    def link(self, link: Link) -> None:
        self.receiver.link = link

    @property
    def tried(self) -> asyncio.Event:
        """Set when the link has been opened, or has turned out not to be there yet."""
        return self.receiver.tried

    @property
    def _decoder(self) -> Decoder:
        return self.receiver.decoder

    def stop(self) -> None:
        """Ask ``run`` to finish."""
        self._stopping.set()

    async def run(self, announce: Callable[[], None] = lambda: None) -> None:
        """Receive until stopped. Raises BadInputError when the link can never be opened.

        announce: called once the viewer's ports are known to be free.
        """
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(self._unexpected)
        # in reverse order, each whatever became of the others
        async with contextlib.AsyncExitStack() as closing:
            closing.push_async_callback(self.viewer.stop)
            await self.viewer.start()
            closing.push_async_callback(self.page.close)
            self.page.open()
            announce()
            closing.push_async_callback(self.recordings.close)
            closing.push_async_callback(self.twin.close)
            closing.callback(self._close_window)
            closing.push_async_callback(self.receiver.close)
            closing.push_async_callback(self.commander.close)
            closing.push_async_callback(self.supervisor.close)
            closing.push_async_callback(self.jobs.close)
            for name, work in (
                ("command", self.commander.keep_connected),
                ("dead man", self.commander.watch),
                ("statistics", self._close_windows),
                ("recordings", self.recordings.keep),
                ("health", self.health.watch),
                ("twin", self.twin.run),
                ("page", self.page.keep),
                ("jobs", self.jobs.run),
            ):
                self.supervisor.start(name, work)
            receiving = asyncio.create_task(
                self.receiver.run(opened=self._link_opened, ended=self._linger), name="receiver"
            )
            stopping = asyncio.create_task(self._stopping.wait(), name="stop")
            await asyncio.wait({receiving, stopping}, return_when=asyncio.FIRST_COMPLETED)
            for task in (receiving, stopping):
                task.cancel()
            await asyncio.gather(receiving, stopping, return_exceptions=True)
            if not self._stopping.is_set():
                self.receiver.drain()
                await self._finish_twin()
            if not receiving.cancelled():
                receiving.result()

    # -- what an operator can ask ----------------------------------------------------------

    async def start_recording(self) -> Path:
        """Begin a new file. Raises BadInputError when one is being written."""
        return await self.recordings.start()

    async def stop_recording(self) -> dict[str, Any]:
        """Finish the file; its final status. Raises BadInputError when there is none."""
        return await self.recordings.stop()

    def mark(self, text: str, details: dict[str, Any]) -> None:
        """A note of an operator or a client, in the recording and among the events."""
        self.recordings.require_recording()
        self.take_event(LinkEvent(self.clock(), "operator", "mark", text, details))

    async def switch_link(self, name: str, model: str = "") -> None:
        """Receive from another link, the recording going on. Where it cannot be opened the
        present one stays: LinkError or BadInputError; TakenError while a client commands.

        model: file of the model that ``stand-in:MODEL`` names."""
        if self.commander.client is not None:
            raise TakenError(f"{self.commander.client} is commanding; it must release first")
        if self._switching:
            raise TakenError("the link is being switched already")
        self._switching = True
        try:
            link, before = self._make_link(name, model), self.link
            async with _port_of(before, link):
                await self.receiver.switch(link)
            if is_stand_in(before.name):  # the craft that took commands is gone
                await self.commander.disconnect()
            if self._recording_ended:
                self._recording_ended = False
                await self.start_recording()
        finally:
            self._switching = False
        self._tell_no_craft()
        self._tell_vehicle()

    async def connect_command(self, uri: str) -> None:
        """Command the craft at ``uri`` from now on; it is connected as soon as it answers. A
        stand-in that is flown answers there. Raises BadInputError, TakenError."""
        if not uri.startswith(CRAFT):
            raise BadInputError(f"command link {uri!r}: give {' or '.join(CRAFT)}...")
        if self.commander.client is not None:
            raise TakenError(f"{self.commander.client} is commanding; it must release first")
        own = self.link.commands
        if own is None or own.uri != uri:
            own = make_command_link(uri, clock=self.clock)
        await serve_commands(self.link, uri)
        await self.commander.replace(own)
        self._listen(own)
        self._command_uri = self._craft_port = uri
        self._tell_no_craft()

    def _listen(self, command: CommandLink) -> None:
        command.on_event = self.take_event
        command.on_entry = self.sessions.command

    def reload(self) -> dict[str, list[str]]:
        """Take over what can be from the configuration: the keys that were, and those that need
        a new start. Raises BadInputError, changing nothing, for a configuration that is wrong."""
        if self._source is None:
            raise BadInputError("this daemon was started without a configuration to reload")
        fresh = self._source.load()
        config = with_reloaded(self.config, fresh)
        applied = changed_keys(self.config, config)
        if "twin.model" in applied:
            self.twin.configure(config.twin.model)
        self.config = config
        self.recordings.configure(config.recording)
        self.commander.limits = config.dead_man
        if applied:
            self.note("reload", f"new values of {', '.join(applied)}", source="configuration")
        return {"applied": applied, "restart_needed": changed_keys(config, fresh)}

    def status(self) -> dict[str, Any]:
        """The keys of the design's ``status --json``, and more."""
        statistics = self.statistics
        return {
            "link": {
                "name": self.link.name,
                "state": self.link_state().value,
                "rate_hz": statistics.rate_hz if statistics else 0.0,
                "lost": statistics.lost if statistics else 0,
                "latency_ms": statistics.latency_ms if statistics else None,
                "doing": self.link.doing,
                "pauses": self.link.pauses,
            },
            "vehicle": self._recorded["vehicle"]["profile"],
            "recording": self.recordings.status(),
            "battery": self.batteries.status(),
            "viewer": self.viewer.status(),
            "page": self.page.status(),
            "command": self.commander.status(),
            "twin": self.twin.status(),
            "stream": {"clients": len(self.stream), "dropped": self.stream.dropped},
            "tasks": self.supervisor.status(),
            "health": self.health.status(self.problems()),
            "faults": self.faults,
            "turned_away": self.turned_away,
            "uptime_s": time.monotonic() - self._started_s,
            "statistics": statistics.as_dict() if statistics else None,
        }

    def problems(self) -> list[str]:
        """What keeps the daemon from doing what it is there for."""
        problems = []
        state = self.link_state()
        if state not in (LinkState.STREAMING, LinkState.ENDED) and not self.link.pauses:
            problems.append(f"link {self.link.name}: {state.value}")
        recording = self.recordings.status()
        if recording["wanted"] and recording["state"] != "recording":
            problems.append(f"recording: {recording['state']}; {recording.get('text', '')}")
        if recording["state"] == "recording" and recording["dropped"]:
            problems.append(f"recording: {recording['dropped']} dropped; the disk is too slow")
        viewer = self.viewer.status()["state"]
        if viewer in ("restarting", "failed"):
            problems.append(f"viewer: {viewer}")
        if self.page.status()["state"] == "restarting":
            problems.append("page: restarting")
        command = self.commander.link
        if command is not None and command.state.value not in ("connected", "connecting"):
            problems.append(f"command link {command.uri}: {command.state.value}")
        problems += [f"task {name} is dead" for name in self.supervisor.dead()]
        return problems

    def link_state(self) -> LinkState:
        """Of the telemetry link: lost until a lost device is back."""
        return self.receiver.state

    def newest(self) -> Telemetry | None:
        """The newest sample, None before the first."""
        return None if self._newest is None else _telemetry(self._newest, self.receiver.now_ns())

    def _motors(self) -> Motors | None:
        """What the craft says of its motors; None where it does not, or is not the one that is
        commanded."""
        newest = self._newest
        if newest is None or self._no_craft() or np.isnan(newest.duty[-1]).any():
            return None
        age_s = (self.receiver.now_ns() - int(newest.host_time_ns[-1])) * 1e-9
        return Motors(age_s, float(newest.duty[-1].max()))

    # -- events ----------------------------------------------------------------------------

    def note(self, kind: str, text: str, *, source: str) -> None:
        """An event of the daemon itself."""
        self.take_event(LinkEvent(self.clock(), source, kind, text))

    def fault(self, text: str, *, source: str) -> None:
        """A fault of the program that it survives: counted and told."""
        self.faults += 1
        self.note("fault", text, source=source)

    def take_event(self, event: LinkEvent) -> None:
        """Keep, log, record and show an event."""
        event = replace(event, link=printable(event.link), text=printable(event.text))
        if self.receiver.is_repetition(event.link, event.kind):
            return  # while a device is waited for, another attempt is no news
        self.events.append(event)
        self.damaged |= event.kind == "damage"
        level = self._log.warning if event.kind in _WARNINGS else self._log.info
        level(event.text, source=event.link, kind=event.kind)
        self.sessions.event(event)
        self.viewer.show_event(event)
        self.stream.event(event)

    def _unexpected(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """What nobody else caught: a callback, or a task that nobody waits for."""
        error = context.get("exception")
        self.fault(f"{context['message']}: {error!r}", source="daemon")

    def _recorder_fault(self, text: str) -> None:
        # called from the recorder's thread
        def tell() -> None:
            self.note("fault", text, source="recorder")
            self.recordings.wake()

        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(tell)

    # -- the stream ------------------------------------------------------------------------

    def _make_link(self, name: str, model: str = "") -> Link:
        config = self.config
        link = make_link(
            name,
            speed=link_speed(config.link.speed),
            stand_in=config.stand_in,
            model=model,
            command=self._craft_port,
            usb=msgspec.to_builtins(config.usb),
            rate_hz=config.radio.rate_hz,
            wanted=[name.strip() for name in config.radio.log.split(",") if name.strip()],
            clock=self.clock,
        )
        link.on_event = self.take_event
        return link

    async def _link_opened(self) -> None:
        self._tell_no_craft()
        self._tell_vehicle()
        if self.config.recording.enabled:
            await self.start_recording()

    async def _linger(self) -> None:
        """The end of a replay: what there is to see stays on view until the operator stops."""
        if self.viewer.mode is ViewerMode.OFF:
            return
        self.receiver.drain()
        await self._finish_twin()
        self._close_window()
        self._recording_ended = self.sessions.status()["state"] == "recording"
        await self.recordings.close()
        self.note(
            "ended", "all has been shown; the viewer stays open until Ctrl-C", source="viewer"
        )
        await self._stopping.wait()

    def _settle(self) -> None:
        self.receiver.settle()

    def _take_raw(self, batch: RawBatch) -> None:
        self.sessions.raw(batch)

    async def _finish_twin(self) -> None:
        """All of a finite link has come: what the twin says of it, unless nobody waits for it."""
        told = asyncio.create_task(self.twin.drain(), name="twin drain")
        stopping = asyncio.create_task(self._stopping.wait(), name="stop")
        await asyncio.wait({told, stopping}, return_when=asyncio.FIRST_COMPLETED)
        stopping.cancel()

    def _split(self) -> None:
        self.sessions.split()
        self.batteries.split()
        self.twin.split()

    def _show_twin(self, shown: Shown) -> None:
        self.viewer.show_twin(shown)
        self.stream.twin(shown)

    def _take_samples(self, samples: SampleBatch) -> None:
        self._newest = samples
        self.batteries.samples(samples)
        self.twin.samples(samples)
        self.sessions.samples(samples)
        self.viewer.show_samples(samples)
        self.stream.samples(samples)

    async def _close_windows(self) -> None:
        """Once a second, also while nothing comes."""
        while True:
            await asyncio.sleep(STATISTICS_S)
            self._close_window()

    def _close_window(self) -> None:
        statistics = self.receiver.close_window(self.statistics)
        self.statistics = statistics
        entry = statistics.as_dict()
        self.sessions.statistics(entry)
        self.stream.statistics(entry)
        self.viewer.show_statistics(statistics.gauges(), statistics.time_ns)

    def _tell_no_craft(self) -> None:
        """Of a command link that is not used with this telemetry, before somebody wonders."""
        if self._command_uri and (reason := self._no_craft()):
            self.note("waiting", f"not connected: {reason}", source=self._command_uri)

    def _tell_vehicle(self) -> None:
        """What the craft says it is goes into the recordings, unless the configuration says."""
        said, configured = self.link.vehicle, self.config.vehicle
        self._recorded["vehicle"]["profile"] = configured or said or DEFAULT_VEHICLE
        if said and configured and said != configured:
            self.note(
                "vehicle",
                f"the craft says it is a {said}; recordings say {configured}, as configured",
                source=self.link.name,
            )

    def _flies_by_dongle(self) -> bool:
        """Whether a dongle or cable is in use, so that nobody else may look for craft with it."""
        command = self.commander.link
        uris = self.link.name, "" if command is None else command.uri
        return any(uri.startswith(("radio://", "usb://")) for uri in uris)

    def _no_craft(self) -> str:
        """Why nothing that could be commanded is behind the telemetry, or empty."""
        if self._switching:
            return "the link is being switched"
        if self.link.finite:
            return f"{self.link.name} is a recording"
        if is_stand_in(self.link.name) and not self._command_uri.startswith("udp://"):
            # who watches a simulated flight must not fly a real craft
            return f"the telemetry is the stand-in's, and {self._command_uri} is another craft"
        return ""


@contextlib.asynccontextmanager
async def _port_of(before: Link, link: Link) -> AsyncIterator[None]:
    """One stand-in after the other answers commands at the same port."""
    from groundstation.links.stand_in import StandInLink

    if not (isinstance(before, StandInLink) and isinstance(link, StandInLink)):
        yield
        return
    await before.serve_no_more()
    try:
        yield
    except BaseException:
        await before.serve()
        raise


_WARNINGS = frozenset(
    {
        "fault",
        "lost",
        "loss",
        "silent",
        "waiting",
        "restart",
        "damage",
        "dead man",
        "stop",
        "deleted",
        BEGAN,
    }
)


def _telemetry(samples: SampleBatch, now_ns: int) -> Telemetry:
    """The last row, in the units of the API; what a source does not have is None."""

    def numbers(values: Any) -> list[float | None]:
        return [None if np.isnan(value) else round(float(value), 4) for value in values]

    roll, pitch, yaw = numbers(np.degrees(samples.attitude[-1]))
    (battery,) = numbers(samples.battery_v[-1:])
    return Telemetry(
        age_s=round((now_ns - int(samples.host_time_ns[-1])) * 1e-9, 4),
        timestamp=int(samples.ticks[-1]),
        roll_deg=roll,
        pitch_deg=pitch,
        yaw_deg=yaw,
        gyro_dps=numbers(np.degrees(samples.gyro[-1])),
        battery_v=battery,
        motors=numbers(samples.duty[-1]),
    )


def _recorded_configuration(config: Config) -> dict[str, str]:
    """What a recording says of the configuration: never what a stand-in hides."""
    return {
        "link": config.link.name,
        "speed": str(config.link.speed),
        "command": config.command,
        "recording": json.dumps(msgspec.to_builtins(config.recording)),
    }
