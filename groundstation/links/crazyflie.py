"""A Crazyflie by the official client library: commands, and telemetry by its log blocks."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from groundstation.errors import BadInputError, GroundStationError, LinkError, LinkLostError
from groundstation.links.base import Link, LinkOptions
from groundstation.links.command import (
    BATTERY_LOW,
    DISARMED_ITSELF,
    LIFE_S,
    STATE,
    CommandLink,
    CommandState,
    HostClock,
    LinkEvent,
    Place,
    Supervisor,
)
from groundstation.links.crazyflie_connection import (
    Connection,
    Identity,
    newest_only,
    resolve,
    watch_place,
)
from groundstation.links.log_rows import LogPacket, LogPlan, LogRows, plan_log
from groundstation.telemetry.decoder import DecoderCounts
from groundstation.telemetry.samples import SampleBatch

# What waits for the radio, and for how long it is worth sending.


LOCKS_AFTER_S = 2.0
"""Today's firmware stops a craft that heard no setpoint for so long, and locks its thrust."""
SEND_S = 2.5
"""cflib waits 2 s for a radio that takes nothing."""
REQUESTS_MOST = 8
"""Requests to arm, disarm and stop; the oldest is dropped, for the newest is what is wanted."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A setpoint or a request. until_s: monotonic; later it is not sent. unlocks: whether it holds
    thrust, which may have to be unlocked first. arms: whether it asks for motors that turn."""

    send: Callable[[], None]
    until_s: float
    unlocks: bool = False
    arms: bool = False


