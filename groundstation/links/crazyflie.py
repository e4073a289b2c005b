"""Commands to a Crazyflie, or to a stand-in, through the official client library."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from groundstation.errors import BadInputError, GroundStationError, LinkError
from groundstation.links.cflib_calls import newest_only, resolve
from groundstation.links.clock import HostClock
from groundstation.links.command import LIFE_S, CommandLink, CommandState
from groundstation.links.craft_place import watch_place
from groundstation.links.crazyflie_connection import Connection, Identity
from groundstation.links.event import LinkEvent
from groundstation.links.outbox import Outbox, Sender
from groundstation.links.supervisor import (
    BATTERY_LOW,
    DISARMED_ITSELF,
    STATE,
    Place,
    Supervisor,
)

CONFIRM_S = 2.0
ASSISTS = ("flightmode.althold", "flightmode.poshold")
"""Modes in which zero thrust is a rate of descent."""
STOP = "stop"
TODAY, SUPERVISED = 4, 12
"""CRTP versions: from which on there are requests to arm and stop, and a port for them."""
PLATFORM, SUPERVISOR = (13, 0), (9, 1)
"""Port and channel of requests."""
ARM, RECOVER, ANSWER = 1, 2, 0x80
EMERGENCY = (6, 1, b"\x03")
SUPERVISED_STOP = (9, 1, b"\x03")
HEIGHT_DECKS = ("deck.bcZRanger", "deck.bcZRanger2", "deck.bcFlow", "deck.bcFlow2")
"""Parameters that are 1 where such a deck is plugged in: each measures the height by itself."""
FLOW_DECKS = ("deck.bcFlow", "deck.bcFlow2")
"""Of these, the ones that measure the velocity over the ground."""
ESTIMATOR, KALMAN = "stabilizer.estimator", 2
"""By which a craft without such a deck is told its height by base stations, anchors or a camera
system."""
AT_HEIGHT = (7, 0)
Z_DISTANCE, LEGACY_Z_DISTANCE = 9, 2
"""Generic setpoints of attitude, yaw rate and height: counter-clockwise, and clockwise before
protocol 9."""
HOVER, LEGACY_HOVER = 10, 5
"""Generic setpoints of velocity, yaw rate and height, with the same turns."""
SIGNED_YAW = 9
DISARMS_SAFELY = 9
"""Before that protocol a craft that is disarmed in flight is locked until it is switched off."""
SETTLES_S = 2.5
"""It calls itself landed 2 s after a motor last turned, and one whose setpoints cease before that
is locked until it is switched off and on."""
STATE_S = 0.3
"""What its log says of being armed may be older than its answer to a request, by less than this."""
STATE_MS, FIRST_S = 100, 0.5
"""It says ten times a second what state it is in; how long the first time is waited for."""
CPU_ID = ("cpu.id0", "cpu.id1", "cpu.id2")
"""Parameters of 32 bits that hold the number of its processor, which is no other's."""
HEIGHT_LOST_S = 1.0
"""A craft in the air that has not known its height for so long does not hold it."""
_WHOLE = {
    "uint8_t": (0, 255),
    "int8_t": (-128, 127),
    "uint16_t": (0, 65535),
    "int16_t": (-32768, 32767),
    "uint32_t": (0, 2**32 - 1),
    "int32_t": (-(2**31), 2**31 - 1),
}


