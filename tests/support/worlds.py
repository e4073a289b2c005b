"""Software crafts, their command links and an event loop on a clock that the test turns; and a real
station with its control API in a thread.

The firmware, its supervisor and the motors are the stand-in's own, the link's outbox is the real
one; what is left out is cflib and the radio, which other tests have.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from firmware_sim.contents import EXTENDED, contents_of, misc_answer
from firmware_sim.craft import CraftState, StandIn
from firmware_sim.crtp import supervisor_bits
from firmware_sim.settings import StandInSettings
from groundstation.background import left_behind
from groundstation.errors import LinkError
from groundstation.links.base import LinkState
from groundstation.links.command import (
    LIFE_S,
    CommandLink,
    CommandState,
    ParameterStorage,
    Place,
    Supervisor,
)
from groundstation.links.crazyflie import STATE_S, Outbox
from groundstation.service.commander import WATCH_S, Commander
from groundstation.service.config import (
    Config,
    ControlSocket,
    FailsafeConfig,
    LinkConfig,
    RecordingConfig,
)
from groundstation.service.control import ControlServer
from groundstation.service.lease import Motors
from groundstation.service.parameters import Changes
from groundstation.service.station import Station

T = TypeVar("T")
HOVER = 40000
"""Thrust, about."""
GAINS = ("pid_rate.roll_kp", "pid_rate.pitch_kp", "pid_rate.yaw_kp")
"""The parameters that these crafts list."""
STEP_S, SAYS_S = 0.05, 0.1
"""How finely time passes; how often the craft says what state it is in."""


@dataclass(frozen=True)
class Delivered:
    """What reached a craft: thrust, or 1 and 0 for arm and disarm. handed_s: when it was handed to
    its link. level: whether no angle was asked for. height_m: in the place of thrust. hovers:
    whether it is asked for a velocity, in the place of an attitude."""

    kind: str
    value: int
    at_s: float
    handed_s: float
    level: bool = True
    height_m: float | None = None
    hovers: bool = False

    @property
    def flies(self) -> bool:
        return self.kind == "setpoint" and (self.value > 0 or self.height_m is not None)


class CraftInHand(CommandLink):
    """A craft and the link to it. deck: of its settings, by which it knows its height. stalls: the
    radio takes nothing. deaf: no telemetry comes. held: the thrust that somebody else gives it,
    whoever stops it here. loses: so many of the next requests are lost on their way. number: the
    craft's own. refuses: it confirms no parameter. asked: commands about stored ones, and whether
    a rotor was driven then."""

    settles_s = 2.5
    number = ""
    refuses = False

    def __init__(self, uri: str, world: World, craft: str, deck: str = "") -> None:
        super().__init__(uri)
        self.monotonic = lambda: world.now_s
        self.world, self._kind, self._deck = world, craft, deck
        self.delivered: list[Delivered] = []
        self.stalls = self.deaf = False
        self.held = self.loses = 0
        self.stored: dict[str, float] = {}
        self.asked: list[tuple[int, bool]] = []
        self.switch_on()

    def switch_on(self) -> None:
        """Again, too: what it was told before is forgotten, but for what it has stored."""
        settings = {"plant": "reduced", "program": "wait", "resume_s": 1e6, "protocol": 12}
        deck = {self._deck: True} if self._deck else {}
        self.craft = StandIn(StandInSettings(craft=self._kind, **settings, **deck), self.stored)
        self.craft.advance(3.0)
        self._begun_s, self._said_s = self.world.now_s, self.world.now_s - SAYS_S
        self._heard: Motors | None = None
        self._heard_s = -1.0
        self.connect()

    def connect(self) -> None:
        self.outbox = Outbox(self._unlock, clock=self.monotonic)
        self.armed, self.supervisor, self._asked_armed = None, Supervisor(), False
        self._asked_s = -STATE_S
        self._listed = contents_of(self.craft).parameters
        numbers = {name: (number, "<f") for number, (name, kind) in enumerate(self._listed)
                   if kind & EXTENDED and name in GAINS}  # fmt: skip
        self.storage = ParameterStorage(self.uri, numbers, self._asked) if numbers else None
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
            self.supervisor = replace(self.supervisor, place=self._place(state))
            if to_s >= self._said_s + SAYS_S:
                self._said_s = to_s
                self.supervisor = replace(self.supervisor, bits=supervisor_bits(state))
                if to_s >= self._asked_s + STATE_S:
                    self.armed = self.supervisor.armed

    def _place(self, state: CraftState) -> Place:
        roll, pitch, _ = (math.radians(angle) for angle in state.angles_deg)
        tilt_deg = math.degrees(math.acos(math.cos(roll) * math.cos(pitch)))
        return Place(*state.estimate_m, *state.estimate_m_s, tilt_deg, self.world.now_s)

    @property
    def craft_id(self) -> str:
        return self.number if self.state is CommandState.CONNECTED else ""

    @property
    def holds_height(self) -> bool:
        return bool(self._deck)

    @property
    def holds_place(self) -> bool:
        return self._deck == "flow_deck"

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
        if self.state is not CommandState.CONNECTED:
            return {}
        return {name: self.craft.get_parameter(name) for name in GAINS}

    def _send_setpoint(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int, until_s: float
    ) -> None:
        self._require()
        handed_s = self.world.now_s

        def send() -> None:
            self._note("setpoint", thrust, handed_s, level=roll_deg == pitch_deg == 0.0)
            self.craft.command(roll_deg, -pitch_deg, -yaw_dps, thrust)

        self.superseded += self.outbox.put(send, until_s)

    def _send_height(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, height_m: float, until_s: float
    ) -> None:
        def steer() -> None:
            self.craft.command_height(roll_deg, -pitch_deg, -yaw_dps, height_m)

        self._at_height(steer, height_m, until_s, level=roll_deg == pitch_deg == 0.0)

    def _send_hover(
        self, vx_m_s: float, vy_m_s: float, yaw_dps: float, height_m: float, until_s: float
    ) -> None:
        def steer() -> None:
            self.craft.command_hover(vx_m_s, vy_m_s, -yaw_dps, height_m)

        level = vx_m_s == vy_m_s == 0.0
        self._at_height(steer, height_m, until_s, level=level, hovers=True)

    def _at_height(
        self, steer: Callable[[], None], height_m: float, until_s: float, **more: bool
    ) -> None:
        self._require()
        handed_s = self.world.now_s

        def send() -> None:
            self._note("setpoint", 0, handed_s, height_m=height_m, **more)
            steer()

        self.superseded += self.outbox.put(send, until_s, unlocks=False)

    async def _write_parameter(self, name: str, value: float) -> float:
        self._require()
        await asyncio.sleep(STEP_S)  # its way there
        if self.refuses:
            raise LinkError(f"{self.uri}: parameter {name} was not confirmed")
        self._require()
        self.craft.set_parameter(name, value)
        return self.craft.get_parameter(name)

    async def _asked(self, request: bytes, patience_s: float) -> bytes | None:
        self._require()
        self.asked.append((request[0], self.turns))
        await asyncio.sleep(STEP_S)
        answer = None if self.refuses else misc_answer(self.craft, self._listed, request)
        return None if answer is None else answer[len(request) :]

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

    def _note(self, kind: str, value: int, handed_s: float, **more: Any) -> None:
        self.delivered.append(Delivered(kind, value, self.world.now_s, handed_s, **more))


class World(asyncio.SelectorEventLoop):
    """An event loop in whose waits time passes for the crafts, as fast as they can be computed."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.crafts: list[CraftInHand] = []
        super().__init__()
        select = self._selector.select

        def pass_instead(timeout: float | None = None) -> list:
            found = select(0)
            while not found and left_behind():  # on the disk, whose time is the machine's
                found = select(0.01)
            if not found and timeout:
                self.pass_time(timeout)
            return found

        self._selector.select = pass_instead

    def time(self) -> float:
        return self.now_s

    def craft(self, name: str, kind: str, deck: str = "") -> CraftInHand:
        self.crafts.append(CraftInHand(f"udp://{name}", self, kind, deck))
        return self.crafts[-1]

    def commander(
        self,
        link: CraftInHand,
        changes: Path,
        note: Callable[[str, str], None],
        motors: Callable[[CommandLink], Motors | None] = lambda link: link.motors(),
    ) -> Commander:
        """That of a daemon; changes: its file of what was written to crafts."""
        return Commander(
            link,
            FailsafeConfig(),
            note=note,
            telemetry=lambda: (LinkState.STREAMING, ""),
            changes=Changes(changes),
            motors=motors,
            clock=self.time,
        )

    def pass_time(self, seconds: float) -> None:
        """It passes for the crafts and their radios, and nothing in the loop runs meanwhile."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s = min(self.now_s + STEP_S, end_s)
            for craft in self.crafts:
                craft.pass_time(self.now_s)


class Flying:
    """A daemon's commander, two crafts, and the loop that they share."""

    def __init__(self, kind: str, changes: Path, deck: str = "") -> None:
        self.world = World()
        self.one = self.world.craft("one:1", kind, deck)
        self.other = self.world.craft("other:2", kind, deck)
        self.told: list[str] = []
        self.begin(changes)
        self.wait(0.2)  # they have said what state they are in

    def begin(self, changes: Path) -> None:
        """A daemon, also in the place of one that was killed."""
        self.commander = self.world.commander(
            self.one, changes, lambda kind, text: self.told.append(text)
        )

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        return self.world.run_until_complete(work)

    def wait(self, seconds: float) -> None:
        """As the daemon does: the loop turns, the failsafe looks."""

        async def turning() -> None:
            end_s = self.world.now_s + seconds
            while self.world.now_s < end_s:
                self.commander.turn(self.world.now_s)
                self.commander.look(self.world.now_s)
                await asyncio.sleep(WATCH_S)

        self.run(turning())

    def lease(self, client: str = "a program") -> str:
        return self.commander.acquire(client).token

    def steer(self, token: str, seconds: float, thrust: int = HOVER, **more: float | None) -> None:
        end_s = self.world.now_s + seconds
        while self.world.now_s < end_s:
            self.commander.setpoint(token, 0.0, 0.0, 0.0, thrust, made_s=self.world.now_s, **more)
            self.wait(0.05)

    def looked(self, work: Coroutine[Any, Any, T]) -> T:
        """What is answered while the failsafe looks."""

        async def asked() -> T:
            asking = asyncio.ensure_future(work)
            while not asking.done():
                self.commander.look(self.world.now_s)
                await asyncio.sleep(WATCH_S)
            return asking.result()

        return self.run(asked())

    def stopped(self) -> str:
        """What an operator who presses Stop is told."""
        return self.looked(self.commander.operator.stop())


