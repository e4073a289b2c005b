"""The interface every telemetry link has.

``read`` owns state, timeouts and events; a backend overrides ``_open``, ``_read`` and
``_close`` and nothing else. ``close`` may be called twice.
"""

from __future__ import annotations

import asyncio
import enum
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from groundstation.errors import LinkEndedError, LinkError, LinkLostError
from groundstation.links.command import CommandLink, EventSink, HostClock, LinkEvent, steady_clock
from groundstation.telemetry.decoder import DecoderCounts
from groundstation.telemetry.samples import LogTable, RawBatch, SampleBatch

LinkBatch = RawBatch | SampleBatch
"""What a link delivers: packets, or samples where the source never had packets (microSD)."""


class LinkState(enum.StrEnum):
    CLOSED = "closed"
    """Not opened yet, or closed by us."""
    OPENING = "opening"
    """Looking for the device."""
    STREAMING = "streaming"
    """Batches arrive."""
    SILENT = "silent"
    """Open, but nothing has arrived for longer than the silence limit."""
    LOST = "lost"
    """The device went away."""
    ENDED = "ended"
    """A finite source has delivered everything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkOptions:
    """What links are made from; each takes what concerns it.

    argument: what follows the colon of the name. speed: of stand-in and replay, 1 for real time.
    stand_in: settings of the software craft; model: file of the model that ``stand-in:MODEL``
    names, where MODEL is not the file itself; command: URI at which it answers where it is
    ``udp://``. usb: ``device`` (VID:PID) and ``serial`` of the bridge where they are not the usual
    ones. rate_hz, wanted: rows a second (0: what the link bears), and further variables, of a
    craft's own log.
    """

    name: str
    argument: str
    speed: float = 1.0
    stand_in: Mapping[str, Any] = field(default_factory=dict)
    model: str = ""
    command: str = ""
    usb: Mapping[str, str] = field(default_factory=dict)
    rate_hz: int = 0
    wanted: Sequence[str] = ()
    clock: HostClock | None = None


class Link(ABC):
    """A source of telemetry.

    name: as the user would type it after ``--link``.
    start_ticks: unwrapped device time of the first sample where the source knows it (replay),
        so that a replayed recording keeps its absolute device time.
    vehicle: profile of the craft, once it is open and where it says so.
    commands: the command link that the same connection carries, where it does.
    on_table: told what the craft logs besides its telemetry, where it was asked to.
    """

    doing = ""
    """What a simulated craft does, in words; of others nothing is known."""
    pauses = False
    """Whether nothing comes at present although nothing is wrong."""
    silence_s = 0.5
    finite = False
    """Whether the source ends, and begins anew when it is opened again."""

    def __init__(self, name: str, *, clock: HostClock | None = None) -> None:
        self.name = name
        self.clock = clock or steady_clock()
        self.state = LinkState.CLOSED
        self.start_ticks: int | None = None
        self.vehicle: str | None = None
        self.commands: CommandLink | None = None
        self.on_event: EventSink = lambda event: None
        self.on_table: Callable[[LogTable], None] = lambda table: None

    async def open(self) -> None:
        """Open the source. Raises LinkError when it cannot be opened now, or is open."""
        if self.state is not LinkState.CLOSED:
            raise LinkError(f"{self.name} is open already; close it first")
        self._enter(LinkState.OPENING, "opening")
        try:
            await self._open()
        except asyncio.CancelledError:
            self._enter(LinkState.CLOSED, "stopped before it was open")
            raise
        except BaseException as error:
            self._enter(LinkState.CLOSED, f"could not open: {str(error) or repr(error)}")
            raise

    async def read(self) -> LinkBatch | None:
        """The next batch, or None when ``silence_s`` passed without one.

        Raises LinkLostError when the device went away, LinkEndedError at the end of a replay,
        LinkError when the link is not open.
        """
        if self.state is LinkState.CLOSED:
            raise LinkError(f"{self.name} is not open; open it before reading")
        try:
            # not wait_for, which in Python 3.11 can swallow the cancellation of its caller
            async with asyncio.timeout(self.silence_s):
                batch = await self._read()
        except TimeoutError:
            self._enter(LinkState.SILENT, f"{self._missing()} received for {self.silence_s:g} s")
            return None
        except LinkEndedError as error:
            self._enter(LinkState.ENDED, str(error))
            raise
        except LinkLostError as error:
            self._enter(LinkState.LOST, str(error))
            raise
        self._enter(LinkState.STREAMING, "receiving")
        return batch

    def sample_counts(self) -> DecoderCounts | None:
        """Totals of a link that makes samples itself and knows what it lost; None for others, whose
        packets ``DecoderCounts`` has; USB frames and a serial line's bytes are counted apart."""
        return None

    async def close(self) -> None:
        """Release the source. Safe to call twice."""
        if self.state is LinkState.CLOSED:
            return
        try:
            await self._close()
        finally:
            self._enter(LinkState.CLOSED, "closed")

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    def now_ns(self) -> int:
        """The present on the time base of this link's host stamps."""
        return self.clock()

    def emit(self, kind: str, text: str, **details: Any) -> None:
        """Report an event of this link."""
        self.on_event(LinkEvent(self.clock(), self.name, kind, text, details))

    def _missing(self) -> str:
        """What does not come while the link is silent."""
        return "nothing"

    def _enter(self, state: LinkState, text: str) -> None:
        if state is not self.state:
            self.state = state
            self.emit(state.value, text)

    @abstractmethod
    async def _open(self) -> None: ...

    @abstractmethod
    async def _read(self) -> LinkBatch:
        """Wait for the next batch. Cancelled at the silence limit: must lose nothing then."""

    @abstractmethod
    async def _close(self) -> None: ...
