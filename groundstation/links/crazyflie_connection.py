"""One connection to one Crazyflie, for telemetry and commands alike.

cflib, which is GPLv3 and an optional extra, calls back from threads of its own; what they say
reaches the event loop here or through the callables given.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import random
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.background import in_background
from groundstation.errors import BadInputError, LinkError
from groundstation.links.command import (
    ADDRESSES,
    HINT,
    LEAN,
    MISC,
    PLACE,
    HostClock,
    ParameterStorage,
    Place,
    is_address,
)
from groundstation.links.log_rows import WRAP_MS, Variable
from groundstation.telemetry.samples import LogTable

# Between cflib's threads and ours: futures that callbacks of either side settle, and packets.


LOG_CONTROL = (5, 1)
"""Port and channel of the requests that make, start and end log blocks."""
CREATE, APPEND, START, CREATE_V2, APPEND_V2, START_V2 = 0, 1, 3, 6, 7, 8
NOT_TWICE = (CREATE, APPEND, START, CREATE_V2, APPEND_V2, START_V2)


def resolve(future: asyncio.Future[Any], result: Any) -> None:
    """Set a future once, from whichever callback comes first."""
    if future.done():
        return
    if isinstance(result, Exception):
        future.set_exception(result)
    else:
        future.set_result(result)


def elsewhere(function: Callable[[], None]) -> None:
    """Let a thread of its own call it: one that may not wait for the thread that asks."""
    threading.Thread(target=function, daemon=True).start()


def newest_only(
    loop: asyncio.AbstractEventLoop, function: Callable[[Any], None]
) -> Callable[[Any], None]:
    """For another thread: lets the loop call ``function`` with the newest of what it is given; one
    call waits at most, however fast they come."""
    lock, waiting = threading.Lock(), list[Any]()

    def call() -> None:
        with lock:
            value = waiting.pop()
        function(value)

    def tell(value: Any) -> None:
        with lock:
            is_first = not waiting
            waiting[:] = [value]
        if is_first:
            with contextlib.suppress(RuntimeError):  # cflib's threads may outlast the loop
                loop.call_soon_threadsafe(call)

    return tell


def crtp_packet(port: int, channel: int, data: bytes) -> Any:
    """One of cflib's packets."""
    from cflib.crtp.crtpstack import CRTPPacket

    made = CRTPPacket()
    made.set_header(port, channel)
    made.data = data
    return made


def ask_again(craft: Any, uri: str) -> Callable[[], None]:
    """Let cflib's object send a request that UDP lost once more, as it does for a radio, and on no
    link a request that makes a log block, adds to one or starts it: who made the block starts over,
    for one that was half made, or had more added twice, sends something else, and one that is
    started twice skips a moment.

    What is returned lets it send nothing any more: what it still wants to ask again would find the
    link gone.
    """
    send, sending, hushed = craft.send_packet, threading.Lock(), threading.Event()

    def once(
        packet: Any, expected_reply: tuple[int, ...] = (), resend: bool = False, wait_s: float = 0.2
    ) -> None:
        with sending:
            link = craft.link
            if link is None or hushed.is_set():
                return
            link.needs_resending |= uri.startswith("udp://")
            if (packet.port, packet.channel) == LOG_CONTROL and packet.data[0] in NOT_TWICE:
                expected_reply = ()
            try:
                send(packet, expected_reply, resend, wait_s)
            except AttributeError:  # lost at this moment; cflib keeps its own lock
                if craft.link is not None:
                    raise
                with contextlib.suppress(RuntimeError):
                    craft._send_lock.release()

    def hush() -> None:
        with sending:
            hushed.set()

    craft.send_packet = once
    return hush


def begin_once(craft: Any) -> None:
    """Let the first answer alone begin the reading of a craft's tables.

    cflib begins anew with each that says which protocol is spoken, of which several may come late
    together; it then clears the log of the craft once more, at any moment, and whoever logs by
    then hears nothing any more.
    """
    fetch = craft.platform.fetch_platform_informations

    def fetch_once(callback: Callable[[], None]) -> None:
        begun = threading.Event()

        def begin() -> None:
            if not begun.is_set():
                begun.set()
                callback()

        fetch(begin)

    craft.platform.fetch_platform_informations = fetch_once


