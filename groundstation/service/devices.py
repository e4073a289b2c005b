"""What is plugged in or in reach, looked for in a process of its own: drivers block, or crash."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import msgspec

from groundstation.errors import GroundStationError
from groundstation.service.commands import run_command

FRESH_S = 5.0
"""Asked again within so long, the answer is the one before: each look costs a second."""
PATIENCE_S = 30.0


class Device(msgspec.Struct, frozen=True, kw_only=True):
    """link: the name that a telemetry link has there, None where there is none. why: it is not
    usable."""

    kind: str
    name: str
    link: str | None
    description: str
    usable: bool
    why: str


class Devices(msgspec.Struct, frozen=True, kw_only=True):
    """usb_problem: why USB devices, or craft, could not be looked for."""

    devices: list[Device]
    usb_problem: str | None


class DeviceList:
    """Asks ``groundstation devices``. busy: whether a craft is reached by a dongle, which is then
    left alone."""

    def __init__(self, busy: Callable[[], bool]) -> None:
        self._busy = busy
        self._looking = asyncio.Lock()
        self._found: Devices | None = None
        self._found_s = 0.0

    async def look(self) -> Devices:
        """Raises GroundStationError where it cannot be told."""
        async with self._looking:
            if self._found is None or time.monotonic() - self._found_s > FRESH_S:
                self._found = await self._ask()
                self._found_s = time.monotonic()
            return self._found

    async def _ask(self) -> Devices:
        away = ["--no-craft"] if self._busy() else []
        status, out, said = await run_command("devices", "--json", *away, patience_s=PATIENCE_S)
        if status:
            raise GroundStationError(f"devices: {said}")
        return msgspec.json.decode(out, type=Devices)
