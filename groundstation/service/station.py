"""The daemon: a link, a decoder, a recorder, a viewer, and what an operator can ask of them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import structlog

from groundstation.background import in_background
from groundstation.clock import steady_clock
from groundstation.errors import (
    GroundStationError,
    LinkEndedError,
    LinkError,
    LinkLostError,
)
from groundstation.links.base import Link, LinkEvent, LinkState
from groundstation.links.factory import make_command_link, make_link
from groundstation.service.commander import Commander
from groundstation.service.config import MEBIBYTE, Config, link_speed, require_sense
from groundstation.service.requests import Telemetry
from groundstation.service.sessions import Sessions
from groundstation.service.stream import Stream
from groundstation.telemetry.decoder import Decoded, Decoder, compile_kernel
from groundstation.telemetry.samples import RawBatch, SampleBatch
from groundstation.telemetry.statistics import LinkMeter, LinkStatistics
from groundstation.text import printable
from groundstation.viewer.viewer import Viewer, ViewerMode

EVENTS_KEPT = 1000
STATISTICS_S = 1.0
ANNOUNCE_S = 2.0
"""Preparing takes longer than this where something has to be compiled."""
RETRY_FIRST_S, RETRY_MOST_S = 0.5, 5.0


class Station:
    """One link's telemetry, decoded, recorded and shown.

    ``run`` returns when ``stop`` was called or, without a viewer, when a finite link has ended.
    Statistics are stamped on the time base of the link's packets: that of the recording.

    Raises BadInputError for settings that cannot work.
    """

    def __init__(self, config: Config) -> None:
        require_sense(config)
        self.config = config
        self.clock = steady_clock()
        self.events: deque[LinkEvent] = deque(maxlen=EVENTS_KEPT)
        self.statistics: LinkStatistics | None = None
        self.damaged = False
        """Whether the source had parts that could not be read."""
        self.faults = 0
        """Faults of the program itself, each survived and told as an event."""
        self.link: Link = make_link(
            config.link.name,
            speed=link_speed(config.link.speed),
            stand_in=config.stand_in,
            command=config.command,
            usb=msgspec.to_builtins(config.usb),
            clock=self.clock,
        )
        self.link.on_event = self.take_event
        command = None
        if config.command:
            command = make_command_link(config.command, clock=self.clock)
            command.on_event = self.take_event
        self.commander = Commander(
            command,
            config.dead_man,
            note=lambda kind, text: self.note(kind, text, source=config.command or "command"),
            telemetry=lambda: (self.link_state(), self._no_craft()),
        )
        self.stream = Stream()
        self.sessions = Sessions(
            Path(config.recording.folder),
            {
                "vehicle": {"profile": config.vehicle},
                "configuration": _recorded_configuration(config),
            },
            low_space_bytes=round(config.recording.low_space_mb * MEBIBYTE),
            on_fault=self._recorder_fault,
        )
        self.viewer = Viewer(
            ViewerMode(config.viewer.mode),
            port=config.viewer.port,
            web_port=config.viewer.web_port,
            on_event=lambda kind, text: self.note(kind, text, source="viewer"),
        )
        if command is not None:
            command.on_entry = self.sessions.command
        self._log = structlog.get_logger("groundstation")
        self._started_s = time.monotonic()
        self._decoder = Decoder()
        self._meter = LinkMeter(self.clock())
        self._newest_ns = 0  # the latest host stamp
        self._newest: SampleBatch | None = None
        self._ready_made = 0  # samples of a source that needs no decoder
        self._retry_s = RETRY_FIRST_S
        self._away: LinkState | None = None  # of a device that is waited for: lost, or never there
        self._missing = ""  # why it cannot be opened now
        self._recording = asyncio.Lock()  # held while a recording is begun or finished
        self._stopping = asyncio.Event()
        self.tried = asyncio.Event()
        """Set when the link has been opened, or has turned out not to be there yet."""
        self._loop: asyncio.AbstractEventLoop | None = None

    def stop(self) -> None:
        """Ask ``run`` to finish."""
        self._stopping.set()

    async def run(self, announce: Callable[[], None] = lambda: None) -> None:
        """Receive until stopped. Raises BadInputError when the link can never be opened.

        announce: called once the viewer's ports are known to be free.
        """
        self._loop = asyncio.get_running_loop()
        # in reverse order, each whatever became of the others
        async with contextlib.AsyncExitStack() as closing:
            closing.push_async_callback(self.viewer.stop)
            await self.viewer.start()
            announce()
            closing.push_async_callback(self._finish_recording)
            closing.callback(self._close_window)
            closing.callback(self._drain)
            closing.push_async_callback(self.link.close)
            closing.push_async_callback(self.commander.close)
            receiving = asyncio.create_task(self._receive(), name="link")
            stopping = asyncio.create_task(self._stopping.wait(), name="stop")
            others = [
                asyncio.create_task(self._supervise("command", self.commander.keep_connected)),
                asyncio.create_task(self._supervise("dead man", self.commander.watch)),
                asyncio.create_task(self._supervise("statistics", self._close_windows)),
            ]
            await asyncio.wait({receiving, stopping}, return_when=asyncio.FIRST_COMPLETED)
            for task in (receiving, stopping, *others):
                task.cancel()
            await asyncio.gather(receiving, stopping, *others, return_exceptions=True)
            if not receiving.cancelled():
                receiving.result()

    # -- what an operator can ask ----------------------------------------------------------

    async def start_recording(self) -> Path:
        """Begin a new file. Raises BadInputError when one is being written."""
        async with self._recording:
            path = self.sessions.start(self.link.name)
            self.note("recording", f"recording to {path}", source="recorder")
            return path

    async def stop_recording(self) -> dict[str, Any]:
        """Finish the file; its final status. Raises BadInputError when there is none."""
        async with self._recording:
            self.sessions.require_started()
            # the samples of the packets in this file, not in the next one
            self._take(self._decoder.idle(self._now_ns()))
            self.note("recording", "recording stopped", source="recorder")
            await self._finish_detached()
            return self.sessions.status()

    async def _finish_recording(self) -> None:
        async with self._recording:
            await self._finish_detached()

    async def _finish_detached(self) -> None:
        recorder = self.sessions.detach()
        if recorder is not None:
            await asyncio.to_thread(self.sessions.finish, recorder)

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
            },
            "recording": self.sessions.status(),
            "viewer": self.viewer.status(),
            "command": self.commander.status(),
            "stream": {"clients": len(self.stream), "dropped": self.stream.dropped},
            "faults": self.faults,
            "uptime_s": time.monotonic() - self._started_s,
            "statistics": statistics.as_dict() if statistics else None,
        }

    def mark(self, text: str, details: dict[str, Any]) -> None:
        """A note of an operator or a client, in the recording and among the events."""
        self.take_event(LinkEvent(self.clock(), "operator", "mark", text, details))

    def link_state(self) -> LinkState:
        """Of the telemetry link: lost until a lost device is back."""
        return self._away or self.link.state

    def newest(self) -> Telemetry | None:
        """The newest sample, None before the first."""
        return None if self._newest is None else _telemetry(self._newest, self._now_ns())

    def _no_craft(self) -> str:
        """Why nothing that could be commanded is behind the telemetry, or empty."""
        return f"{self.link.name} is a recording" if self.link.finite else ""

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
        if self._missing and event.link == self.link.name and event.kind in _ATTEMPT:
            return  # while a device is waited for, another attempt is no news
        self.events.append(event)
        self.damaged |= event.kind == "damage"
        level = self._log.warning if event.kind in _WARNINGS else self._log.info
        level(event.text, source=event.link, kind=event.kind)
        self.sessions.event(event)
        self.viewer.show_event(event)
        self.stream.event(event)

    def _recorder_fault(self, text: str) -> None:
        # called from the recorder's thread
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(lambda: self.note("fault", text, source="recorder"))

    async def _supervise(self, name: str, work: Callable[[], Awaitable[None]]) -> None:
        """Begin anew what fails by a fault of the program."""
        while True:
            try:
                return await work()
            except Exception as error:
                self.fault(f"{name}: {error!r}", source=name)
                await asyncio.sleep(RETRY_MOST_S)

    # -- the stream ------------------------------------------------------------------------

    async def _receive(self) -> None:
        """Open, read, and open again: after a loss, a fault, or when it is not there yet."""
        compiled = await self._prepare()
        opened = False
        while True:
            try:
                try:
                    await self.link.open()
                finally:
                    self.tried.set()
                if not opened:
                    opened = True
                    self._decoder = Decoder(self.link.start_ticks, compiled=compiled)
                    self._meter = LinkMeter(self._now_ns())
                    if self.config.recording.enabled:
                        # not before: a mistyped link leaves no empty file behind
                        await self.start_recording()
                self._retry_s, self._missing = RETRY_FIRST_S, ""
                await self._read()
            except LinkEndedError:
                await self._linger()
                return
            except LinkLostError:
                self._lose()
            except LinkError as error:
                if self.link.state is not LinkState.CLOSED:
                    self._lose()  # it was open: reading failed
                self._away = self._away or LinkState.OPENING
                if str(error) != self._missing:
                    self._missing = str(error)
                    self.note("waiting", self._missing, source=self.link.name)
            except GroundStationError:
                raise
            except Exception as error:
                if self.link.finite:
                    raise  # opened again it would begin anew
                self.fault(f"receiving failed: {error!r}", source=self.link.name)
                self._lose()
            try:
                await self.link.close()
            except Exception as error:
                self.fault(f"closing failed: {error!r}", source=self.link.name)
            await asyncio.sleep(self._retry_s)
            self._retry_s = min(2 * self._retry_s, RETRY_MOST_S)

    async def _prepare(self) -> bool:
        """Whether to decode compiled: only what comes faster than any craft sends needs it."""
        if self.config.link.speed != "max":
            return False
        announcement = asyncio.get_running_loop().call_later(
            ANNOUNCE_S,
            partial(self.note, "preparing", "preparing the decoder: compiled once per machine",
                    source="decoder"),
        )  # fmt: skip
        try:
            await in_background(compile_kernel)
        finally:
            announcement.cancel()
        return True

    def _lose(self) -> None:
        """What follows is a new segment, after whatever went wrong."""
        self._away = LinkState.LOST
        try:
            self._take(self._decoder.reconnected())
        except Exception as error:
            self.fault(f"the decoder starts anew: {error!r}", source="decoder")
            self._decoder = Decoder()

    async def _linger(self) -> None:
        """The end of a replay: what there is to see stays on view until the operator stops."""
        if self.viewer.mode is ViewerMode.OFF:
            return
        self._drain()
        self._close_window()
        await self._finish_recording()
        self.note(
            "ended", "all has been shown; the viewer stays open until Ctrl-C", source="viewer"
        )
        await self._stopping.wait()

    async def _read(self) -> None:
        while True:
            batch = await self.link.read()
            self._away = None
            if batch is None:
                self._take(self._decoder.idle(self.link.now_ns()))
                continue
            if len(batch):
                self._newest_ns = max(self._newest_ns, int(batch.host_time_ns[-1]))
            if not isinstance(batch, RawBatch):
                self._give(batch)
                self._meter.add_samples(batch)
                self._ready_made += len(batch)
            else:
                self.sessions.raw(batch)
                self._take(self._decoder.decode(batch))

    def _drain(self) -> None:
        """Nothing more will come: give out what is held."""
        self._take(self._decoder.finish())

    def _take(self, decoded: Decoded) -> None:
        self._meter.add(decoded)
        self._give(decoded.samples)

    def _give(self, samples: SampleBatch) -> None:
        if len(samples) == 0:
            return
        self._newest = samples
        self.sessions.samples(samples)
        self.viewer.show_samples(samples)
        self.stream.samples(samples)

    async def _close_windows(self) -> None:
        """Once a second, also while nothing comes."""
        while True:
            await asyncio.sleep(STATISTICS_S)
            self._close_window()

    def _now_ns(self) -> int:
        """The present on the time base of the packets: a fast replay's stamps run ahead of any
        clock."""
        return max(self.link.now_ns(), self._newest_ns)

    def _close_window(self) -> None:
        counts = self._decoder.counts()
        counts = replace(counts, samples=counts.samples + self._ready_made)
        statistics = self._meter.close_window(self._now_ns(), counts)
        if statistics.restarts > (self.statistics.restarts if self.statistics else 0):
            self.note("restart", "the device restarted: a new segment", source=self.link.name)
        self.statistics = statistics
        entry = statistics.as_dict()
        self.sessions.statistics(entry)
        self.stream.statistics(entry)
        self.viewer.show_statistics(statistics.gauges(), statistics.time_ns)


_ATTEMPT = frozenset({LinkState.OPENING, LinkState.CLOSED})
_WARNINGS = frozenset(
    {"fault", "lost", "loss", "silent", "waiting", "restart", "damage", "dead man"}
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
