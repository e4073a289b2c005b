"""The daemon: a link, a decoder, a recorder, a viewer, and what an operator can ask of them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from groundstation.links.base import Link
from groundstation.links.command import LinkEvent, steady_clock
from groundstation.service.changes import Changes, changes_path
from groundstation.service.commander import Commander
from groundstation.service.config import (
    MEBIBYTE,
    Config,
    require_sense,
    socket_path,
)
from groundstation.service.consumers import Consumer
from groundstation.service.craft_links import (
    CraftLinks,
    command_link,
    contradiction,
    telemetry_link,
)
from groundstation.service.devices import DeviceList
from groundstation.service.health import Health
from groundstation.service.jobs import Jobs
from groundstation.service.journal import Journal
from groundstation.service.models import Models
from groundstation.service.newest import Newest
from groundstation.service.page import PageService
from groundstation.service.receiver import Receiver
from groundstation.service.recording_manager import RecordingManager
from groundstation.service.sessions import Sessions
from groundstation.service.stream import Stream
from groundstation.service.supervisor import Supervisor
from groundstation.service.twin import SOURCE, TwinService
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch
from groundstation.viewer.viewer import Viewer, ViewerMode

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown

STATISTICS_S = 1.0
QUEUE_MOST = 0.5
"""A source that can wait does so while the recorder's queue is fuller than this."""


