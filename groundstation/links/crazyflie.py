"""Commands through the official client library: ``udp://`` to a stand-in, ``radio://`` to a craft.

The only module that imports cflib, which is GPLv3 and an optional extra:
``pip install groundstation[radio]``.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from groundstation.clock import HostClock
from groundstation.errors import BadInputError, LinkError
from groundstation.links.command import CommandLink, CommandState

CONNECT_S = 10.0
CONFIRM_S = 2.0


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
        self._enter(CommandState.CONNECTED, f"connected, {len(self.parameters())} parameters")

    async def close(self) -> None:
        craft, self._craft = self._craft, None
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
        self._connected().commander.send_setpoint(roll_deg, pitch_deg, yaw_dps, thrust)

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

    def _connected(self) -> Any:
        if self._craft is None or self.state is not CommandState.CONNECTED:
            raise LinkError(f"{self.uri} is not connected ({self.state.value})")
        return self._craft


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
