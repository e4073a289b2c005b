"""The daemon: a link, a decoder, a recorder, a viewer, and what an operator can ask of them."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import itertools
import json
import os
import resource
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol, Self

import msgspec
import numpy as np

from groundstation.allocator import give_back
from groundstation.links.command import LinkEvent, steady_clock
from groundstation.service.commander import Commander
from groundstation.service.config import MEBIBYTE, Config, require_sense, socket_path
from groundstation.service.craft_links import (
    CraftLinks,
    Journal,
    Receiver,
    command_link,
    contradiction,
    telemetry_link,
)
from groundstation.service.jobs import DeviceList, Jobs, Models
from groundstation.service.lease import Motors
from groundstation.service.page import PageService
from groundstation.service.parameters import Changes, changes_path
from groundstation.service.recording_manager import RecordingManager, Sessions
from groundstation.service.requests import Telemetry
from groundstation.service.stream import Stream
from groundstation.service.twin import SOURCE, TwinService
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch
from groundstation.viewer.viewer import Viewer, ViewerMode

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown

# Why the event loop stood still: what a thread beside it saw, and what the kernel counted.
#
# The kernel tells of every thread for how long it ran and for how long it was ready and waited
# for a processor (``/proc/self/task/*/schedstat``), and of the machine for how long its host did
# not let it run (steal). What is left of a delay the loop's thread spent waiting for something
# else: where, its stack says.


POLL_S = 0.1
READ_S = 0.5
"""Between two readings of the kernel's figures, a file for each thread: as long as a delay is, from
which on it is told."""
KEPT = 8
"""Readings of the kernel's figures: those from before a delay are among them."""
MOST = 0.5
"""Share of a delay that makes a cause the cause."""
_PACKAGE = Path(__file__).parents[1]
_TICKS_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Figures:
    """Totals, s. ran, waited: thread -> on a processor, and ready without one. collected: by the
    garbage collector. stolen: from all processors of the machine by its host."""

    time_s: float = field(default_factory=time.monotonic)
    ran: dict[int, float] = field(default_factory=dict)
    waited: dict[int, float] = field(default_factory=dict)
    collected: float = 0.0
    stolen: float = 0.0

    @classmethod
    def now(cls, collected: float) -> Self:
        ran, waited = {}, {}
        for name in os.listdir("/proc/self/task"):
            with contextlib.suppress(OSError, ValueError):  # it has just ended
                text = Path(f"/proc/self/task/{name}/schedstat").read_text()
                ran[int(name)], waited[int(name)] = (int(one) / 1e9 for one in text.split()[:2])
        stolen = 0.0
        with contextlib.suppress(OSError, ValueError, IndexError), open("/proc/stat") as file:
            stolen = int(file.readline().split()[8]) / _TICKS_S / (os.cpu_count() or 1)
        return cls(time.monotonic(), ran, waited, collected, stolen)


class Witness:
    """Watches one thread's loop from another, and says after a delay what caused it.

    Made, and ``why`` called, in the thread that is watched. A context manager.
    """

    def __init__(self) -> None:
        self._watched, self._native = threading.get_ident(), threading.get_native_id()
        self._beat_s = time.monotonic()
        self._figures: deque[Figures] = deque(maxlen=KEPT)
        self._seen: Counter[str] = Counter()
        self._late_s = 0.0  # of the witness itself
        self._asleep_s = time.monotonic()
        self._faults = _page_faults()
        self._collected, self._began_s = 0.0, 0.0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="witness", daemon=True)

    def __enter__(self) -> Self:
        self._figures.append(Figures.now(self._collected))
        gc.callbacks.append(self._collect)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stopped.set()
        self._thread.join()
        gc.callbacks.remove(self._collect)

    def beat(self) -> None:
        """The loop turns."""
        self._beat_s = time.monotonic()
        self._faults = _page_faults()
        self._seen.clear()
        self._late_s = 0.0

    def why(self, late_s: float) -> str:
        """What held the loop up for so long until now."""
        after = Figures.now(self._collected)
        begun_s = after.time_s - late_s
        earlier = [one for one in self._figures.copy() if one.time_s <= begun_s]
        before = earlier[-1] if earlier else self._figures[0]
        # it may still be about to wake
        witness_s = self._late_s + max(after.time_s - self._asleep_s - POLL_S, 0.0)
        names = {one.native_id: one.name for one in threading.enumerate() if one.native_id}
        text = explained(late_s, before, after, self._native, dict(self._seen), witness_s, names)
        read = _page_faults() - self._faults
        return f"{text}; {read} pages of memory were read from the disk" if read else text

    def _watch(self) -> None:
        while True:
            self._asleep_s = time.monotonic()
            if self._stopped.wait(POLL_S):
                return
            now_s = time.monotonic()
            if now_s - self._beat_s < 3 * POLL_S:
                if now_s - self._figures[-1].time_s >= READ_S:
                    self._figures.append(Figures.now(self._collected))
                continue
            self._late_s += max(now_s - self._asleep_s - POLL_S, 0.0)
            frame = sys._current_frames().get(self._watched)
            if frame is not None:
                self._seen[place_of(frame)] += 1

    def _collect(self, phase: str, info: dict[str, int]) -> None:
        if threading.get_ident() != self._watched:
            return
        now_s = time.monotonic()
        if phase == "start":
            self._began_s = now_s
        else:
            self._collected += now_s - self._began_s