def protocol_of(craft: Any) -> int:
    """Version of CRTP that cflib's object speaks with, -1 for one that knows no versions."""
    return int(craft.platform.get_protocol_version())


# The console of a craft: text that comes in pieces, as lines, and no more than a person reads.


LINE_CHARACTERS = 200
"""A longer line is told in parts of so many; the firmware's own are shorter than a hundred."""
LINES_A_SECOND, LINES_AT_ONCE = 20, 200
"""What a craft may say for long, and when it starts. What is beyond that is counted."""
TOLD_EVERY_S = 5.0
"""How often it is told how many lines were left out."""


class Console:
    """Lines of a craft's console, kept until they are taken: ``LINES_AT_ONCE`` at most.

    clock: monotonic, seconds. May be fed from another thread than the one that takes.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._begun = ""  # a line whose end has not come
        self._kept: deque[str] = deque()
        self._dropped = 0
        self._allowed, self._allowed_s = float(LINES_AT_ONCE), clock()
        self._told_s = -TOLD_EVERY_S

    def feed(self, text: str) -> None:
        """Text as it comes; the time this takes grows with its length alone."""
        with self._lock:
            *lines, self._begun = (self._begun + text).split("\n")
            whole = len(self._begun) // LINE_CHARACTERS * LINE_CHARACTERS
            lines.append(self._begun[:whole])
            self._begun = self._begun[whole:]
            for line in filter(None, map(str.strip, lines)):
                for at in range(0, len(line), LINE_CHARACTERS):
                    self._keep(line[at : at + LINE_CHARACTERS])

    def end(self) -> None:
        """The connection has ended: what came of a line is one."""
        self.feed("\n")

    def take(self) -> list[str]:
        """What came since the last call, and how many lines were dropped."""
        with self._lock:
            lines = list(self._kept)
            self._kept.clear()
            if self._dropped and self._clock() >= self._told_s + TOLD_EVERY_S:
                lines.append(f"({self._dropped} lines left out: over {LINES_A_SECOND} a second)")
                self._dropped, self._told_s = 0, self._clock()
            return lines

    def _keep(self, line: str) -> None:
        now_s = self._clock()
        more = LINES_A_SECOND * (now_s - self._allowed_s)
        self._allowed, self._allowed_s = min(self._allowed + more, LINES_AT_ONCE), now_s
        if len(self._kept) < LINES_AT_ONCE and self._allowed >= 1.0:
            self._allowed -= 1.0
            self._kept.append(line)
        else:
            self._dropped += 1


# What a craft is asked to log: blocks of variables, how often they come, and when.
#
# cflib asks for them; periods under 10 ms and the moment within a period are asked for here.


BLOCK_S, BEGIN_TRIES = 5.0, 5
BLOCKS_MOST = "a craft logs 16 blocks and 128 variables"
"""The firmware's own limits, which cflib knows."""
MOST_AT_ONCE = 9
"""Variables of a block that one packet holds; of more, cflib adds the rest with another."""
STOP_S = 0.2
"""Between stopping and deleting a block: deleting one while it is read can crash the firmware."""
STAGGER_TRIES = 40
LEAST_CFLIB_MS = 10
"""cflib's own commands know no shorter period."""

OnValues = Callable[[int, int, tuple[float, ...]], None]
"""Number of the block, stamp (ms, 24 bits), values; from cflib's thread."""


