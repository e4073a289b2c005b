"""Commands through the official client library: ``udp://`` to a stand-in, ``radio://`` to a craft.

The only module that imports cflib, which is GPLv3 and an optional extra:
``pip install groundstation[radio]``.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from groundstation.clock import HostClock
from groundstation.errors import BadInputError, LinkError
from groundstation.links.command import CommandLink, CommandState

CONNECT_S = 10.0
CONFIRM_S = 2.0
SEND_S = 2.5
"""cflib waits 2 s for a radio that takes nothing."""
_WHOLE = {
    "uint8_t": (0, 255),
    "int8_t": (-128, 127),
    "uint16_t": (0, 65535),
    "int16_t": (-32768, 32767),
    "uint32_t": (0, 2**32 - 1),
    "int32_t": (-(2**31), 2**31 - 1),
}


class CrazyflieLink(CommandLink):
    """One Crazyflie, or stand-in, by cflib."""

    def __init__(self, uri: str, *, clock: HostClock | None = None) -> None:
        super().__init__(uri, clock=clock)
        try:
            import cflib.crtp
            from cflib.crazyflie import Crazyflie
        except ImportError as error:
            raise BadInputError(
                f"--command {uri} needs cflib: install it with pip install 'groundstation[radio]'"
            ) from error
        cflib.crtp.init_drivers()
        if not uri.startswith(("udp://", "radio://", "usb://")):
            raise BadInputError(
                f"command link {uri!r} is not known: udp://HOST:PORT or radio://..."
            )
        cache = _cache_folder()
        self._new_craft: Callable[[], Any] = lambda: Crazyflie(rw_cache=str(cache))
        self._craft: Any = None
        self._sender: _Sender | None = None

    async def open(self) -> None:
        loop = asyncio.get_running_loop()
        ready: asyncio.Future[None] = loop.create_future()
        self._enter(CommandState.CONNECTING, f"connecting to {self.uri}")
        craft = self._craft = self._new_craft()

        def connected(uri: str) -> None:
            loop.call_soon_threadsafe(_resolve, ready, None)

        def failed(uri: str, reason: str = "") -> None:
            loop.call_soon_threadsafe(_resolve, ready, LinkError(f"{self.uri}: {reason}"))

        def lost(uri: str, reason: str = "") -> None:
            loop.call_soon_threadsafe(self._enter, CommandState.LOST, reason or "connection lost")

        craft.fully_connected.add_callback(connected)
        craft.connection_failed.add_callback(failed)
        craft.connection_lost.add_callback(lost)
        try:
            # cflib blocks here while it opens the radio
            await asyncio.to_thread(craft.open_link, self.uri)
            async with asyncio.timeout(CONNECT_S):
                await ready
        except (TimeoutError, LinkError) as error:
            await self.close()
            text = str(error) or f"{self.uri}: no craft answered within {CONNECT_S:g} s"
            raise LinkError(text) from error
        self._sender = _Sender(craft)
        self._enter(CommandState.CONNECTED, f"connected, {len(self.parameters())} parameters")

    async def close(self) -> None:
        craft, self._craft = self._craft, None
        sender, self._sender = self._sender, None
        if sender is not None:
            await asyncio.to_thread(sender.close)
        if craft is not None:
            await asyncio.to_thread(craft.close_link)
        self._enter(CommandState.CLOSED, "closed")

    def parameters(self) -> dict[str, float]:
        if self._craft is None:
            return {}
        return {
            f"{group}.{name}": float(value)
            for group, values in self._craft.param.values.items()
            for name, value in values.items()
        }

    def _send_setpoint(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int
    ) -> None:
        self._connected()
        assert self._sender is not None
        # cflib turns pitch round by itself, from nose down to the firmware's nose up
        self.superseded += self._sender.send((roll_deg, pitch_deg, -yaw_dps, thrust))

    async def _write_parameter(self, name: str, value: float) -> float:
        craft = self._connected()
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[float] = loop.create_future()
        group, short = name.split(".", 1)

        def updated(complete_name: str, text: str) -> None:
            loop.call_soon_threadsafe(_resolve, answer, float(text))

        craft.param.add_update_callback(group=group, name=short, cb=updated)
        try:
            craft.param.set_value(name, value)
            async with asyncio.timeout(CONFIRM_S):
                return await answer
        except TimeoutError as error:
            raise LinkError(f"{self.uri}: parameter {name} was not confirmed") from error
        finally:
            craft.param.remove_update_callback(group, short, updated)

    def _whole_range(self, name: str) -> tuple[int, int] | None:
        craft = self._connected()
        element = craft.param.toc.get_element_by_complete_name(name)
        if element.access == element.RO_ACCESS:
            raise BadInputError(f"parameter {name} can only be read")
        return _WHOLE.get(element.ctype)

    def _connected(self) -> Any:
        if self._craft is None or self.state is not CommandState.CONNECTED:
            raise LinkError(f"{self.uri} is not connected ({self.state.value})")
        return self._craft


class _Sender:
    """Hands setpoints to cflib from a thread of its own, for a radio may block for seconds.

    Holds one setpoint: a newer one replaces it, for an old one is worth nothing.
    """

    def __init__(self, craft: Any) -> None:
        self._craft = craft
        self._next: tuple[float, float, float, int] | None = None
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="setpoints", daemon=True)
        self._thread.start()

    def send(self, setpoint: tuple[float, float, float, int]) -> bool:
        """Whether it replaced one that had not been sent."""
        with self._changed:
            replaced = self._next is not None
            self._next = setpoint
            self._changed.notify()
        return replaced

    def close(self) -> None:
        """Send what waits, if the radio takes it soon, and end."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(SEND_S)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._next is not None or self._closing)
                setpoint, self._next = self._next, None
            if setpoint is None:
                return
            self._craft.commander.send_setpoint(*setpoint)


def _cache_folder() -> Path:
    """Where cflib keeps tables of contents by their checksum, so that they are read once."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "groundstation" / "crazyflie"


def _resolve(future: asyncio.Future[Any], result: Any) -> None:
    """Set a future once, from whichever callback comes first."""
    if future.done():
        return
    if isinstance(result, Exception):
        future.set_exception(result)
    else:
        future.set_result(result)