class Tuning(Flying):
    """The daemon's task that writes back, and reads what is stored, runs too."""

    def begin(self, changes: Path) -> None:
        super().begin(changes)
        self.path = changes
        self.restoring = self.world.create_task(self.commander.keep_restored())

    def end(self) -> None:
        """Of that task."""
        self.restoring.cancel()
        self.run(asyncio.sleep(0.0))

    def close(self) -> None:
        self.end()
        self.world.close()

    def write(self, token: str, **values: float) -> Any:
        return self.looked(self.commander.write_parameters(token, values))

    def gains(self) -> dict[str, float]:
        return {name: self.one.craft.get_parameter(name) for name in GAINS}


def station_on(link: str, folder: Path, enabled: bool = True, **more: Any) -> Station:
    """A station on a link that records into ``folder``, where it is ``enabled``."""
    recording = RecordingConfig(folder=str(folder), enabled=enabled, low_space_mb=0)
    return Station(Config(link=LinkConfig(name=link), recording=recording, **more))


@asynccontextmanager
async def running(station: Station) -> AsyncIterator[None]:
    """While a station runs."""
    task = asyncio.create_task(station.run())
    try:
        yield
    finally:
        station.stop()
        await task


def serve(config: Config, path: Path, conversation: Callable[[Station], T]) -> T:
    """What ``conversation`` gives, beside the loop of a station that serves at ``path``."""
    serving: Future[tuple[Station, asyncio.AbstractEventLoop]] = Future()

    async def session() -> None:
        station = Station(config)
        control = ControlSocket(path)
        server = ControlServer(station, control)
        await server.start()
        task = asyncio.create_task(station.run())
        try:
            await station.receiver.tried.wait()
            serving.set_result((station, asyncio.get_running_loop()))
            await task
        finally:
            station.stop()
            await task
            await server.stop()
            control.close()

    with ThreadPoolExecutor(1) as beside:
        served = beside.submit(asyncio.run, session())
        served.add_done_callback(
            lambda one: serving.done() or serving.set_exception(one.exception())
        )
        station, loop = serving.result()
        try:
            return conversation(station)
        finally:
            loop.call_soon_threadsafe(station.stop)
            served.result()


def only_recording(config: Config) -> Any:
    """The only recording that was made."""
    from groundstation.recording.formats import open_recording

    (path,) = Path(config.recording.folder).glob("*.mcap")
    return open_recording(path)