class CrazyflieLink(CommandLink):
    """One Crazyflie, or stand-in, by cflib.

    shared: the connection of a telemetry link that carries the commands too; None: its own.
    """

    def __init__(
        self, uri: str, *, shared: Connection | None = None, clock: HostClock | None = None
    ) -> None:
        super().__init__(uri, clock=clock)
        self._is_shared = shared is not None
        self._connection = shared or Connection(uri)
        self._connection.on_lost.append(self._lose)
        self._sender: Sender | None = None
        self._asked_armed = False
        self._asked_s = -STATE_S
        self._told = asyncio.Event()  # of its state, for the first time
        self._knows_height, self._height_s = False, 0.0
        self._identity: Identity | None = None
        self._saying = threading.Lock()

    async def open(self) -> None:
        if self._is_shared and not self._connection.is_open:
            raise LinkError(f"{self.uri} is not connected: commands go with its telemetry")
        self._enter(CommandState.CONNECTING, f"connecting to {self.uri}")
        try:
            if not self._is_shared:
                await self._connection.open()
            await self._connection.complete()
            self._identity = await self._connection.identify()
        except LinkError:
            await self.close()
            raise
        self._sender = Sender(self._connection.craft, locks=self._connection.protocol >= TODAY)
        self._forget()
        self.storage = self._connection.storage()
        self.settles_s = SETTLES_S if self._connection.protocol >= TODAY else 0.0
        for port in (PLATFORM[0], SUPERVISOR[0]):
            self._connection.craft.add_port_callback(port, self._take_answer)
        await self._watch()
        if self.state is not CommandState.CONNECTING:
            await self.close()
            raise LinkError(f"{self.uri}: the connection was lost at once")
        self._enter(CommandState.CONNECTED, f"connected, {len(self.parameters())} parameters")

    async def _watch(self) -> None:
        """Be told of what keeps the craft from flying, for the first time before anybody asks; it
        flies as well where it does not say."""
        listed = self._connection.variables()
        watched = [(name, listed[name]) for name in STATE if name in listed]
        if not watched or self._connection.protocol < TODAY:
            return
        self._told = asyncio.Event()
        tell = newest_only(asyncio.get_running_loop(), self._take_state)
        try:
            blocks = self._connection.blocks
            await blocks.watch(
                "watch", watched, STATE_MS, lambda stamp, said: tell(Supervisor.of(said))
            )
            await watch_place(self._connection, self.clock, self._take_place, self.on_table)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(FIRST_S):
                    await self._told.wait()
        except GroundStationError as error:
            if self.state is CommandState.CONNECTING:
                self._tell("waiting", f"what keeps the craft from flying is not told: {error}")

    def _take_place(self, place: Place) -> None:
        """From cflib's thread."""
        with self._saying:
            self.supervisor = replace(self.supervisor, place=place)

    def _take_state(self, said: Supervisor) -> None:
        with self._saying:
            before = self.supervisor
            self.supervisor = said = replace(said, place=before.place)
        self._told.set()
        now_s = time.monotonic()
        if said.height_m is not None:
            self._height_s = now_s
        # one that flies is not dropped because it does not see its base stations for a moment
        stays = self._knows_height and said.flies and now_s < self._height_s + HEIGHT_LOST_S
        self._knows_height = said.height_m is not None or stays
        if said.armed is not None and now_s >= self._asked_s + STATE_S:
            if self.armed and not (said.armed or said.arms_itself or said.trouble):
                self._tell("disarmed", DISARMED_ITSELF)
            self.armed = said.armed
        if said.trouble and said.trouble != before.trouble:
            self._tell("fault", said.trouble)
        if said.low_battery and not before.low_battery:
            self._tell("battery", BATTERY_LOW)

    def _lose(self, reason: str) -> None:
        self._forget()
        self._enter(CommandState.LOST, reason)

    def _forget(self) -> None:
        """What it said of itself holds no longer."""
        self.armed, self.supervisor, self._knows_height = None, Supervisor(), False
        self._asked_armed, self.storage = False, None

    def _tell(self, kind: str, text: str) -> None:
        self.on_event(LinkEvent(self.clock(), self.uri, kind, text))

    async def close(self) -> None:
        self.withdraw_arming()
        sender, self._sender = self._sender, None
        if sender is not None:
            await asyncio.to_thread(sender.close)
        if not self._is_shared:
            await self._connection.close()
        self._forget()
        self._enter(CommandState.CLOSED, "closed")

    @property
    def firmware(self) -> str:
        if not self._connection.is_open:
            return ""
        protocol = self._connection.protocol
        # the loops of today came between the first version that was numbered and this one
        return "2.x" if protocol >= TODAY else "2014" if protocol < 0 else ""

    @property
    def vehicle(self) -> str:
        return "" if self._identity is None else self._identity.vehicle

    @property
    def craft_id(self) -> str:
        parts = [part for name in CPU_ID if (part := self._parameter(name)) is not None]
        return "".join(f"{int(part):08x}" for part in parts) if len(parts) == len(CPU_ID) else ""

    @property
    def holds_height(self) -> bool:
        if not self._is_up_to_date():
            return False
        if any(self._parameter(name) for name in HEIGHT_DECKS):
            return True
        return self._parameter(ESTIMATOR) == KALMAN and self._knows_height

    @property
    def holds_place(self) -> bool:
        if not self.holds_height:
            return False
        if any(self._parameter(name) for name in FLOW_DECKS):
            return True
        return self._parameter(ESTIMATOR) == KALMAN and self.supervisor.knows_place

    @property
    def disarms_in_flight(self) -> bool:
        if not self._is_up_to_date() or self.supervisor.arms_itself:
            return False
        # its log may not say yet what it was asked for, by a connection before this one too
        may_be_armed = self.supervisor.armed is not False or self._asked_armed
        return may_be_armed and self._connection.protocol >= DISARMS_SAFELY

    def _parameter(self, name: str) -> float | None:
        """One of them, which each setpoint may ask for; None where there is none."""
        if not self._connection.is_open:
            return None
        group, _, short = name.partition(".")
        value = self._connection.craft.param.values.get(group, {}).get(short)
        return None if value is None else float(value)

    def parameters(self) -> dict[str, float]:
        if not self._connection.is_open:
            return {}
        return {
            f"{group}.{name}": float(value)
            for group, values in self._connection.craft.param.values.items()
            for name, value in values.items()
        }

    def clear_assists(self) -> list[str]:
        if not self._is_up_to_date():
            return []
        known = self.parameters()
        found = [name for name in ASSISTS if known.get(name)]
        for name in found:
            self._connection.craft.param.set_value(name, 0)
            self._entry("out", "parameter", client=STOP, name=name, value=0.0)
        return found

    def emergency_stop(self) -> bool:
        if not self._is_up_to_date():
            return False
        port, channel, data = (
            EMERGENCY if self._connection.protocol < SUPERVISED else SUPERVISED_STOP
        )
        self._require_outbox().request(lambda: self._connection.send(port, channel, data))
        self._entry("out", "emergency stop", client=STOP)
        return True

    def arm(self, armed: bool) -> bool:
        if not self._is_up_to_date():
            return False
        self._asked_armed, self.armed, self._asked_s = armed, None, time.monotonic()
        if armed:
            self._request(bytes([ARM, True]), "arm", until_s=self._asked_s + LIFE_S, arms=True)
        else:
            self.withdraw_arming()
            self._request(bytes([ARM, False]), "disarm")
        return True

    def withdraw_arming(self) -> None:
        if self._sender is not None:
            self._sender.outbox.withdraw_arming()

    def recover(self) -> None:
        if self._is_up_to_date():
            until_s = time.monotonic() + LIFE_S
            self._request(bytes([RECOVER]), "recover", until_s=until_s, arms=True)

    def _request(
        self, data: bytes, kind: str, *, until_s: float = math.inf, arms: bool = False
    ) -> None:
        port, channel = PLATFORM if self._connection.protocol < SUPERVISED else SUPERVISOR
        self._require_outbox().request(
            lambda: self._connection.send(port, channel, data), until_s=until_s, arms=arms
        )
        self._entry("out", kind)

    def _take_answer(self, packet: Any) -> None:
        """To a request to arm: whether it was done and, from 2026 on, whether it is armed. Called
        from cflib's thread."""
        data = bytes(packet.data)
        place = packet.port, packet.channel
        if place == PLATFORM and len(data) >= 2 and data[0] == ARM:
            self.armed = self._asked_armed if data[1] else not self._asked_armed
        elif place == SUPERVISOR and len(data) >= 3 and data[0] == ANSWER | ARM:
            self.armed = bool(data[2])

    def _is_up_to_date(self) -> bool:
        return self.state is CommandState.CONNECTED and self._connection.protocol >= TODAY

    def _send_setpoint(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int, until_s: float
    ) -> None:
        # cflib turns pitch round by itself, from nose down to the firmware's nose up
        commander = self._connected().commander
        self._steer(lambda: commander.send_setpoint(roll_deg, pitch_deg, -yaw_dps, thrust), until_s)

    def _send_height(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, height_m: float, until_s: float
    ) -> None:
        # cflib turns nothing round here: the firmware's pitch is nose up
        kind, turn = (
            (Z_DISTANCE, yaw_dps)
            if self._connection.protocol >= SIGNED_YAW
            else (LEGACY_Z_DISTANCE, -yaw_dps)
        )
        data = struct.pack("<Bffff", kind, roll_deg, -pitch_deg, turn, height_m)
        self._steer(lambda: self._connection.send(*AT_HEIGHT, data), until_s, unlocks=False)

    def _send_hover(
        self, vx_m_s: float, vy_m_s: float, yaw_dps: float, height_m: float, until_s: float
    ) -> None:
        kind, turn = (
            (HOVER, yaw_dps)
            if self._connection.protocol >= SIGNED_YAW
            else (LEGACY_HOVER, -yaw_dps)
        )
        data = struct.pack("<Bffff", kind, vx_m_s, vy_m_s, turn, height_m)
        self._steer(lambda: self._connection.send(*AT_HEIGHT, data), until_s, unlocks=False)

    def _steer(self, send: Callable[[], None], until_s: float, unlocks: bool = True) -> None:
        """Send a setpoint, on a connection that is from now on that of a craft under command."""
        self._connected()
        outbox = self._require_outbox()
        self._connection.commanded = True
        self.superseded += outbox.put(send, until_s, unlocks=unlocks)

    def _require_outbox(self) -> Outbox:
        sender = self._sender
        if sender is None:
            raise LinkError(f"{self.uri} is being closed")
        return sender.outbox

    async def _write_parameter(self, name: str, value: float) -> float:
        craft = self._connected()
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[float] = loop.create_future()
        group, short = name.split(".", 1)

        def updated(complete_name: str, text: str) -> None:
            loop.call_soon_threadsafe(resolve, answer, float(text))

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
        if self.state is not CommandState.CONNECTED:
            raise LinkError(f"{self.uri} is not connected ({self.state.value})")
        return self._connection.craft