def explained(
    late_s: float,
    before: Figures,
    after: Figures,
    thread: int,
    seen: dict[str, int],
    witness_s: float,
    names: dict[int, str],
) -> str:
    """The largest cause of a delay of ``late_s``, in words.

    thread: the loop's. seen: places in which it was found, how often. witness_s: for how long the
    witness itself did not run though it wanted to. names: of threads.
    """

    def spent(one: int) -> float:
        ran = after.ran.get(one, 0.0) - before.ran.get(one, 0.0)
        return ran + after.waited.get(one, 0.0) - before.waited.get(one, 0.0)

    where = f" in {max(seen, key=lambda place: seen[place])}" if seen else ""
    collected = after.collected - before.collected
    stolen = after.stolen - before.stolen
    waited = after.waited.get(thread, 0.0) - before.waited.get(thread, 0.0)
    ran = after.ran.get(thread, 0.0) - before.ran.get(thread, 0.0)
    others = {one: spent(one) for one in after.ran if one != thread}
    busiest = max(others, key=lambda one: others[one], default=0)
    causes = {
        f"the machine's host gave it no processor for {stolen:.1f} s": stolen,
        f"garbage was collected for {collected:.1f} s": collected,
        f"ready to run and without a processor for {waited:.1f} s: the machine is overloaded": (
            waited
        ),
        f"it computed for {ran:.1f} s{where}": ran,
    }
    for text, share_s in causes.items():
        if share_s >= MOST * late_s:
            return text
    if witness_s >= MOST * late_s:  # no thread could run Python
        if others.get(busiest, 0.0) >= MOST * late_s:
            name = names.get(busiest, "without a name")
            return f"the thread '{name}' did not let go of the interpreter"
        return "nothing of the process ran: it was stopped, or the machine"
    return f"it waited{where}"


def place_of(frame: FrameType) -> str:
    """The innermost function of ours and, where that called another, the innermost of all."""
    inner, ours = frame, frame
    while not ours.f_code.co_filename.startswith(str(_PACKAGE)) and ours.f_back is not None:
        ours = ours.f_back
    if not ours.f_code.co_filename.startswith(str(_PACKAGE)):
        return _named(inner)
    return _named(ours) if ours is inner else f"{_named(inner)}, called by {_named(ours)}"


def _named(frame: FrameType) -> str:
    code = frame.f_code
    return f"{code.co_qualname} ({Path(code.co_filename).name}:{frame.f_lineno})"


def _page_faults() -> int:
    """Of this thread, those for which a disk was read."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_majflt


# Whether the daemon does what it is there for, measured, with reasons where it does not.


PERIOD_S = 0.25
WINDOW_S = 60.0
LAG_TOLD_S, LAG_MOST_S = 0.5, 1.0
"""Delays of the event loop: from which on one is told, and from which on the daemon is not healthy
for a minute."""
RELEASE_EVERY = 80
"""So often (20 s) what the C library keeps for later is given back: with its recorder's and
readers' threads it would otherwise keep 20 MB more after some hours."""