class LogBlocks:
    """The log blocks of one craft.

    uri: named in errors. craft: cflib's object, raising LinkError where nothing is connected.
    """

    def __init__(self, uri: str, craft: Callable[[], Any]) -> None:
        self._uri, self._craft = uri, craft
        self._blocks: list[Any] = []
        self._watched: list[Any] = []
        self._half_made: list[Any] = []
        self._between = 0
        self._stamps: dict[int, int] = {}

    @property
    def _protocol(self) -> int:
        return protocol_of(self._craft())

    async def start(
        self,
        blocks: Sequence[Sequence[Variable]],
        period_ms: int,
        on_values: OnValues,
        between: int = 0,
    ) -> None:
        """Let the craft send blocks, each every ``period_ms``.

        between: number of the block that is to come half-way between those of the first; 0: none.

        Raises LinkError where it refuses one, or does not know so short a period.
        """
        stamps = self._stamps = {}
        self._between = between
        running = threading.Event()  # nothing is passed on before the last block has its period
        for number, variables in enumerate(blocks):

            def received(stamp: int, values: Any, block: Any, number: int = number) -> None:
                stamps[number] = stamp
                if running.is_set():
                    on_values(number, stamp, tuple(values.values()))

            name, slow_ms = f"block {number}", max(period_ms, LEAST_CFLIB_MS)
            self._blocks.append(await self._begin(name, variables, slow_ms, received))
        await self.pace(period_ms)
        running.set()

    async def watch(
        self,
        name: str,
        variables: Sequence[Variable],
        period_ms: int,
        on_values: Callable[[int, dict[str, float]], None],
    ) -> None:
        """Let the craft say these as well, every ``period_ms``, however fast its other blocks are;
        told from cflib's thread, with the stamp. Raises LinkError where it refuses."""
        self._watched.append(
            await self._begin(
                name,
                variables,
                period_ms,
                lambda stamp, values, block: on_values(stamp, dict(values)),
            )
        )

    async def _begin(
        self,
        name: str,
        variables: Sequence[Variable],
        period_ms: int,
        received: Callable[[int, Any, Any], None],
    ) -> Any:
        """A block that the craft has started, made anew where a request or an answer was lost.
        Raises LinkError where it refuses, BadInputError where there are too many."""
        for _ in range(BEGIN_TRIES):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(BLOCK_S / BEGIN_TRIES):
                    return await self._make(name, variables, period_ms, received)
        raise self._did_not("did not start a log block")

    async def _make(
        self,
        name: str,
        variables: Sequence[Variable],
        period_ms: int,
        received: Callable[[int, Any, Any], None],
    ) -> Any:
        from cflib.crazyflie.log import LogConfig

        craft, loop = self._craft(), asyncio.get_running_loop()
        block = LogConfig(name, period_ms)
        for variable, kind in variables:
            block.add_variable(variable, kind)
        started: asyncio.Future[None] = loop.create_future()
        whole: asyncio.Future[None] = loop.create_future()
        missing = (len(variables) - 1) // MOST_AT_ONCE if self._protocol >= 0 else 0
        if not missing:
            whole.set_result(None)

        def begun(block: Any, is_started: bool) -> None:
            loop.call_soon_threadsafe(resolve, started, None)

        def refused(block: Any, reason: str) -> None:
            error = LinkError(f"{self._uri}: the craft refused a log block: {reason}")
            loop.call_soon_threadsafe(resolve, started, error)

        def heard(packet: Any) -> None:  # cflib does not look at what becomes of an addition
            nonlocal missing
            data = bytes(packet.data)
            if len(data) < 3 or data[:2] != bytes([APPEND_V2, block.id]):
                return
            missing -= data[2] == 0
            if not missing:
                loop.call_soon_threadsafe(resolve, whole, None)
            elif data[2] not in (0, errno.ENOENT):  # ENOENT: the block itself was lost
                refused(block, os.strerror(data[2]))

        block.started_cb.add_callback(begun)
        block.error_cb.add_callback(refused)
        block.data_received_cb.add_callback(received)
        craft.add_header_callback(heard, *LOG_CONTROL)
        try:
            craft.log.add_config(block)
            block.start()
            await started
            await whole
        except (AttributeError, KeyError) as error:  # cflib's own limits
            what = f"{self._uri}: {error.args[0] if error.args else error}"
            raise BadInputError(f"{what}: {BLOCKS_MOST}; ask for fewer with --log") from error
        except asyncio.CancelledError:
            block.stop()  # and deleted at the end: it may be read at this moment
            with contextlib.suppress(ValueError):  # cflib has begun anew
                craft.log.log_blocks.remove(block)
            self._half_made.append(block)
            raise
        finally:
            craft.remove_header_callback(heard, *LOG_CONTROL)
        return block

    async def pace(self, period_ms: int) -> None:
        """Let the blocks that run come every ``period_ms``; commands go on meanwhile.

        Raises LinkError where the craft does not confirm it.
        """
        await self._set_period(period_ms, self._blocks)
        if self._between and self._protocol >= 0:
            await self._stagger(self._blocks[self._between], period_ms, self._between)

    async def again(self, numbers: Sequence[int], period_ms: int) -> None:
        """Ask once more for blocks that have ceased. Raises LinkError where the craft does not
        confirm it, or knows them no more."""
        await self._set_period(period_ms, [self._blocks[number] for number in numbers])

    async def _stagger(self, block: Any, period_ms: int, number: int) -> None:
        """Start a block again until it comes half a period after the first one.

        When a packet arrives in the craft is chance, by some ms. Where it does not succeed, the
        block is merely of another moment.
        """
        near_ms, stamps = (period_ms - 1) // 4, self._stamps

        async def both() -> None:
            while not {0, number} <= stamps.keys():
                await asyncio.sleep(1e-3 * period_ms)

        for _ in range(STAGGER_TRIES):
            stamps.clear()
            try:
                async with asyncio.timeout(BLOCK_S):
                    await both()
            except TimeoutError as error:
                raise self._did_not("did not send what it was asked to log") from error
            off_ms = (stamps[number] - stamps[0]) % period_ms - period_ms // 2
            if abs(off_ms) <= near_ms:
                return
            await asyncio.sleep(1e-3 * random.uniform(0.0, 2.0 * period_ms))
            await self._set_period(period_ms, [block])

    async def _set_period(self, period_ms: int, blocks: Sequence[Any]) -> None:
        """Start blocks again, as close to each other as packets go, in ms: cflib itself
        starts one when the craft has confirmed it, and knows tens of ms only."""
        if self._protocol < 0:
            if period_ms % LEAST_CFLIB_MS:
                raise LinkError(
                    f"{self._uri}: this firmware logs every 10, 20, 30 ... ms only, not every"
                    f" {period_ms}; say --rate 100"
                )
            return
        craft, loop = self._craft(), asyncio.get_running_loop()
        answers: dict[int, asyncio.Future[int]] = {
            block.id: loop.create_future() for block in blocks
        }

        def heard(packet: Any) -> None:
            data = bytes(packet.data)
            if len(data) > 2 and data[0] == START_V2 and data[1] in answers:
                loop.call_soon_threadsafe(resolve, answers[data[1]], data[2])

        craft.add_header_callback(heard, *LOG_CONTROL)
        try:
            for _ in range(BEGIN_TRIES if answers else 0):
                for number in [each for each, answer in answers.items() if not answer.done()]:
                    data = bytes([START_V2, number]) + period_ms.to_bytes(2, "little")
                    craft.send_packet(crtp_packet(*LOG_CONTROL, data))
                await asyncio.wait(answers.values(), timeout=BLOCK_S / BEGIN_TRIES)
            for answer in answers.values():
                if not answer.done():
                    raise self._did_not("did not confirm the period of its log")
                error = answer.result()
                if error and period_ms % LEAST_CFLIB_MS:
                    raise LinkError(
                        f"{self._uri}: this firmware does not log every {period_ms} ms"
                        f" ({errno.errorcode.get(error, error)}); say --rate 100"
                    )
        finally:
            craft.remove_header_callback(heard, *LOG_CONTROL)

    def stop(self, craft: Any) -> None:
        """End all blocks of a craft that is about to be left; waits, so not on the event loop."""
        blocks = [*self._blocks, *self._watched, *self._half_made]
        self._blocks, self._watched, self._half_made = [], [], []
        if craft.link is None:
            return
        for block in blocks:
            block.stop()
        if blocks:
            threading.Event().wait(STOP_S)
        for block in blocks:
            block.delete()

    def _did_not(self, what: str) -> LinkError:
        return LinkError(f"{self._uri}: the craft {what} within {BLOCK_S:g} s")


