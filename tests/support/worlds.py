"""Software crafts, their command links and an event loop on a clock that the test turns.

The firmware, its supervisor and the motors are the stand-in's own, the link's outbox is the real
one; what is left out is cflib and the radio, which other tests have.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass

from firmware_sim.craft import StandIn
from firmware_sim.crtp import supervisor_bits
from firmware_sim.settings import StandInSettings
from groundstation.errors import LinkError
from groundstation.links.command import LIFE_S, CommandLink, CommandState
from groundstation.links.crazyflie import STATE_S
from groundstation.links.outbox import Outbox
from groundstation.links.supervisor import Supervisor
from groundstation.service.motor_stop import Motors

STEP_S, SAYS_S = 0.05, 0.1
"""How finely time passes; how often the craft says what state it is in."""


@dataclass(frozen=True)
class Delivered:
    """What reached a craft: thrust, or 1 and 0 for arm and disarm. handed_s: when it was handed to
    its link. level: whether no angle was asked for."""

    kind: str
    value: int
    at_s: float
    handed_s: float
    level: bool = True


class CraftInHand(CommandLink):
    """A craft and the link to it. stalls: the radio takes nothing. deaf: no telemetry comes.
    held: the thrust that somebody else gives it, whoever stops it here. loses: so many of the next
    requests are lost on their way."""

    settles_s = 2.5

    def __init__(self, uri: str, world: World, craft: str) -> None:
        super().__init__(uri)
        self.monotonic = lambda: world.now_s
        self.world, self._kind = world, craft
        self.delivered: list[Delivered] = []
        self.stalls = self.deaf = False
        self.held = self.loses = 0
        self.switch_on()

    def switch_on(self) -> None:
        """Again, too: what it was told before is forgotten."""
        settings = {"plant": "reduced", "program": "wait", "resume_s": 1e6, "protocol": 12}
        self.craft = StandIn(StandInSettings(craft=self._kind, **settings))
        self.craft.advance(3.0)
        self._begun_s, self._said_s = self.world.now_s, self.world.now_s - SAYS_S
        self._heard: Motors | None = None
        self._heard_s = -1.0
        self.connect()

    def connect(self) -> None:
        self.outbox = Outbox(self._unlock, clock=self.monotonic)
        self.armed, self.supervisor, self._asked_armed = None, Supervisor(), False
        self._asked_s = -STATE_S
        self.state = CommandState.CONNECTED

    def lose(self) -> None:
        self.armed, self.supervisor = None, Supervisor()
        self.state = CommandState.LOST

    @property
    def turns(self) -> bool:
        """Whether the firmware drives a rotor, in truth."""
        return any(self.craft.state().motors)

    def pass_time(self, to_s: float) -> None:
        if not self.stalls and self.state is CommandState.CONNECTED:
            self.outbox.send()
        if self.held:
            self.craft.command(0.0, 0.0, 0.0, self.held)
        self.craft.advance(3.0 + to_s - self._begun_s)
        state = self.craft.state()
        if self.state is CommandState.CONNECTED and not self.deaf:
            self._heard, self._heard_s = Motors(0.0, max(state.motors) / 65535), to_s
            if to_s >= self._said_s + SAYS_S:
                self._said_s = to_s
                self.supervisor = Supervisor(supervisor_bits(state))
                if to_s >= self._asked_s + STATE_S:
                    self.armed = self.supervisor.armed

    def motors(self) -> Motors | None:
        heard = self._heard
        return None if heard is None else Motors(self.world.now_s - self._heard_s, heard.duty)

    @property
    def disarms_in_flight(self) -> bool:
        may_be_armed = self.supervisor.armed is not False or self._asked_armed
        return may_be_armed and not self.supervisor.arms_itself

    def arm(self, armed: bool) -> bool:
        self._require()
        self._asked_armed, self.armed, self._asked_s = armed, None, self.world.now_s
        if not armed:
            self.withdraw_arming()
        self._request("arm", int(armed), lambda: self.craft.arm(armed), arms=armed)
        return True

    def withdraw_arming(self) -> None:
        self.outbox.withdraw_arming()

    def emergency_stop(self) -> bool:
        self._require()
        self._request("emergency stop", 1, self.craft.emergency_stop)
        return True

    async def open(self) -> None:
        self.connect()

    async def close(self) -> None:
        self.withdraw_arming()
        if self.state is CommandState.CONNECTED and not self.stalls:
            self.outbox.send()
        self.state = CommandState.CLOSED

    def parameters(self) -> dict[str, float]:
        return {}

    def _send_setpoint(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int, until_s: float
    ) -> None:
        self._require()
        handed_s = self.world.now_s

        def send() -> None:
            self._note("setpoint", thrust, handed_s, level=roll_deg == pitch_deg == 0.0)
            self.craft.command(roll_deg, -pitch_deg, -yaw_dps, thrust)

        self.superseded += self.outbox.put(send, until_s)

    async def _write_parameter(self, name: str, value: float) -> float:
        raise NotImplementedError

    def _whole_range(self, name: str) -> None:
        return None

    def _require(self) -> None:
        if self.state is not CommandState.CONNECTED:
            raise LinkError(f"{self.uri} is not connected ({self.state.value})")

    def _unlock(self) -> None:
        self.craft.command(0.0, 0.0, 0.0, 0)

    def _request(
        self, kind: str, value: int, send: Callable[[], object], *, arms: bool = False
    ) -> None:
        handed_s = self.world.now_s

        def sent() -> None:
            self._note(kind, value, handed_s)
            if self.loses:
                self.loses -= 1
            else:
                send()

        self.outbox.request(sent, until_s=handed_s + LIFE_S if arms else math.inf, arms=arms)

    def _note(self, kind: str, value: int, handed_s: float, *, level: bool = True) -> None:
        self.delivered.append(Delivered(kind, value, self.world.now_s, handed_s, level))


class World(asyncio.SelectorEventLoop):
    """An event loop in whose waits time passes for the crafts, as fast as they can be computed."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.crafts: list[CraftInHand] = []
        super().__init__()
        select = self._selector.select

        def pass_instead(timeout: float | None = None) -> list:
            found = select(0)
            if not found and timeout:
                self.pass_time(timeout)
            return found

        self._selector.select = pass_instead

    def time(self) -> float:
        return self.now_s

    def craft(self, name: str, kind: str) -> CraftInHand:
        self.crafts.append(CraftInHand(f"udp://{name}", self, kind))
        return self.crafts[-1]

    def pass_time(self, seconds: float) -> None:
        """It passes for the crafts and their radios, and nothing in the loop runs meanwhile."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s = min(self.now_s + STEP_S, end_s)
            for craft in self.crafts:
                craft.pass_time(self.now_s)
