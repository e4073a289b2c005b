"""One connection to one Crazyflie, for telemetry and commands alike.

cflib, which is GPLv3 and an optional extra, calls back from threads of its own; what they say
reaches the event loop here or through the callables given.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from groundstation.background import in_background
from groundstation.errors import BadInputError, LinkError
from groundstation.links.cflib_calls import (
    LOG_CONTROL,
    ask_again,
    begin_once,
    crtp_packet,
    elsewhere,
    protocol_of,
    resolve,
)
from groundstation.links.craft_address import ADDRESSES, HINT, is_address
from groundstation.links.craft_console import Console
from groundstation.links.log_blocks import LogBlocks
from groundstation.links.parameter_storage import MISC, ParameterStorage

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
            if not await _either(heard, ready, patience_s):
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


async def _either(one: asyncio.Future[Any], other: asyncio.Future[Any], patience_s: float) -> bool:
    """Whether one of them came in that time."""
    done, _ = await asyncio.wait(
        (one, other), timeout=patience_s, return_when=asyncio.FIRST_COMPLETED
    )
    return bool(done)
