"""Which craft is heard and which is commanded: the telemetry link, the command link, and whether
both lead to the same one.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import heapq
import itertools
import os
import socket
import struct
from collections import Counter, deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec

from groundstation.background import in_background
from groundstation.compiling import announced
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    LinkEndedError,
    LinkError,
    LinkLostError,
    TakenError,
)
from groundstation.links.base import Link, LinkState
from groundstation.links.command import CommandLink, HostClock, LinkEvent, ways_of
from groundstation.links.factory import (
    CRAFT,
    is_stand_in,
    make_command_link,
    make_link,
    serve_commands,
)
from groundstation.service.commander import Commander
from groundstation.service.config import DEFAULT_VEHICLE, Config, link_speed
from groundstation.service.twin import BEGAN
from groundstation.telemetry.decoder import (
    Decoded,
    Decoder,
    DecoderCounts,
    LinkMeter,
    LinkStatistics,
    compile_kernel,
)
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch
from groundstation.text import printable

# The telemetry link of the moment: opened, read, decoded, opened again, replaced by another.


RETRY_FIRST_S, RETRY_MOST_S = 0.5, 5.0
BUSY_S = 0.005
OPEN_MOST_S = 30.0
"""For a link that is to take over: a client is told within its own patience (45 s)."""

_ATTEMPT = frozenset({LinkState.OPENING, LinkState.CLOSED})


class Receiver:
    """Turns what a link delivers into packets and samples for whoever wants them.

    telling: told of what happens. on_raw, on_samples: given every batch. on_switch: called
    between the last of one link and the first of the next. fast: whether more can come than any
    craft sends; such a source waits while ``busy``.
    """

    def __init__(
        self,
        link: Link,
        telling: Journal,
        *,
        on_raw: Callable[[RawBatch], None],
        on_samples: Callable[[SampleBatch], None],
        on_switch: Callable[[], None],
        fast: bool,
        busy: Callable[[], bool] = lambda: False,
    ) -> None:
        self.link = link
        self.decoder = Decoder()
        self.tried = asyncio.Event()
        """Set when the link has been opened, or has turned out not to be there yet."""
        self._telling = telling
        self._on_raw, self._on_samples, self._on_switch = on_raw, on_samples, on_switch
        self._fast = self._compiled = fast
        self._busy = busy
        self._meter = LinkMeter(link.clock())
        self._newest_ns = 0  # the latest host stamp
        self._ready_made = 0  # samples of a source that needs no decoder
        self._earlier: Counter[str] = Counter()  # of links that were switched away from
        self._segment, self._segment_base = -1, 0
        self._retry_s = RETRY_FIRST_S
        self._away: LinkState | None = None  # of a device that is waited for: lost, or never there
        self._missing = ""  # why it cannot be opened now
        self._opened = False  # the present link, once at least
        self._reading: asyncio.Task[None] | None = None
        self._incoming: Link | None = None
        self._swapped = asyncio.Event()
        self._closing: set[asyncio.Task[None]] = set()

    @property
    def state(self) -> LinkState:
        """Of the link: lost until a lost device is back."""
        return self._away or self.link.state

    def is_repetition(self, source: str, kind: str) -> bool:
        """Whether an event is another attempt to open a device that is known to be away."""
        return bool(self._missing) and source == self.link.name and kind in _ATTEMPT

    def now_ns(self) -> int:
        """The present on the time base of the packets: a fast replay's stamps run ahead of any
        clock."""
        return max(self.link.now_ns(), self._newest_ns)

    async def run(
        self, *, opened: Callable[[], Awaitable[None]], ended: Callable[[], Awaitable[None]]
    ) -> None:
        """Receive until a finite link has ended, or fails.

        opened: awaited once, when the first link is open. ended: awaited at the end of a finite
        link; until it returns another link can take over.

        Raises BadInputError when the link can never be opened, LinkError when a finite one
        failed in the middle.
        """
        if self._fast:
            text = "preparing the decoder, first start only: it is compiled once per machine"
            async with announced(partial(self._telling.note, "preparing", text, source="decoder")):
                await in_background(compile_kernel)
        while True:
            self._reading = asyncio.create_task(self._follow(opened, ended), name="link")
            try:
                return await self._reading
            except asyncio.CancelledError:
                task = asyncio.current_task()
                if self._incoming is None or (task is not None and task.cancelling()):
                    raise
                self._swap(self._incoming)

    async def switch(self, link: Link, leave: Callable[[], Awaitable[None]] | None = None) -> None:
        """Go on with another link, from which nothing is lost and nothing attributed to the one
        before. Where it cannot be opened the present one stays, and LinkError or BadInputError
        says why. leave: awaited when the other one is open, before the present one is left; what
        it raises keeps that."""
        self.require_other(link)
        if self._reading is None or self._incoming is not None:
            raise BadInputError("the link is being opened or switched; try again")
        self._incoming = link
        self._swapped.clear()
        try:
            await _open_in_time(link)
            if self._reading.done():
                raise BadInputError(f"{self.link.name} has ended, and the daemon with it")
            if leave is not None:
                await leave()
        except BaseException:
            self._incoming = None
            with contextlib.suppress(Exception):
                await link.close()
            raise
        self._reading.cancel()
        await self._swapped.wait()

    def require_other(self, link: Link) -> None:
        """Raise BadInputError for a link that is the present one."""
        if link.name == self.link.name and not link.finite:
            raise BadInputError(f"{link.name} is the link already")

    async def close(self) -> None:
        """Close the link and give out what is held."""
        try:
            await self.link.close()
            await asyncio.gather(*self._closing)
        finally:
            self.drain()

    def drain(self) -> None:
        """Nothing more will come: give out what is held."""
        self._take(self.decoder.finish())

    def settle(self) -> None:
        """Give out what only waits for its turn."""
        self._take(self.decoder.idle(self.now_ns()))

    def close_window(self, before: LinkStatistics | None) -> LinkStatistics:
        """Statistics since the last call; a restart of the device among them is told."""
        statistics = self._meter.close_window(self.now_ns(), self._counts())
        if statistics.restarts > (before.restarts if before else 0):
            self._telling.note(
                "restart", "the device restarted: a new segment", source=self.link.name
            )
        return statistics

    def totals(self) -> Counter[str]:
        """Packets, samples and lost ones (``DecoderCounts``) of every link since the start."""
        return self._earlier + self._received()

    def _received(self) -> Counter[str]:
        counts = self._counts()
        return Counter(packets=counts.packets, samples=counts.samples, lost=counts.lost)

    def _counts(self) -> DecoderCounts:
        counts = self.link.sample_counts() or self.decoder.counts()
        return replace(counts, samples=counts.samples + self._ready_made)

    async def _follow(
        self, opened: Callable[[], Awaitable[None]], ended: Callable[[], Awaitable[None]]
    ) -> None:
        """Open, read, and open again: after a loss, a fault, or when it is not there yet."""
        while True:
            try:
                if self.link.state is LinkState.CLOSED:
                    await self._open(opened)
                await self._read()
            except LinkEndedError:
                return await ended()
            except LinkLostError:
                self._lose()
            except GroundStationError as error:
                if not isinstance(error, LinkError) and not self._opened:
                    raise  # what never worked never will; what did may have been caught in leaving
                if self.link.state is not LinkState.CLOSED:
                    self._lose()  # it was open: reading failed
                self._away = self._away or LinkState.OPENING
                if str(error) != self._missing:
                    self._missing = str(error)
                    self._telling.note("waiting", self._missing, source=self.link.name)
            except Exception as error:
                self._telling.fault(f"receiving failed: {error!r}", source=self.link.name)
                if self.link.finite:  # opened again it would begin anew
                    raise LinkError(
                        f"{self.link.name}: reading failed in the middle ({error!r}); what came "
                        "before was delivered"
                    ) from error
                self._lose()
            try:
                await self.link.close()
            except Exception as error:
                self._telling.fault(f"closing failed: {error!r}", source=self.link.name)
            await asyncio.sleep(self._retry_s)
            self._retry_s = min(2 * self._retry_s, RETRY_MOST_S)

    async def _open(self, opened: Callable[[], Awaitable[None]]) -> None:
        try:
            await self.link.open()
        finally:
            self.tried.set()
        if not self._opened:
            self._begin()
            # not before: a mistyped link leaves no empty file behind
            await opened()
            self._opened = True
        self._retry_s, self._missing = RETRY_FIRST_S, ""

    def _begin(self) -> None:
        self.decoder = Decoder(self.link.start_ticks, compiled=self._compiled)
        self._meter = LinkMeter(self.now_ns())

    def _swap(self, link: Link) -> None:
        """The incoming link takes over: not a moment passes without one."""
        before = self.link
        self.drain()
        self._earlier += self._received()
        self.link, self._incoming = link, None
        self._segment_base = self._segment + 1
        self._newest_ns = self._ready_made = 0
        self._away, self._missing, self._retry_s = None, "", RETRY_FIRST_S
        self._begin()
        self._on_switch()
        self._telling.note("link", f"switched from {before.name} to {link.name}", source=link.name)
        task = asyncio.create_task(self._close(before), name="close link")
        self._closing.add(task)
        task.add_done_callback(self._closing.discard)
        self._swapped.set()

    async def _close(self, link: Link) -> None:
        try:
            await link.close()
        except Exception as error:
            self._telling.fault(f"closing failed: {error!r}", source=link.name)

    def _lose(self) -> None:
        """What follows is a new segment, after whatever went wrong."""
        self._away = LinkState.LOST
        try:
            self._take(self.decoder.reconnected())
        except Exception as error:
            self._telling.fault(f"the decoder starts anew: {error!r}", source="decoder")
            self.decoder = Decoder()
            self._segment_base = self._segment + 1

    async def _read(self) -> None:
        while True:
            while self._fast and self._busy():
                await asyncio.sleep(BUSY_S)
            batch = await self.link.read()
            self._away = None
            if batch is None:
                self._take(self.decoder.idle(self.link.now_ns()))
                continue
            if len(batch):
                self._newest_ns = max(self._newest_ns, int(batch.host_time_ns[-1]))
            if isinstance(batch, RawBatch):
                self._on_raw(batch)
                self._take(self.decoder.decode(batch))
            else:
                counted = self.link.sample_counts() is not None
                self._meter.add_samples(batch, live=counted)
                self._ready_made += 0 if counted else len(batch)
                self._give(batch)

    def _take(self, decoded: Decoded) -> None:
        self._meter.add(decoded)
        self._give(decoded.samples)

    def _give(self, samples: SampleBatch) -> None:
        if len(samples) == 0:
            return
        if self._segment_base:
            samples = replace(samples, segment=samples.segment + self._segment_base)
        self._segment = max(self._segment, int(samples.segment[-1]))
        self._on_samples(samples)


async def _open_in_time(link: Link) -> None:
    try:
        async with asyncio.timeout(OPEN_MOST_S) as limit:
            await link.open()
    except TimeoutError as error:
        if not limit.expired():
            raise
        raise LinkError(
            f"{link.name} has not opened within {OPEN_MOST_S:g} s, so the present link stays; "
            "see whether its device or disk answers"
        ) from error


# One program a dongle: opening one that another program flies with would reset it in flight.
#
# A name in the kernel's own space (an abstract socket) holds it: it is one for all users and
# services of the machine, whatever folders they see, and is free again when its holder has ended,
# however.


ASKERS = 64
"""Programs that may ask who holds one, as long as it is held: the kernel tells each by a connection
that nobody accepts."""
ASK_S = 1.0
_PEER = struct.Struct("3i")  # ucred: process, user, group


class Dongles:
    """The dongles and cables that this program holds, and for which addresses."""

    def __init__(self) -> None:
        self._held: dict[str, socket.socket] = {}
        self._ways: dict[str, frozenset[str]] = {}

    def take(self, ways: Mapping[str, Iterable[str]]) -> None:
        """Hold also what these addresses lead through. Raises TakenError, and changes nothing,
        where another program has one. ways: by address, see ``command.ways_of``."""
        wanted = {way: uri for uri, leads in ways.items() for way in leads}
        with contextlib.ExitStack() as undone:
            new = {
                way: undone.enter_context(_taken(way, uri))
                for way, uri in wanted.items()
                if way not in self._held
            }
            undone.pop_all()
        self._held |= new
        self._ways |= {uri: frozenset(leads) for uri, leads in ways.items()}

    def keep(self, uris: Iterable[str]) -> None:
        """Let go of all that none of these addresses leads through. It takes nothing: a dongle
        that has another number by now is held as it was when it was taken."""
        self._ways = {uri: self._ways[uri] for uri in uris if uri in self._ways}
        for way in self._held.keys() - {way for leads in self._ways.values() for way in leads}:
            self._held.pop(way).close()

    def close(self) -> None:
        """Let go of all. Safe to call twice."""
        self.keep(())


def _taken(way: str, uri: str) -> socket.socket:
    """The name of a dongle, from now on ours."""
    address, ours = f"\0groundstation {way}", socket.socket(socket.AF_UNIX)
    try:
        ours.bind(address)
        ours.listen(ASKERS)
    except OSError as error:
        ours.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise TakenError(
            f"{uri}: {way} is in use by {_holder(address)}; end it, or take another dongle"
        ) from error
    return ours


def _holder(address: str) -> str:
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as asking:
        asking.settimeout(ASK_S)
        asking.connect(address)
        told = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
        process, *_ = _PEER.unpack(told)
        words = ""
        with contextlib.suppress(OSError):  # of another user, or gone
            line = Path(f"/proc/{process}/cmdline").read_text(errors="replace")
            words = " ".join(os.path.basename(word) for word in line.split("\0")[:3]).strip()
        return f"process {process}" + (f" ({words})" if words else "")
    return "another program"


# What happened: events of links, clients and the daemon itself, kept, logged and handed on.


EVENTS_KEPT = 1000
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
        "landing",
        "restore",
        "deleted",
        "held up",
        BEGAN,
    }
)


class Journal:
    """The daemon's events.

    clock: stamps events of the daemon itself. is_repetition: whether an event of (source, kind) is
    no news. listeners: handed every other event; log: as well, with whether it is a warning.
    """

    def __init__(self, clock: HostClock, is_repetition: Callable[[str, str], bool]) -> None:
        self._number = itertools.count()
        self._kept: dict[str, deque[tuple[int, LinkEvent]]] = {}  # by kind
        self.damaged = False
        """Whether the source had parts that could not be read."""
        self.faults = 0
        """Faults of the program itself, each survived and told as an event."""
        self.listeners: list[Callable[[LinkEvent], None]] = []
        self._clock = clock
        self._is_repetition = is_repetition
        self.log: Callable[[LinkEvent, bool], None] = lambda event, warns: None

    @property
    def events(self) -> list[LinkEvent]:
        """The latest, in the order in which they came."""
        return [event for _, event in heapq.merge(*self._kept.values(), key=itemgetter(0))]

    def note(self, kind: str, text: str, *, source: str) -> None:
        """An event of the daemon itself."""
        self.take(LinkEvent(self._clock(), source, kind, text))

    def fault(self, text: str, *, source: str) -> None:
        """A fault of the program that it survives: counted and told."""
        self.faults += 1
        self.note("fault", text, source=source)

    def take(self, event: LinkEvent) -> None:
        """Keep and log an event, and hand it on."""
        event = replace(event, link=printable(event.link), text=printable(event.text))
        if self._is_repetition(event.link, event.kind):
            return
        self._kept.setdefault(event.kind, deque()).append((next(self._number), event))
        if sum(map(len, self._kept.values())) > EVENTS_KEPT:
            # a flood of one kind pushes out its own
            max(self._kept.values(), key=len).popleft()
        self.damaged |= event.kind == "damage"
        self.log(event, event.kind in _WARNINGS)
        for listener in self.listeners:
            listener(event)


def telemetry_link(
    config: Config,
    name: str,
    journal: Journal,
    clock: HostClock,
    *,
    on_table: Callable[[LogTable], None],
    port: str,
    model: str = "",
) -> Link:
    """A link as configured, that tells the journal. on_table: given what a craft logs besides.
    port: where a stand-in takes commands. model: file of the model that ``stand-in:MODEL`` names.
    Raises BadInputError."""
    link = make_link(
        name,
        speed=link_speed(config.link.speed),
        stand_in=config.stand_in,
        model=model,
        command=port,
        usb=msgspec.to_builtins(config.usb),
        rate_hz=config.radio.rate_hz,
        wanted=[name.strip() for name in config.radio.log.split(",") if name.strip()],
        clock=clock,
    )
    link.on_event, link.on_table = journal.take, on_table
    return link


def command_link(config: Config, telemetry: Link, clock: HostClock) -> CommandLink | None:
    """The configured one, or that of a craft that is commanded where its telemetry comes from."""
    own = telemetry.commands
    if config.command and (own is None or config.command != own.uri):
        return make_command_link(config.command, clock=clock)
    return own


class CraftLinks:
    """The links of the moment, and what an operator can choose instead.

    on_entry: given what is sent to the craft, for the recording.
    """

    def __init__(
        self,
        config: Config,
        journal: Journal,
        clock: HostClock,
        receiver: Receiver,
        commander: Commander,
        *,
        on_entry: Callable[[dict[str, Any]], None],
    ) -> None:
        self.metadata = {"profile": config.vehicle or DEFAULT_VEHICLE}
        """What recordings say of the vehicle, kept true."""
        self._config, self._journal, self._clock = config, journal, clock
        self._receiver, self._commander = receiver, commander
        self._on_entry = on_entry
        self._port = config.command  # at which a stand-in takes commands
        self._switching = False
        self._dongles = Dongles()
        self.command_uri = ""
        if commander.link is not None:
            self._listen(commander.link)

    @property
    def vehicle(self) -> str:
        """The profile that recordings name."""
        return self.metadata["profile"]

    async def switch(self, name: str, model: str = "") -> None:
        """Receive from another link, the recording going on. Where it cannot be opened the
        present one stays: LinkError or BadInputError; TakenError while a client commands.

        model: file of the model that ``stand-in:MODEL`` names."""
        await self._commander.leave()
        async with self._another(name):
            link = telemetry_link(
                self._config,
                name,
                self._journal,
                self._clock,
                on_table=self._receiver.link.on_table,
                port=self._port,
                model=model,
            )
            self._receiver.require_other(link)  # before anybody's port is given back
            before = self._receiver.link
            async with _port_of(before, link):
                await self._receiver.switch(link, self._commander.leave)
            if link.commands is not None:  # one connection carries both: commands follow
                await self._command_by(link.commands)
            elif is_stand_in(before.name):  # the craft that took commands is gone
                await self._commander.disconnect()
        self.tell()

    async def connect_command(self, uri: str) -> None:
        """Command the craft at ``uri`` from now on; it is connected as soon as it answers. A
        stand-in that is flown answers there. Raises BadInputError, TakenError."""
        if not uri.startswith(CRAFT):
            raise BadInputError(f"command link {uri!r}: give {' or '.join(CRAFT)}...")
        await self._commander.leave()
        telemetry = self._receiver.link
        own = telemetry.commands
        if own is None or own.uri != uri:
            own = make_command_link(uri, clock=self._clock)
        async with self._another(uri):
            await serve_commands(telemetry, uri)
            await self._command_by(own)
        self._port = uri
        self.tell_no_craft()

    def tell(self) -> None:
        """Of a link that was just opened. What its craft says it is goes into the recordings,
        unless the configuration says."""
        self.tell_no_craft()
        link = self._receiver.link
        said, configured = link.vehicle, self._config.vehicle
        self.metadata["profile"] = configured or said or DEFAULT_VEHICLE
        if said and configured and said != configured:
            self._journal.note(
                "vehicle",
                f"the craft says it is a {said}; recordings say {configured}, as configured",
                source=link.name,
            )

    def tell_no_craft(self) -> None:
        """Of a command link that is not used with this telemetry, before somebody wonders."""
        if self.command_uri and (reason := self.no_craft()):
            self._journal.note("waiting", f"not connected: {reason}", source=self.command_uri)

    def no_craft(self) -> str:
        """Why nothing that could be commanded is behind the telemetry, or empty."""
        return "the link is being switched" if self._switching else self._mismatch()

    def _mismatch(self) -> str:
        link = self._receiver.link
        if link.finite:
            return f"{link.name} is a recording"
        if is_stand_in(link.name) and not self.command_uri.startswith("udp://"):
            # who watches a simulated flight must not fly a real craft
            return f"the telemetry is the stand-in's, and {self.command_uri} is another craft"
        return ""

    def is_heard(self, command: CommandLink) -> bool:
        """Whether the telemetry is that of the craft that ``command`` leads to."""
        own = self._receiver.link.commands
        return not self._mismatch() and (own is None or own.uri == command.uri)

    def out_of_reach(self) -> str:
        """Why the craft that is heard cannot be stopped from here, or empty: where there is none,
        or where commands go to it as far as anybody knows."""
        telemetry, command = self._receiver.link, self._commander.link
        if telemetry.finite or command is None or self._switching:
            return ""
        if telemetry.commands is not None and telemetry.commands.uri != command.uri:
            return (
                f"the craft that is heard ({telemetry.name}) cannot be stopped from here: commands"
                f" go to {command.uri}"
            )
        return ""

    def flies_by_dongle(self) -> bool:
        """Whether a dongle or cable is in use, so that nobody else may look for craft with it."""
        return any(uri.startswith(("radio://", "usb://")) for uri in self._uris())

    async def hold_dongles(self) -> None:
        """What the links of the moment use is ours alone. Raises TakenError where another program
        has one."""
        await self._hold(*self._uris())

    def close(self) -> None:
        """Leave the dongles to others, when the links are closed. Safe to call twice."""
        self._dongles.close()

    async def _hold(self, *uris: str) -> None:
        self._dongles.take(await in_background(lambda: ways_of(uris)))

    @contextlib.asynccontextmanager
    async def _another(self, uri: str) -> AsyncIterator[None]:
        """While a link is exchanged: the dongle of the next one is ours before, and that of the
        one that was left is free behind. Raises TakenError where another program has it."""
        if self._switching:
            raise TakenError("the link is being switched already")
        self._switching = True
        try:
            await self._hold(uri)
            yield
        finally:
            self._switching = False
            self._dongles.keep(self._uris())

    def _uris(self) -> tuple[str, str]:
        command = self._commander.link
        return self._receiver.link.name, "" if command is None else command.uri

    async def _command_by(self, link: CommandLink) -> None:
        """From now on. Raises TakenError while motors are not known to have stopped."""
        if link is not self._commander.link:
            await self._commander.replace(link)
            self._listen(link)

    def _listen(self, command: CommandLink) -> None:
        command.on_event = self._journal.take
        command.on_entry = self._on_entry
        command.on_table = self._receiver.link.on_table
        self.command_uri = command.uri


def contradiction(configured: str, said: str) -> str:
    """Why a craft that says it is a ``said`` is not the configured one, or empty. A 2.1, a 2.1+ and
    a profile of one's own are called alike by the firmware."""
    if not said or not configured or _kind(said) == _kind(configured):
        return ""
    return (
        f"the craft says it is a {said}, and the daemon was told that it is a {configured}: begin"
        " it without --set vehicle, or with the right one"
    )


@cache
def _kind(vehicle: str) -> tuple[str, bool]:
    """What the firmware tells apart: whose loops fly it, and whether its motors are brushless."""
    profile = load_vehicle(vehicle)
    return profile.firmware, profile.is_brushless


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
