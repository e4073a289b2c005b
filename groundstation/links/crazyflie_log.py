"""Telemetry of a stock Crazyflie by its log blocks: ``radio://``, ``usb://`` or ``udp://``.

Nothing is soldered and nothing is flashed: the craft is asked for the variables that it lists.
The connection carries commands too.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Sequence

from groundstation.errors import BadInputError, LinkLostError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.clock import HostClock
from groundstation.links.crazyflie import CrazyflieLink
from groundstation.links.crazyflie_connection import Connection, Identity
from groundstation.links.log_plan import LogPlan, plan_log
from groundstation.links.log_rows import LogPacket, LogRows
from groundstation.telemetry.decoder import DecoderCounts
from groundstation.telemetry.samples import SampleBatch

BATCH_S = 0.01
"""Packets of so long are given out together."""
SILENT_S = 2.0
"""A craft that was silent for so long, or one of the log blocks that its rows need, is connected to
again: it may have restarted, and a restart forgets its log blocks."""
CEASED_S = 0.8
"""A log block of which so long nothing came, while another came, is asked for once more."""
QUEUE_PACKETS = 50_000
"""A minute and more at any rate; the oldest are dropped and counted."""
RATES_HZ = (1000, 500, 250, 200, 125, 100, 50)
"""Whole ms, and not below what identification needs."""
LEAST_HZ, MOST_HZ = 100, 250
"""At 200 packets a second any dongle keeps up: what is lost there is the distance. Rows that come
250 times a second tell all settings of the motors: so many are tried where no rate is asked for."""
BEGIN_S, MEASURE_S, MEASUREMENTS = 0.2, 1.0, 2
"""The second one only where the first finds less than was asked for: that second may have been a
bad one, and the whole flight would be logged as it was."""
BORNE, SPARE = 0.94, 0.9
"""Share of what was asked for that comes where a link bears it, which loses up to 4 %; share of
what comes that is asked for where it does not: commands want room too."""
SETTING_MS = 2
"""How often today's firmware sets the motors."""


def make(options: LinkOptions) -> Link:
    return CrazyflieTelemetry(
        options.name, rate_hz=options.rate_hz, wanted=options.wanted, clock=options.clock
    )