class Health:
    """Watches the event loop; judges the rest when asked.

    note: told (kind, text) when the loop was held up, and by what.
    """

    def __init__(self, note: Callable[[str, str], None] = lambda kind, text: None) -> None:
        self._note = note
        self._lags: deque[tuple[float, str]] = deque(maxlen=round(WINDOW_S / PERIOD_S))

    async def watch(self) -> None:
        """Measure by how much the event loop is late, for as long as the daemon runs."""
        loop = asyncio.get_running_loop()
        with Witness() as witness:
            for turn in itertools.count(1):
                if turn % RELEASE_EVERY == 0:
                    await asyncio.to_thread(give_back)
                witness.beat()
                due_s = loop.time() + PERIOD_S
                await asyncio.sleep(PERIOD_S)
                late_s = loop.time() - due_s
                self._lags.append((late_s, ""))
                if late_s >= LAG_TOLD_S:
                    why = witness.why(late_s)
                    self._lags[-1] = late_s, why
                    self._note("held up", f"the event loop, for {late_s:.1f} s: {why}")

    @property
    def lag_s(self) -> float:
        """The worst delay of the event loop in the last minute."""
        return max(self._lags, default=(0.0, ""))[0]

    @property
    def held_up_by(self) -> str:
        """What caused it, where it is worth telling."""
        return max(self._lags, default=(0.0, ""))[1]

    def status(self, problems: list[str]) -> dict[str, Any]:
        """healthy, and why not; what the process uses. problems: those that others see."""
        if self.lag_s > LAG_MOST_S:
            held_up = f"the event loop was held up for {self.lag_s:.1f} s: {self.held_up_by}"
            problems = [*problems, held_up]
        return {
            "healthy": not problems,
            "problems": problems,
            "loop_lag_ms": round(1e3 * self.lag_s, 1),
            "held_up_by": self.held_up_by,
            **usage(),
        }


def usage() -> dict[str, Any]:
    """What this process uses: processor seconds, resident memory, descriptors, threads."""
    times = os.times()
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[1])
    return {
        "cpu_s": round(times.user + times.system, 2),
        "memory_mb": round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": len(os.listdir("/proc/self/task")),
    }


# Who takes what a station receives: a list of consumers, each with the same three methods.


class Consumer(Protocol):
    """Recorder, viewer, stream, twin. None waits: what takes time has a queue with a bound."""

    def samples(self, batch: SampleBatch) -> None:
        """Decoded rows, one at least."""

    def note(self, note: LinkEvent | LinkStatistics | LogTable | Shown) -> None:
        """What there is beside samples: an event, the link's last second, log variables of a
        craft at moments of their own, half a second of the twin's predictions."""

    def split(self) -> None:
        """What follows comes from another link."""


# The newest sample: as clients are told it, and what it says of the motors.