class Station:
    """One link's telemetry, decoded, recorded and shown.

    ``run`` returns when ``stop`` was called or, without a viewer, when a finite link has ended.
    Statistics are stamped on the time base of the link's packets: that of the recording.

    Raises BadInputError for settings that cannot work.
    """

    def __init__(self, config: Config) -> None:
        require_sense(config)
        self.config = config
        self.clock = clock = steady_clock()
        self.statistics: LinkStatistics | None = None
        self.turned_away = 0
        """Requests and connections beyond the control API's limits."""
        self.started_s = time.monotonic()
        self.journal = Journal(clock, self._is_repetition)
        name, port = config.link.name, config.command
        link = telemetry_link(config, name, self.journal, clock, on_table=self._note, port=port)
        self.commander = self._commanding(link)
        self.receiver = Receiver(
            link,
            self.journal,
            on_raw=self._take_raw,
            on_samples=self._take_samples,
            on_switch=self._split,
            fast=config.link.speed == "max",
            busy=lambda: max(self.sessions.fullness, self.twin.fullness) > QUEUE_MOST,
        )
        ends = self.receiver, self.commander
        self.craft = CraftLinks(config, self.journal, clock, *ends, on_entry=self._take_command)
        self.newest = Newest(self.receiver.now_ns)
        self.stream = Stream()
        self.sessions = self._recorded()
        self.recordings = RecordingManager(
            self.sessions,
            config.recording,
            link=lambda: self.receiver.link.name,
            settle=self.receiver.settle,
            note=self._noting("recorder"),
        )
        self.viewer = self._shown()
        socket = socket_path(config.control.socket)
        self.page = PageService(config.page, socket)
        self.jobs = Jobs(
            lambda: self.sessions.folder,
            self._noting("jobs"),
            socket,
            lambda: self.commander.operator.stops,
        )
        self.devices = DeviceList(self.craft.flies_by_dongle)
        self.models = Models(self.jobs.entries)
        self.twin = TwinService(
            config.twin.model,
            tell=self.journal.take,
            note=self._noting(SOURCE),
            show=self._note,
        )
        self.supervisor = Supervisor(lambda text, name: self.journal.fault(text, source=name))
        self.health = Health(self._noting("daemon"))
        self._consumers: tuple[Consumer, ...] = (self.twin, self.sessions, self.viewer, self.stream)
        self.journal.listeners.append(self._note)
        self._recording_ended = False  # with a replay, not by an operator
        self._stopping = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = 0  # that the loop runs in

    def _commanding(self, link: Link) -> Commander:
        return Commander(
            command_link(self.config, link, self.clock),
            self.config.failsafe,
            note=lambda kind, text: self._in_the_loop(
                lambda: self.journal.note(kind, text, source=self.craft.command_uri or "command")
            ),
            telemetry=lambda: (self.receiver.state, self.craft.no_craft()),
            changes=Changes(changes_path()),
            contradiction=partial(contradiction, self.config.vehicle),
            motors=lambda link: self.newest.motors() if self.craft.is_heard(link) else None,
        )

    def _recorded(self) -> Sessions:
        recording = self.config.recording
        return Sessions(
            Path(recording.folder),
            {
                "vehicle": self.craft.metadata,
                "configuration": _recorded_configuration(self.config),
            },
            low_space_bytes=round(recording.low_space_mb * MEBIBYTE),
            on_fault=self._recorder_fault,
            clock=self.clock,
        )

    def _shown(self) -> Viewer:
        config = self.config
        return Viewer(
            ViewerMode(config.viewer.mode),
            port=config.viewer.port,
            web_port=config.viewer.web_port,
            twin=bool(config.twin.model),
            tables=bool(config.radio.log),
            on_event=self._noting("viewer"),
        )

    def stop(self) -> None:
        """Ask ``run`` to finish."""
        self._stopping.set()

    async def run(self, announce: Callable[[], None] = lambda: None) -> None:
        """Receive until stopped. Raises BadInputError when the link can never be opened,
        TakenError where another program has its dongle.

        announce: called once the viewer's ports are known to be free.
        """
        self._loop, self._thread = asyncio.get_running_loop(), threading.get_ident()
        self._loop.set_exception_handler(self._unexpected)
        # in reverse order, each whatever became of the others
        async with contextlib.AsyncExitStack() as closing:
            closing.callback(self.craft.close)
            await self.craft.hold_dongles()
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
                ("failsafe", self.commander.watch),
                ("parameters", self.commander.keep_restored),
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
            await self.commander.close()  # while telemetry still says what the motors do
            for task in (receiving, stopping):
                task.cancel()
            await asyncio.gather(receiving, stopping, return_exceptions=True)
            if not self._stopping.is_set():
                self.receiver.drain()
                await self._finish_twin()
            if not receiving.cancelled():
                receiving.result()

    # -- what an operator can ask ----------------------------------------------------------

    def mark(self, text: str, details: dict[str, Any]) -> None:
        """A note of an operator or a client, in the recording and among the events."""
        self.recordings.require_recording()
        self.journal.take(LinkEvent(self.clock(), "operator", "mark", text, details))

    async def switch_link(self, name: str, model: str = "") -> None:
        """Receive from another link (``CraftLinks.switch``); a recording that ended with a replay
        is begun anew."""
        await self.craft.switch(name, model)
        if self._recording_ended:
            self._recording_ended = False
            await self.recordings.ensure()

    # -- what happens ----------------------------------------------------------------------

    def _noting(self, source: str) -> Callable[[str, str], None]:
        """Tells the journal (kind, text) of ``source``."""
        return lambda kind, text: self.journal.note(kind, text, source=source)

    def _is_repetition(self, source: str, kind: str) -> bool:
        """While a device is waited for, another attempt is no news."""
        return self.receiver.is_repetition(source, kind)

    def _unexpected(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """What nobody else caught: a callback, or a task that nobody waits for."""
        error = context.get("exception")
        self.journal.fault(f"{context['message']}: {error!r}", source="daemon")

    def _recorder_fault(self, text: str) -> None:
        # called from the recorder's thread
        def tell() -> None:
            self.journal.note("fault", text, source="recorder")
            self.recordings.wake()

        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(tell)

    # -- the stream ------------------------------------------------------------------------

    async def _link_opened(self) -> None:
        self.craft.tell()
        if self.config.recording.enabled:
            await self.recordings.ensure()  # an operator may have begun one before

    async def _linger(self) -> None:
        """The end of a replay: what there is to see stays on view until the operator stops."""
        if self.viewer.mode is ViewerMode.OFF:
            return
        self.receiver.drain()
        await self._finish_twin()
        self._close_window()
        self._recording_ended = self.sessions.status()["state"] == "recording"
        await self.recordings.close()
        self.journal.note(
            "ended", "all has been shown; the viewer stays open until Ctrl-C", source="viewer"
        )
        await self._stopping.wait()

    def _take_raw(self, batch: RawBatch) -> None:
        self.sessions.raw(batch)

    def _take_command(self, entry: dict[str, Any]) -> None:
        self._in_the_loop(lambda: self.sessions.command(entry))

    def _in_the_loop(self, tell: Callable[[], None]) -> None:
        """What the failsafe tells from its own thread."""
        if self._loop is None or self._thread == threading.get_ident():
            tell()
        elif not self._loop.is_closed():
            self._loop.call_soon_threadsafe(tell)

    async def _finish_twin(self) -> None:
        """All of a finite link has come: what the twin says of it, unless nobody waits for it."""
        told = asyncio.create_task(self.twin.drain(), name="twin drain")
        stopping = asyncio.create_task(self._stopping.wait(), name="stop")
        await asyncio.wait({told, stopping}, return_when=asyncio.FIRST_COMPLETED)
        stopping.cancel()

    def _split(self) -> None:
        for consumer in self._consumers:
            consumer.split()

    def _note(self, note: LinkEvent | LinkStatistics | LogTable | Shown) -> None:
        for consumer in self._consumers:
            consumer.note(note)

    def _take_samples(self, samples: SampleBatch) -> None:
        self.newest.samples(samples)
        for consumer in self._consumers:
            consumer.samples(samples)

    async def _close_windows(self) -> None:
        """Once a second, also while nothing comes."""
        while True:
            await asyncio.sleep(STATISTICS_S)
            self._close_window()

    def _close_window(self) -> None:
        statistics = self.receiver.close_window(self.statistics)
        self.statistics = statistics
        self._note(statistics)


def _recorded_configuration(config: Config) -> dict[str, str]:
    """What a recording says of the configuration: never what a stand-in hides."""
    return {
        "link": config.link.name,
        "speed": str(config.link.speed),
        "command": config.command,
        "recording": json.dumps(msgspec.to_builtins(config.recording)),
    }
