"""The software craft as a link. The only module that knows ``firmware_sim``."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import msgspec
import numpy as np

from groundstation.background import in_background
from groundstation.compiling import announced
from groundstation.documents import explained
from groundstation.errors import BadInputError, TakenError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.command import HostClock, udp_address
from groundstation.telemetry.samples import RawBatch

BATCH_S = 0.01
"""Simulated time per batch."""
FAST_BATCH_S = 5.0
LOOK_S = 0.5
"""How often it is said what the craft does."""
LOW_POWER = 3
"""The firmware's power state after some seconds of low voltage."""
CATCH_UP_S = 2.0
"""A process stalled for longer than this has missed what the craft sent meanwhile."""


def make(options: LinkOptions) -> Link:
    """Flies the settings, or with an argument that model and nothing else."""
    settings = dict(options.stand_in)
    if options.argument:
        settings |= {"plant": "model", "craft": options.model or options.argument, "effects": {}}
    return StandInLink(
        settings,
        name=options.name,
        speed=options.speed,
        crtp=udp_address(options.command),
        clock=options.clock,
    )


class StandInLink(Link):
    """Flies a ``firmware_sim.StandIn`` and delivers what its bridge forwards.

    options: settings of the stand-in, as in the configuration's ``[stand_in]`` table.
    name: ``stand-in:MODEL`` where it flies a fitted model.
    speed: 1 for real time, ``inf`` for as fast as the reader takes batches. The host stamps
        keep simulated spacing at any speed. Faster than real time the craft waits for a
        stalled process; in real time it flies on unheard, as a real one would.
    crtp: host and UDP port on which the craft answers clients of the official library.
    """

    def __init__(
        self,
        options: dict[str, Any],
        *,
        name: str = "stand-in",
        speed: float = 1.0,
        crtp: tuple[str, int] | None = None,
        clock: HostClock | None = None,
    ) -> None:
        super().__init__(name, clock=clock)
        if not speed > 0:
            raise BadInputError(f"stand-in speed {speed:g}: must be greater than 0 (or 'max')")
        from firmware_sim.settings import StandInSettings

        try:
            self._settings = msgspec.convert(options, StandInSettings)
        except msgspec.ValidationError as error:
            raise BadInputError(
                f"configuration [stand_in]: {explained(error, StandInSettings)}"
            ) from error
        self.speed = speed
        self.silence_s = 2.0
        self._step_s = FAST_BATCH_S if speed == float("inf") else BATCH_S * max(1.0, speed)
        self._crtp = crtp
        self._server: Any = None
        self._craft: Any = None
        self._stored: dict[str, float] = {}  # what the craft keeps while it is switched off
        self._powered = True
        self._off_s = self._look_s = 0.0  # of simulated time
        self._flown_s = self._target_s = self._heard_from_s = 0.0
        self._origin_ns = 0
        self._due_s = 0.0
        self._flight: asyncio.Future[Any] | None = None

    async def _open(self) -> None:
        self.doing, self.pauses = "preparing the simulator", True
        try:
            async with announced(self._tell_of_compiling):
                self._craft = await in_background(self._power_on)
        finally:
            self.doing, self.pauses = "", False
        self.vehicle = self._craft.profile
        if self._craft.added_by_plant:
            self.emit("plant", self._craft.added_by_plant)
        await self.serve()
        self._flown_s = self._look_s = 0.0
        self._flight = None
        self._origin_ns = self.clock()
        # a batch is due when its last packet has arrived: a stamp is never from the future
        self._due_s = time.monotonic() + self._step_s / self.speed

    async def serve_at(self, address: tuple[str, int]) -> None:
        """Answer at another host and port from now on. Raises TakenError, answering where it did
        before."""
        before, self._crtp = self._crtp, address
        if address == before:
            return
        await self.serve_no_more()
        try:
            await self.serve()
        except BaseException:
            self._crtp = before
            await self.serve()
            raise

    async def serve(self) -> None:
        """Answer clients of the official library, where a port was given. Raises TakenError."""
        if self._crtp is None or self._server is not None or self._craft is None:
            return
        from firmware_sim.crtp import CrtpServer

        host, port = self._crtp
        server = CrtpServer(self._craft, host, port)
        try:
            await server.start()
        except OSError as error:
            raise TakenError(
                f"command port {host}:{port} of the stand-in: {error}; with --link stand-in"
                " --command serves that port: choose a free one"
            ) from error
        self._server = server

    async def serve_no_more(self) -> None:
        """Give the port back, for the stand-in that takes over. Safe to call twice."""
        server, self._server = self._server, None
        if server is not None:
            await server.close()

    def _tell_of_compiling(self) -> None:
        self.doing = "preparing the simulator, first start only"
        self.emit("preparing", f"{self.doing}: its flight model is compiled once per machine")

    def _power_on(self) -> Any:
        from firmware_sim.craft import StandIn

        try:
            craft = StandIn(self._settings, self._stored)
            # compiles on a machine's first run, which must not look like a silent link
            craft.advance(0.0)
        except (ValueError, OSError) as error:
            where = "configuration [stand_in]" if self.name == "stand-in" else f"link {self.name}"
            raise BadInputError(f"{where}: {error}") from error
        return craft

    async def _read(self) -> RawBatch:
        while True:
            if self._flight is None:
                wait_s = self._due_s - time.monotonic()
                if wait_s > 0:
                    await asyncio.sleep(wait_s)
                self._heard_from_s = self._flown_s + self._unheard_s()
                self._target_s = self._heard_from_s + self._step_s
                self._due_s += self._step_s / self.speed
                self._flight = asyncio.get_running_loop().run_in_executor(
                    None, self._craft.advance, self._target_s
                )
            # shielded: a cancelled read leaves the flight for the next one, losing nothing
            packets, arrival_s = await asyncio.shield(self._flight)
            self._flight = None
            self._flown_s = self._target_s
            self._tell_of_cell()
            if self._flown_s >= self._look_s:
                self._look_s = self._flown_s + LOOK_S
                self.doing = self._words()
            heard = arrival_s >= self._heard_from_s
            if heard.any():
                stamps = self._origin_ns + np.rint(arrival_s[heard] * 1e9).astype(np.int64)
                return RawBatch(packets[heard], stamps)

    def _tell_of_cell(self) -> None:
        """An empty cell is part of the flight, not a fault of the link."""
        before, self._powered = self._powered, self._craft.powered
        self.pauses = not self._powered
        if before and not self._powered:
            self._off_s = self._flown_s
            self.emit("battery", "the simulated cell is empty: a charged one is plugged in soon")
        elif self._powered and not before:
            self.emit(
                "battery", f"a charged cell was plugged in, number {self._craft.state().boots}"
            )

    def _words(self) -> str:
        """What the craft does."""
        if not self._powered:
            left_s = max(0.0, self._settings.recharge_s - (self._flown_s - self._off_s))
            return f"its battery is changed: it is back in {left_s:.0f} s"
        state = self._craft.state()
        if not any(state.motors):
            return f"it stands, with battery {state.boots}"
        if state.power_state == LOW_POWER:
            return f"it lands, for battery {state.boots} is low"
        return f"it flies, with battery {state.boots}"

    def _unheard_s(self) -> float:
        """Simulated time to fly without listening, after a stall."""
        behind_s = time.monotonic() - self._due_s
        if behind_s <= CATCH_UP_S or self.speed == float("inf"):
            return 0.0
        self._due_s += behind_s
        if self.speed > 1.0:
            return 0.0
        self.emit(
            "loss",
            f"this program stood still for {behind_s:.1f} s: what the craft sent"
            " meanwhile is lost, as on a real link",
        )
        return behind_s * self.speed

    async def _close(self) -> None:
        if self._flight is not None:
            await asyncio.wait([self._flight])
        await self.serve_no_more()
        self._craft = self._flight = None
        self.doing, self.pauses = "", False