class Newest:
    """now_ns: the present on the time base of the packets. batch: None before the first."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.batch: SampleBatch | None = None
        self._now_ns = now_ns

    def samples(self, batch: SampleBatch) -> None:
        """A batch with one row at least."""
        self.batch = batch

    def telemetry(self) -> Telemetry | None:
        """The last row, in the units of the API; what a source does not have is None."""
        batch = self.batch
        if batch is None:
            return None
        roll, pitch, yaw = _numbers(np.degrees(batch.attitude[-1]))
        (battery,) = _numbers(batch.battery_v[-1:])
        return Telemetry(
            age_s=round(self._age_s(batch), 4),
            timestamp=int(batch.ticks[-1]),
            roll_deg=roll,
            pitch_deg=pitch,
            yaw_deg=yaw,
            gyro_dps=_numbers(np.degrees(batch.gyro[-1])),
            battery_v=battery,
            motors=_numbers(batch.duty[-1]),
        )

    def motors(self) -> Motors | None:
        """What the craft says of its motors; None where it does not."""
        batch = self.batch
        if batch is None or np.isnan(batch.duty[-1]).any():
            return None
        return Motors(self._age_s(batch), float(batch.duty[-1].max()))

    def _age_s(self, batch: SampleBatch) -> float:
        return (self._now_ns() - int(batch.host_time_ns[-1])) * 1e-9


def _numbers(values: Any) -> list[float | None]:
    return [None if np.isnan(value) else round(float(value), 4) for value in values]


# Tasks that must not die silently: begun anew with growing pauses, counted and told.


BACK_OFF_S = (0.5, 1.0, 2.0, 4.0, 8.0)
SETTLED_S = 30.0
"""A task that ran for so long begins its back-off anew."""

Work = Callable[[], Awaitable[None]]


@dataclass(slots=True)
class TaskCount:
    """How a supervised task fares. state: running, waiting (to be begun anew) or ended."""

    state: str = "running"
    restarts: int = 0


class TaskSupervisor:
    """Runs tasks until ``close``. fault: told (text, name) of each failure."""

    def __init__(self, fault: Callable[[str, str], None]) -> None:
        self._fault = fault
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._counts: dict[str, TaskCount] = {}
        self._adopted: dict[str, asyncio.Task[None]] = {}

    def start(self, name: str, work: Work) -> None:
        """Run ``work``; where it raises it is begun anew, where it returns it has ended."""
        self._counts[name] = TaskCount()
        self._tasks[name] = asyncio.create_task(self._keep(name, work), name=name)

    def adopt(self, name: str, task: asyncio.Task[None]) -> None:
        """Watch a task that somebody else ends: should it fail, that is told."""
        self._adopted[name] = task

        def look(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and task.exception() is not None:
                self._fault(f"{name} has failed: {task.exception()!r}", name)

        task.add_done_callback(look)

    @property
    def restarts(self) -> int:
        return sum(count.restarts for count in self._counts.values())

    def dead(self) -> list[str]:
        """Tasks that are not there any more although nobody closed them."""
        own = [
            name
            for name, task in self._tasks.items()
            if task.done() and self._counts[name].state != "ended"
        ]
        return own + [name for name, task in self._adopted.items() if task.done()]

    def status(self) -> dict[str, Any]:
        return {
            name: {"state": count.state, "restarts": count.restarts}
            for name, count in self._counts.items()
        }

    async def close(self) -> None:
        """End every task."""
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    async def _keep(self, name: str, work: Work) -> None:
        loop, count, failures = asyncio.get_running_loop(), self._counts[name], 0
        while True:
            began_s = loop.time()
            try:
                count.state = "running"
                await work()
            except Exception as error:
                failures = 0 if loop.time() - began_s > SETTLED_S else failures
                wait_s = BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)]
                failures += 1
                count.restarts += 1
                count.state = "waiting"
                self._fault(f"{name} failed: {error!r}; begun anew in {wait_s:g} s", name)
                await asyncio.sleep(wait_s)
            else:
                count.state = "ended"
                return


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
        self.commander = Commander(
            command_link(config, link, clock),
            config.failsafe,
            note=lambda kind, text: self._in_the_loop(
                lambda: self.journal.note(kind, text, source=self.craft.command_uri or "command")
            ),
            telemetry=lambda: (self.receiver.state, self.craft.no_craft()),
            changes=Changes(changes_path()),
            contradiction=partial(contradiction, config.vehicle),
            motors=lambda link: self.newest.motors() if self.craft.is_heard(link) else None,
        )
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
        recorded = config.recording
        self.sessions = Sessions(
            Path(recorded.folder),
            {
                "vehicle": self.craft.metadata,
                "configuration": {  # never what a stand-in hides
                    "link": name,
                    "speed": str(config.link.speed),
                    "command": config.command,
                    "recording": json.dumps(msgspec.to_builtins(recorded)),
                },
            },
            low_space_bytes=round(recorded.low_space_mb * MEBIBYTE),
            on_fault=self._recorder_fault,
            clock=clock,
        )
        self.recordings = RecordingManager(
            self.sessions,
            recorded,
            link=lambda: self.receiver.link.name,
            settle=self.receiver.settle,
            note=self._noting("recorder"),
        )
        self.viewer = Viewer(
            ViewerMode(config.viewer.mode),
            port=config.viewer.port,
            web_port=config.viewer.web_port,
            twin=bool(config.twin.model),
            tables=bool(config.radio.log),
            on_event=self._noting("viewer"),
        )
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
        self.supervisor = TaskSupervisor(lambda text, name: self.journal.fault(text, source=name))
        self.health = Health(self._noting("daemon"))
        self._consumers: tuple[Consumer, ...] = (self.twin, self.sessions, self.viewer, self.stream)
        self.journal.listeners.append(self._note)
        self._recording_ended = False  # with a replay, not by an operator
        self._stopping = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = 0  # that the loop runs in

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