CONNECT_S, FIRST_S, UDP_TRIES = 10.0, 3.0, 3
"""Until everything has been read; until the first questions are answered; how often they are asked
in that time over UDP, which may lose them."""
ANSWER_S, ASKED = 1.0, 4
"""For what a firmware may not know how to answer; how often it is asked in that time."""
CLOSE_S = 5.0

_PLATFORM, _VERSION = 13, 1
_FIRMWARE, _DEVICE = 1, 2

DEVICES = {
    "Crazyflie 2.1 Brushless": "brushless",
    "Crazyflie 2.1": "crazyflie21",
    "Crazyflie 2.0": "crazyflie21",
}
"""What the firmware calls itself -> vehicle profile. A 2.1+ calls itself 2.1."""

_ERROR_NAME = re.compile(r"^([\w.]+\.)?\w*(Error|Exception): ")
_UNHEARD = logging.NullHandler()


@dataclass(frozen=True, slots=True)
class Identity:
    """What the craft says of itself. protocol: -1 for a firmware that knows no versions."""

    protocol: int
    firmware: str
    device: str

    @property
    def vehicle(self) -> str:
        """Its profile, empty where it does not say."""
        return DEVICES.get(self.device, "") if self.protocol > 0 else "crazyflie1"


class Connection:
    """A craft by cflib, at most one connection at a time.

    on_lost: told, on the event loop, why the connection ended by itself. console: what the craft
    says. commanded: setpoints went through it, so that closing stops the motors, as cflib does.
    blocks: what it logs.
    """

    def __init__(self, uri: str) -> None:
        if not is_address(uri):
            raise BadInputError(f"{uri!r} is no address of a craft: give {ADDRESSES}")
        try:
            import cflib.crtp
            from cflib.crazyflie import Crazyflie
        except ImportError as error:
            raise BadInputError(f"{uri} needs cflib: {HINT}") from error
        if not cflib.crtp.CLASSES:  # each call would add them again
            cflib.crtp.init_drivers()
        # its warnings come to us as calls too; without a handler they are printed with tracebacks
        logging.getLogger("cflib").addHandler(_UNHEARD)
        self.uri = uri
        self.commanded = False
        self.on_lost: list[Callable[[str], None]] = []
        self.console = Console()
        self._new_craft: Callable[[], Any] = lambda: Crazyflie(rw_cache=str(_cache_folder()))
        self._craft: Any = None
        self._hush: Callable[[], None] = lambda: None
        self._complete: asyncio.Future[bool] | None = None
        self._identity: Identity | None = None
        self.blocks = LogBlocks(uri, lambda: self.craft)

    @property
    def craft(self) -> Any:
        """cflib's object. Raises LinkError where nothing is connected."""
        if self._craft is None:
            raise LinkError(f"{self.uri} is not connected")
        return self._craft

    @property
    def is_open(self) -> bool:
        return self._craft is not None

    @property
    def protocol(self) -> int:
        """Version of CRTP that the craft speaks, -1 for one that knows no versions."""
        return protocol_of(self.craft)

    def send(self, port: int, channel: int, data: bytes) -> None:
        """Send one packet that nothing answers."""
        self.craft.send_packet(crtp_packet(port, channel, data))

    async def open(self) -> None:
        """Connect, until the tables of contents are known. Raises LinkError."""
        tries = UDP_TRIES if self.uri.startswith("udp://") else 1
        for left in reversed(range(tries)):
            try:
                await self._open(FIRST_S / tries)
                return
            except TimeoutError as error:
                if not left:
                    raise LinkError(
                        f"{self.uri}: no craft answered within {FIRST_S:g} s"
                    ) from error

    async def _open(self, patience_s: float) -> None:
        """Connect; TimeoutError where the first questions are not answered."""
        loop = asyncio.get_running_loop()
        ready: asyncio.Future[None] = loop.create_future()
        heard: asyncio.Future[None] = loop.create_future()
        complete: asyncio.Future[bool] = loop.create_future()
        craft = self._craft = self._new_craft()
        self._hush = ask_again(craft, self.uri)
        begin_once(craft)
        self._complete, self.commanded, self._identity = complete, False, None
        self.console.end()

        def call(function: Callable[..., None], *arguments: Any) -> None:
            with contextlib.suppress(RuntimeError):  # cflib's threads may outlast the loop
                loop.call_soon_threadsafe(function, *arguments)

        def tell(future: asyncio.Future[Any], result: Any = None) -> None:
            call(resolve, future, result)

        def failed(uri: str, reason: str = "") -> None:
            tell(ready, LinkError(f"{self.uri}: {_explained(reason)}"))

        def lost(uri: str, reason: str = "") -> None:
            failed(uri, reason)
            call(self._lose, craft, _explained(reason))

        def hear(packet: Any) -> None:
            if not heard.done():
                tell(heard)

        # cflib asks once only what it speaks with, and then how to log, again and again
        craft.add_header_callback(hear, *LOG_CONTROL)
        craft.connected.add_callback(lambda uri: tell(ready))
        craft.fully_connected.add_callback(lambda uri: tell(complete, True))
        craft.connection_failed.add_callback(failed)
        craft.connection_lost.add_callback(lost)
        craft.console.receivedChar.add_callback(self.console.feed)
        stop_pings = craft.link_statistics.stop
        # it joins the thread of the pings, and fails, silently for us, where a ping finds the craft
        # gone: nobody is told of the loss then
        craft.link_statistics.stop = lambda: elsewhere(stop_pings)
        try:
            # cflib blocks here while it opens the radio
            await asyncio.to_thread(craft.open_link, self.uri)
            first = asyncio.FIRST_COMPLETED
            done, _ = await asyncio.wait((heard, ready), timeout=patience_s, return_when=first)
            if not done:
                ready.cancel()
                raise TimeoutError
            try:
                async with asyncio.timeout(CONNECT_S):
                    await ready
            except TimeoutError as error:
                raise LinkError(
                    f"{self.uri}: the craft answered, and did not say within {CONNECT_S:g} s what"
                    " it can log"
                ) from error
        except BaseException:
            await self.close()
            raise

    async def complete(self) -> None:
        """Wait until every parameter has been read. Raises LinkError."""
        if self._complete is None:
            raise LinkError(f"{self.uri} is not connected")
        try:
            async with asyncio.timeout(CONNECT_S):
                is_complete = await asyncio.shield(self._complete)
        except TimeoutError as error:
            raise LinkError(
                f"{self.uri}: not all parameters could be read within {CONNECT_S:g} s"
            ) from error
        if not is_complete:
            raise LinkError(f"{self.uri}: the connection was closed")

    async def close(self) -> None:
        """Disconnect. Safe to call twice."""
        craft, self._craft = self._craft, None
        if self._complete is not None:
            resolve(self._complete, False)
            self._complete = None
        if craft is not None:
            # cflib locks itself up where the craft vanishes while something is being sent
            hush = self._hush
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_S):
                    await in_background(lambda: self._disconnect(craft, hush))

    def _disconnect(self, craft: Any, hush: Callable[[], None]) -> None:
        self.blocks.stop(craft)
        if self.commanded and craft.link is not None:
            craft.commander.send_setpoint(0, 0, 0, 0)
        # cflib would send zero thrust, which who only listens has no business to
        hush()
        craft.close_link()

    async def identify(self) -> Identity:
        """What the craft calls itself; empty where it does not say. It is asked once."""
        if self._identity is None:
            protocol, said = self.protocol, ["", ""]
            if protocol >= 0:
                asked = (bytes([_FIRMWARE]), bytes([_DEVICE]))
                answers = [await self.ask(_PLATFORM, _VERSION, what) for what in asked]
                said = [(one or b"").rstrip(b"\0").decode("utf-8", "replace") for one in answers]
            self._identity = Identity(protocol, *said)
        return self._identity

    async def ask(
        self, port: int, channel: int, request: bytes, patience_s: float = ANSWER_S
    ) -> bytes | None:
        """What the answer to a request has behind the request's own bytes, which it repeats; None
        where none comes."""
        craft, loop = self.craft, asyncio.get_running_loop()
        answer: asyncio.Future[bytes] = loop.create_future()

        def heard(packet: Any) -> None:
            data = bytes(packet.data)
            if data.startswith(request):
                loop.call_soon_threadsafe(resolve, answer, data[len(request) :])

        craft.add_header_callback(heard, port, channel)
        try:
            for _ in range(ASKED):  # not by cflib, which asks for ever what a craft does not know
                craft.send_packet(crtp_packet(port, channel, request))
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(patience_s / ASKED):
                        return await asyncio.shield(answer)
            return None
        finally:
            craft.remove_header_callback(heard, port, channel)

    def storage(self) -> ParameterStorage | None:
        """What the craft keeps of its parameters while it is switched off; None where its firmware
        keeps none."""
        numbers = {
            f"{group}.{name}": (element.ident, element.pytype)
            for group, elements in self.craft.param.toc.toc.items()
            for name, element in elements.items()
            if element.is_persistent()
        }
        return ParameterStorage(self.uri, numbers, partial(self.ask, *MISC)) if numbers else None

    def variables(self) -> dict[str, str]:
        """What the craft can log: full name -> type."""
        return {
            f"{group}.{name}": element.ctype
            for group, elements in self.craft.log.toc.toc.items()
            for name, element in elements.items()
        }

    def _lose(self, craft: Any, reason: str) -> None:
        if craft is self._craft:
            for tell in self.on_lost:
                tell(reason)