class CrazyflieTelemetry(Link):
    """Samples of a stock Crazyflie.

    rate_hz: 0: as many as the link is found to bear before the first row, ``MOST_HZ`` at most.
    wanted: further log variables.
    """

    def __init__(
        self,
        uri: str,
        *,
        rate_hz: int = 0,
        wanted: Sequence[str] = (),
        clock: HostClock | None = None,
    ) -> None:
        super().__init__(uri, clock=clock)
        if rate_hz not in (0, *RATES_HZ):
            listed = ", ".join(map(str, RATES_HZ))
            raise BadInputError(
                f"rate {rate_hz}: a craft logs every whole ms; give {listed}, or 0 for as many as"
                " the link bears"
            )
        self._connection = Connection(uri)
        self._connection.on_lost.append(self._lose)
        self.commands: CrazyflieLink = CrazyflieLink(uri, shared=self._connection, clock=self.clock)
        self._period_ms = 1000 // (rate_hz or MOST_HZ)
        self._measures = rate_hz == 0
        self._wanted = tuple(wanted)
        self._rows: LogRows | None = None
        self._found = ""  # to be told with the first batch
        self._lost = ""
        self._lock = threading.Lock()
        self._packets: deque[LogPacket] = deque(maxlen=QUEUE_PACKETS)
        self._dropped = 0
        self._arrival = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._due_s = 0.0
        self._heard: dict[int, float] = {}  # block -> when something of it came last, or it began
        self._asking: asyncio.Task[None] | None = None  # for a block again

    def sample_counts(self) -> DecoderCounts | None:
        return self._rows.counts() if self._rows is not None else None

    async def _open(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._arrival, self._lost = asyncio.Event(), ""
        with self._lock:
            self._packets.clear()
        await self._connection.open()
        try:
            identity = await self._connection.identify()
            if self._measures and identity.protocol < 0:  # which logs every 10 ms at the most
                self._measures, self._period_ms = False, 1000 // LEAST_HZ
            slow = self._period_ms > SETTING_MS
            plan = plan_log(self._connection.variables(), self._wanted, slow)
            if self._rows is None:
                self._rows = LogRows(plan, self._period_ms)
            else:
                self._rows.restart(plan, self._period_ms)
            blocks = [*plan.blocks, *plan.extra]
            await self._connection.blocks.start(blocks, self._period_ms, self._take, plan.again)
            if self._measures:
                await self._take_what_is_borne(len(blocks))
                self._rows.restart(plan, self._period_ms)
        except BaseException:
            await self._connection.close()
            raise
        self.vehicle = identity.vehicle
        self._found = self._introduction(identity, plan)
        now_s = self._loop.time()
        self._heard = dict.fromkeys(range(len(blocks)), now_s)

    async def _take_what_is_borne(self, blocks: int) -> None:
        """Count what comes of the most that is asked for, and ask for so much: packets that a radio
        does not carry wait in the craft, and are lost there only when its queue is full."""

        def counted() -> int:
            with self._lock:
                came = len(self._packets)
                self._packets.clear()
            return came

        assert self._loop is not None
        came_hz = 0.0
        for _ in range(MEASUREMENTS):
            await asyncio.sleep(BEGIN_S)
            counted()
            since_s = self._loop.time()
            await asyncio.sleep(MEASURE_S)
            came_hz = max(came_hz, counted() / blocks / (self._loop.time() - since_s))
            if came_hz >= BORNE * MOST_HZ:
                break
        self._measures = False  # once, for who connects again may be in the air
        if came_hz < BORNE * MOST_HZ:
            rates = [rate for rate in RATES_HZ if LEAST_HZ < rate <= SPARE * came_hz]
            self._period_ms = 1000 // (rates[0] if rates else LEAST_HZ)
            await self._connection.blocks.pace(self._period_ms)
            self.emit(
                "loss",
                f"the link bears {came_hz:.0f} of {MOST_HZ} rows a second:"
                f" {1000 // self._period_ms} are asked for",
            )
            counted()

    async def _read(self) -> SampleBatch:
        loop, rows = self._loop, self._rows
        assert loop is not None
        assert rows is not None
        while True:
            for line in self._connection.console.take():
                self.emit("console", line)
            while not self._arrival.is_set():
                self._require_heard(loop.time())
                try:
                    async with asyncio.timeout_at(max(self._heard.values()) + SILENT_S):
                        await self._arrival.wait()
                except TimeoutError:
                    continue
            self._require_heard(loop.time())
            # a moment that was waited for is not waited for again by the next read
            await asyncio.sleep(max(self._due_s - loop.time(), 0.0))
            self._due_s = loop.time() + BATCH_S
            with self._lock:
                packets = list(self._packets)
                self._packets.clear()
                self._arrival.clear()
                dropped, self._dropped = self._dropped, 0
            self._heard |= dict.fromkeys((block for block, *_ in packets), loop.time())
            if dropped:
                self.emit("loss", f"{dropped} packets dropped: nobody read the link for too long")
            samples = rows.add(packets)
            for table in rows.take_extra():
                self.on_table(table)
            self._require_each(loop.time(), rows.plan)
            if len(samples):
                if self._found:
                    self.emit("found", self._found)
                    self._found = ""
                return samples

    async def _close(self) -> None:
        if self._asking is not None:
            self._asking.cancel()
            await asyncio.gather(self._asking, return_exceptions=True)
            self._asking = None
        await self.commands.close()
        await self._connection.close()

    def _require_heard(self, now_s: float) -> None:
        if self._lost:
            raise LinkLostError(f"{self.name}: {self._lost}")
        if now_s >= max(self._heard.values()) + SILENT_S and not self._packets:
            raise LinkLostError(f"{self.name}: nothing came for {SILENT_S:g} s; connecting again")

    def _require_each(self, now_s: float, plan: LogPlan) -> None:
        """Ask again for a block that has ceased while others come; raise LinkLostError where one
        that rows need stays away."""
        away = [number for number, heard_s in self._heard.items() if now_s >= heard_s + CEASED_S]
        lost = [number for number in away if now_s >= self._heard[number] + SILENT_S]
        if any(number < len(plan.blocks) for number in lost):
            raise LinkLostError(
                f"{self.name}: no {_groups(plan, lost)} came for {SILENT_S:g} s; connecting again"
            )
        if away and len(away) < len(self._heard) and (self._asking is None or self._asking.done()):
            self._asking = asyncio.create_task(self._ask_again(away, _groups(plan, away)))

    async def _ask_again(self, blocks: list[int], names: str) -> None:
        try:
            await self._connection.blocks.again(blocks, self._period_ms)
            self.emit("loss", f"no {names} came for {CEASED_S:g} s: asked for once more")
        except Exception as error:  # cflib raises what it likes, and nobody waits for this task
            self.emit("loss", f"no {names} came, nor can they be asked for again: {error}")

    def _missing(self) -> str:
        if self._loop is None or self._rows is None:
            return super()._missing()
        since_s = self._loop.time() - self.silence_s
        away = [number for number, heard_s in self._heard.items() if heard_s <= since_s]
        comes = len(away) < len(self._heard)
        return f"no {_groups(self._rows.plan, away)}" if away and comes else super()._missing()

    def _take(self, block: int, stamp: int, values: tuple[float, ...]) -> None:
        """A packet, on cflib's thread."""
        with self._lock:
            self._dropped += len(self._packets) == QUEUE_PACKETS
            self._packets.append((block, stamp, values, self.clock()))
            tell = not self._arrival.is_set()
        if tell and self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._arrival.set)

    def _lose(self, reason: str) -> None:
        self._lost = reason
        self._arrival.set()

    def _introduction(self, identity: Identity, plan: LogPlan) -> str:
        """One line: what was found, and what is missing."""
        name = identity.device or "a Crazyflie"
        version = f"firmware {identity.firmware}, " if identity.firmware else ""
        protocol = f"protocol {identity.protocol}" if identity.protocol > 0 else "protocol 1"
        names = _groups(plan, range(len(plan.blocks)))
        text = (
            f"{name}, {version}{protocol}; {names} in {len(plan.blocks)} blocks"
            f" {1000 // self._period_ms} times a second"
        )
        if not self.vehicle:
            text += "; vehicle not told: taken for crazyflie21, say --set vehicle=PROFILE"
            self.vehicle = "crazyflie21"
        elif self.vehicle == "crazyflie21":
            text += (
                "; vehicle crazyflie21 (a 2.1+ calls itself alike: --set vehicle=crazyflie21plus)"
            )
        else:
            text += f"; vehicle {self.vehicle}"
        return "; ".join([text, *plan.missing])


def _groups(plan: LogPlan, blocks: Sequence[int]) -> str:
    """What is in some of its blocks, in words."""
    every = [*plan.blocks, *plan.extra]
    return ", ".join(sorted({name.split(".")[0] for b in blocks for name, _ in every[b]}))