class Outbox:
    """The newest setpoint, and the requests in their order; safe to use from any thread.

    unlock: sends zero thrust, for a firmware that takes thrust only after it, again after each
    silence; None for one that does not. clock: monotonic, s. expired: what had grown too old to be
    sent.
    """

    def __init__(
        self, unlock: Callable[[], None] | None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.expired = 0
        self._unlock, self._clock = unlock, clock
        self._sent_s = -LOCKS_AFTER_S
        self._setpoint: _Waiting | None = None
        self._requests: deque[_Waiting] = deque(maxlen=REQUESTS_MOST)
        self._changed = threading.Condition()
        self._closing = False

    def put(self, send: Callable[[], None], until_s: float, *, unlocks: bool = True) -> bool:
        """A setpoint, in the place of one that still waits; whether there was one."""
        with self._changed:
            replaced = self._setpoint is not None
            self._setpoint = _Waiting(send, until_s, unlocks=unlocks)
            self._changed.notify()
        return replaced

    def request(
        self, send: Callable[[], None], *, until_s: float = math.inf, arms: bool = False
    ) -> None:
        """Something that is sent before the setpoint that waits, until then. arms: it asks for
        motors that turn, and can be withdrawn."""
        with self._changed:
            self._requests.append(_Waiting(send, until_s, arms=arms))
            self._changed.notify()

    def withdraw_arming(self) -> None:
        """What asks for motors that turn, and waits, is not sent."""
        with self._changed:
            kept = [one for one in self._requests if not one.arms]
            self._requests.clear()
            self._requests.extend(kept)

    def start(self) -> None:
        """Send from a thread of its own, for a radio may block for seconds."""

        def run() -> None:
            while self.wait():
                with contextlib.suppress(LinkError):  # it has gone meanwhile
                    self.send()

        self._thread = threading.Thread(target=run, name="setpoints", daemon=True)
        self._thread.start()

    def finish(self) -> None:
        """Send what waits, if the radio takes it soon, and end."""
        self.close()
        self._thread.join(SEND_S)

    def close(self) -> None:
        """What waits is still sent."""
        with self._changed:
            self._closing = True
            self._changed.notify()

    def wait(self) -> bool:
        """Until something is to be sent; False when nothing will be any more."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._requests or self._setpoint is not None or self._closing
            )
            return bool(self._requests) or self._setpoint is not None

    def send(self) -> None:
        """Send what waits; may block for as long as the radio does."""
        while (request := self._next()) is not None:
            if self._clock() > request.until_s:
                self.expired += 1
            else:
                request.send()
        with self._changed:
            setpoint, self._setpoint = self._setpoint, None
        if setpoint is None:
            return
        silent_s = self._clock() - self._sent_s
        if self._unlock is not None and setpoint.unlocks and silent_s >= LOCKS_AFTER_S:
            self._unlock()
        # the last moment before the radio has it: a process may have stood still anywhere above
        if self._clock() > setpoint.until_s:
            self.expired += 1
            return
        setpoint.send()
        if setpoint.unlocks:
            self._sent_s = self._clock()

    def _next(self) -> _Waiting | None:
        """One at a time: the radio may block, and what waits behind it be withdrawn."""
        with self._changed:
            return self._requests.popleft() if self._requests else None


# Commands to a Crazyflie, or to a stand-in, through the official client library.


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
        self._outbox: Outbox | None = None
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
        craft, today = self._connection.craft, self._connection.protocol >= TODAY
        unlock = (lambda: craft.commander.send_setpoint(0, 0, 0, 0)) if today else None
        self._outbox = Outbox(unlock)
        self._outbox.start()
        self._forget()
        self.storage = self._connection.storage()
        self.settles_s = SETTLES_S if today else 0.0
        for port in (PLATFORM[0], SUPERVISOR[0]):
            craft.add_port_callback(port, self._take_answer)
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
        outbox, self._outbox = self._outbox, None
        if outbox is not None:
            await asyncio.to_thread(outbox.finish)
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
        by_filter = self._parameter(ESTIMATOR) == KALMAN and self._knows_height
        return by_filter or any(map(self._parameter, HEIGHT_DECKS))

    @property
    def holds_place(self) -> bool:
        by_filter = self._parameter(ESTIMATOR) == KALMAN and self.supervisor.knows_place
        return self.holds_height and (by_filter or any(map(self._parameter, FLOW_DECKS)))

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
        if self._outbox is not None:
            self._outbox.withdraw_arming()

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
        values = (roll_deg, -pitch_deg, yaw_dps, height_m)
        self._send_at_height((Z_DISTANCE, LEGACY_Z_DISTANCE), values, until_s)

    def _send_hover(
        self, vx_m_s: float, vy_m_s: float, yaw_dps: float, height_m: float, until_s: float
    ) -> None:
        values = (vx_m_s, vy_m_s, yaw_dps, height_m)
        self._send_at_height((HOVER, LEGACY_HOVER), values, until_s)

    def _send_at_height(
        self, kinds: tuple[int, int], values: tuple[float, float, float, float], until_s: float
    ) -> None:
        """kinds: of the setpoint, with yaw counter-clockwise as in ``values`` and clockwise."""
        kind, (first, second, turn, height_m) = kinds[0], values
        if self._connection.protocol < SIGNED_YAW:
            kind, turn = kinds[1], -turn
        data = struct.pack("<Bffff", kind, first, second, turn, height_m)
        self._steer(lambda: self._connection.send(*AT_HEIGHT, data), until_s, unlocks=False)

    def _steer(self, send: Callable[[], None], until_s: float, unlocks: bool = True) -> None:
        """Send a setpoint, on a connection that is from now on that of a craft under command."""
        self._connected()
        outbox = self._require_outbox()
        self._connection.commanded = True
        self.superseded += outbox.put(send, until_s, unlocks=unlocks)

    def _require_outbox(self) -> Outbox:
        outbox = self._outbox
        if outbox is None:
            raise LinkError(f"{self.uri} is being closed")
        return outbox

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


# Telemetry of a stock Crazyflie by its log blocks: ``radio://``, ``usb://`` or ``udp://``.
#
# Nothing is soldered and nothing is flashed: the craft is asked for the variables that it lists.
# The connection carries commands too.


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