def _explained(reason: str) -> str:
    """One line of what cflib says, which may be a traceback, and what to do."""
    lines = [line.strip() for line in reason.splitlines() if line.strip()]
    line = lines[0] if lines else "connection lost"
    if "Traceback" in reason:
        line = lines[-1]
    line = _ERROR_NAME.sub("", line)
    lowered = reason.lower()
    if "could not open usb" in lowered:
        return (
            f"{line}: no Crazyflie is on the cable, it is off, or there is no permission;"
            " 'groundstation install udev --print' shows the rule"
        )
    if "gaierror" in lowered:
        return "no such host"
    if "access" in lowered or "permission" in lowered:
        return f"{line}: no permission; 'groundstation install udev --print' shows the rule"
    if "busy" in lowered:
        return f"{line}: the dongle is in use by another program"
    if "cannot find" in lowered and "dongle" in lowered:
        return f"{line}: no Crazyradio is plugged in, or it is in use by another program"
    if "refused" in lowered:
        return "refused: nothing serves there"
    return line


def _cache_folder() -> Path:
    """Where cflib keeps tables of contents by their checksum, so that they are read once."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "groundstation" / "crazyflie"


# Where a craft says that it is, by a log block of its own: for whoever lands it, at once, and as a
# table for the recording.


PLACE_MS = 40
"""Between two of them: 25 a second, 18 bytes each."""
TABLE = "state"
"""The series of a recording that holds them."""
THRUST = "stabilizer.thrust"
"""What the controller asks of the motors: beside their duty it shows how thrust becomes voltage."""


async def watch_place(
    connection: Connection,
    clock: HostClock,
    on_place: Callable[[Place], None],
    on_table: Callable[[LogTable], None],
) -> None:
    """Let the craft say where it is, where its firmware lists that. Raises LinkError where it
    refuses.

    on_place: told at once, from cflib's thread, so that a landing needs no event loop.
    on_table: told on this loop.
    """
    listed = connection.variables()
    if not set(PLACE) <= listed.keys():
        return
    loop, time_ms = asyncio.get_running_loop(), -1

    def take(stamp: int, said: dict[str, float]) -> None:
        nonlocal time_ms
        time_ms = stamp if time_ms < 0 else time_ms + (stamp - time_ms) % WRAP_MS
        on_place(Place.of(said, time.monotonic(), 1e-3 * time_ms))
        columns = {name: np.array([value], np.float64) for name, value in said.items()}
        rows = LogTable(TABLE, np.array([clock()]), np.array([1e-3 * time_ms]), columns)
        with contextlib.suppress(RuntimeError):  # cflib's threads may outlast the loop
            loop.call_soon_threadsafe(on_table, rows)

    halves = [(name, "FP16") for name in (*PLACE, *LEAN, THRUST) if name in listed]
    await connection.blocks.watch("place", halves, PLACE_MS, take)
