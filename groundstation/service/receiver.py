"""The telemetry link of the moment: opened, read, decoded, opened again, replaced by another."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Protocol

from groundstation.background import in_background
from groundstation.compiling import announced
from groundstation.errors import (
    BadInputError,
    GroundStationError,
    LinkEndedError,
    LinkError,
    LinkLostError,
)
from groundstation.links.base import Link, LinkState
from groundstation.telemetry.decoder import (
    Decoded,
    Decoder,
    DecoderCounts,
    LinkMeter,
    LinkStatistics,
    compile_kernel,
)
from groundstation.telemetry.samples import RawBatch, SampleBatch

RETRY_FIRST_S, RETRY_MOST_S = 0.5, 5.0
BUSY_S = 0.005
OPEN_MOST_S = 30.0
"""For a link that is to take over: a client is told within its own patience (45 s)."""

_ATTEMPT = frozenset({LinkState.OPENING, LinkState.CLOSED})


class Telling(Protocol):
    """How the receiver reports: kind or fault, text, source."""

    def note(self, kind: str, text: str, *, source: str) -> None: ...

    def fault(self, text: str, *, source: str) -> None: ...


class Receiver:
    """Turns what a link delivers into packets and samples for whoever wants them.

    telling: told of what happens. on_raw, on_samples: given every batch. on_switch: called
    between the last of one link and the first of the next. fast: whether more can come than any
    craft sends; such a source waits while ``busy``.
    """

    def __init__(
        self,
        link: Link,
        telling: Telling,
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
            await self._compile()
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

    async def _compile(self) -> None:
        text = "preparing the decoder, first start only: it is compiled once per machine"
        async with announced(partial(self._telling.note, "preparing", text, source="decoder")):
            await in_background(compile_kernel)

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
