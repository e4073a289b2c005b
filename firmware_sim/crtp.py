"""The firmware's side of CRTP: commander, parameters, logging, console, what it calls itself.

One datagram is one packet: a header byte (port << 4 | channel) and up to 30 bytes of data.
``Conversation`` is the protocol for one client, without I/O; ``CrtpServer`` puts it on UDP, as
official clients reach it (``udp://host:port``). A
craft with the firmware of 2014 speaks protocol 1, one with today's firmware 7 to 12, where numbers
in the tables of contents have 16 bits and log blocks have a command for periods below 10 ms. Until
protocol 10 it logs by the commands of 2014 as well, which know its first 255 variables.
"""

from __future__ import annotations

import asyncio
import errno
import math
import struct
import zlib
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

from firmware_sim.contents import (
    FLOAT,
    HALF,
    MISC,
    READ_ONLY,
    TODAY,
    U32,
    Contents,
    contents_of,
    form_of,
    misc_answer,
    packed,
    supervisor_bits,
)
from firmware_sim.craft import CraftState, StandIn
from firmware_sim.supervisor import CRASHED, LOCKED

CONSOLE, PARAM, COMMANDER, MEM, LOG = 0, 2, 3, 4, 5
LOCALIZATION, GENERIC, SUPERVISOR, PLATFORM, LINK = 6, 7, 9, 13, 15
SUPERVISED = 12
"""The protocol from which on the supervisor has a port, and the commands of 2014 are gone."""
MAX_DATA = 30
MAX_LOG_BYTES = 26
NULL_PACKET = b"\xff"
MISSED_MS = 1000
"""A block that was not asked for so long has lost what came before, as a queue would."""

_LOG_FORMAT = {1: "<B", 2: "<H", 3: "<I", 4: "<b", 5: "<h", 6: "<i", FLOAT: "<f", HALF: "<e"}
_HALF_MOST = 65504.0
_SETPOINT = struct.Struct("<fffH")
_AT_HEIGHT = struct.Struct("<Bffff")
STOP_SETPOINT, LEGACY_Z_DISTANCE, LEGACY_HOVER, Z_DISTANCE, HOVER = 0, 2, 5, 9, 10
"""Generic setpoints: nothing; angles and height; velocity and height. The legacy ones count yaw
clockwise; the others came with protocol 9."""
YAW_TURNED = 9

CREATE, APPEND, DELETE, START, STOP, RESET, CREATE_V2, APPEND_V2, START_V2 = range(9)
"""Commands of the log; those of version 2 are today's."""
GET_ITEM, GET_INFO, GET_ITEM_V2, GET_INFO_V2 = range(4)
"""Commands of the tables of contents."""

SAID = {
    LOCKED: "SUP: Locked, reboot required\n",
    CRASHED: "SUP: Crashed, recovery required\n",
}
LOST = "ESTKALMAN: State out of bounds, resetting\n"
RELEASES = {7: "2023.11", 8: "2024.10", 9: "2025.02", 10: "2025.09", 12: "2026.04"}
"""Firmware releases by the protocol that they brought."""

DEFAULT_PORT = 19850
"""Where clients that scan look first."""
LOG_TICK_S = 0.01
MAX_CLIENTS = 8
"""Beyond these the client that has been silent for longest is forgotten."""

Address = tuple[Any, ...]


@dataclass(slots=True)
class LogBlock:
    """What a client asked to be logged: (variable, type to send it as)."""

    variables: list[tuple[int, int]] = field(default_factory=list)
    period_ms: int = 0
    next_ms: int = 0


class Conversation:
    """CRTP with one client: its packets in, the craft's answers out."""

    def __init__(self, craft: StandIn) -> None:
        self.contents: Contents = contents_of(craft)
        self._craft = craft
        self._today = craft.protocol >= TODAY
        self._by_both = self._today and craft.protocol < SUPERVISED
        self._boots = craft.boots
        self._blocks: dict[int, LogBlock] = {}
        state = craft.state()
        self._supervisor, self._lost = state.supervisor, state.lost

    def answer(self, packet: bytes) -> list[bytes]:
        """The packets that answer ``packet``; none for what the firmware would ignore.

        Never raises: what arrives on the air is not to be trusted.
        """
        if not packet or len(packet) > MAX_DATA + 1:
            return []
        if packet[:1] == NULL_PACKET:
            return [NULL_PACKET]
        port, channel, data = packet[0] >> 4, packet[0] & 3, packet[1:]
        if port == COMMANDER and channel == 0:
            self._setpoint(data)
        elif port == GENERIC and channel == 0 and self._today:
            self._generic_setpoint(data)
        elif port == PARAM:
            return [bytes([packet[0]]) + body for body in self._parameter(channel, data)]
        elif port == LOG:
            return [bytes([packet[0]]) + body for body in self._log(channel, data)]
        elif port == MEM and channel == 0 and data[:1] == b"\x01":
            return [bytes([packet[0], 1, 0])]
        elif self._today and port in (LOCALIZATION, SUPERVISOR, PLATFORM):
            return [bytes([packet[0]]) + body for body in self._request(port, channel, data)]
        elif port == LINK and channel == 0:
            return [packet]
        elif port == LINK and channel == 1:
            source = b"Bitcraze Crazyflie" if self._today else b""
            return [bytes([packet[0]]) + source.ljust(MAX_DATA, b"\0"), *_console(self._banner())]
        return []

    def due(self, uptime_ms: int) -> list[bytes]:
        """Log packets due before a time of the firmware's clock, ms, in order of time.

        What is due at that very time would hold the pass before: the one of that time is to come.
        What the console says goes before them.
        """
        if self._craft.boots != self._boots:  # a firmware that starts anew has no blocks
            self._boots = self._craft.boots
            self._blocks.clear()
        moments = []
        for number, block in self._blocks.items():
            if block.period_ms == 0:
                continue
            if uptime_ms - block.next_ms > MISSED_MS:
                block.next_ms += (uptime_ms - block.next_ms) // block.period_ms * block.period_ms
            while block.next_ms < uptime_ms:
                moments.append((block.next_ms, number))
                block.next_ms += block.period_ms
        out = self._said()
        states: dict[int, CraftState] = {}
        for moment, number in sorted(moments, key=lambda each: each[0]):
            if moment not in states:
                states[moment] = self._craft.logged(moment)
            stamp = (moment & 0xFFFFFF).to_bytes(3, "little")
            values = [
                self._value(states[moment], *which) for which in self._blocks[number].variables
            ]
            out.append(bytes([LOG << 4 | 2, number]) + stamp + b"".join(values))
        return out

    def _said(self) -> list[bytes]:
        """By supervisor and estimator, since the last time."""
        state, text = self._craft.state(), ""
        if state.supervisor != self._supervisor:
            text += SAID.get(state.supervisor, "")
        if state.lost > self._lost:
            text += LOST
        self._supervisor, self._lost = state.supervisor, state.lost
        return _console(text)

    def _setpoint(self, data: bytes) -> None:
        if len(data) != _SETPOINT.size:
            return
        roll, pitch, yaw, thrust = _SETPOINT.unpack(data)
        if all(map(math.isfinite, (roll, pitch, yaw))):
            self._craft.command(roll, pitch, yaw, thrust)

    def _generic_setpoint(self, data: bytes) -> None:
        if data[:1] == bytes([STOP_SETPOINT]):
            self._craft.command_stop()
        if len(data) != _AT_HEIGHT.size:
            return
        kind, first, second, yaw, height = _AT_HEIGHT.unpack(data)
        if not all(map(math.isfinite, (first, second, yaw, height))):
            return
        legacy = kind in (LEGACY_Z_DISTANCE, LEGACY_HOVER)
        if not legacy and self._craft.protocol < YAW_TURNED:
            return
        clockwise = yaw if legacy else -yaw
        if kind in (LEGACY_Z_DISTANCE, Z_DISTANCE):
            self._craft.command_height(first, second, clockwise, height)
        elif kind in (LEGACY_HOVER, HOVER):
            self._craft.command_hover(first, second, clockwise, height)

    def _request(self, port: int, channel: int, data: bytes) -> list[bytes]:
        """Versions, and requests to arm and to stop: on ports of their own from 2026 on."""
        if not data:
            return []
        if port == PLATFORM and channel == 1:
            return self._version(data)
        if port == PLATFORM and channel == 0 and self._craft.settings.software_build:
            return [data]
        asked = (port, channel, data[0])
        supervised = self._craft.protocol >= SUPERVISED
        if asked == ((SUPERVISOR, 1, 3) if supervised else (LOCALIZATION, 1, 3)):
            self._craft.emergency_stop()
        elif asked == ((SUPERVISOR, 1, 1) if supervised else (PLATFORM, 0, 1)) and len(data) > 1:
            done = self._craft.arm(bool(data[1]))
            armed = self._craft.state().armed
            return [bytes([0x81, done, armed])] if supervised else [bytes([1, done])]
        elif asked == ((SUPERVISOR, 1, 2) if supervised else (PLATFORM, 0, 2)):
            done = self._craft.recover()
            return [bytes([0x82, done, done])] if supervised else [bytes([2, done])]
        elif asked == (SUPERVISOR, 0, 0x0C) and supervised:
            return [b"\x8c" + supervisor_bits(self._craft.state()).to_bytes(2, "little")]
        return []

    def _version(self, data: bytes) -> list[bytes]:
        said = {
            0: self._craft.protocol.to_bytes(4, "little"),
            1: (self._craft.settings.release or RELEASES[self._craft.protocol]).encode(),
            2: self._craft.device.encode(),
        }
        if self._craft.settings.software_build:
            del said[2]
        return [data[:1] + said[data[0]]] if data[0] in said else []

    def _parameter(self, channel: int, data: bytes) -> list[bytes]:
        if channel == 0:
            if self._by_both and data[:1] in (bytes([GET_ITEM]), bytes([GET_INFO])):
                # of parameters nothing is told by them any more
                return [data[:1] if data[0] == GET_ITEM else bytes([GET_INFO, 0, 0, 0])]
            return self._contents(data, self.contents.parameter_items, b"")
        if channel == MISC and self._today:
            told = misc_answer(self._craft, self.contents.parameters, data)
            return [] if told is None else [told]
        width = 2 if self._today else 1
        if len(data) < width or channel not in (1, 2):
            return []
        place, given = data[:width], data[width:]
        number = int.from_bytes(place, "little")
        if number >= len(self.contents.parameters):
            return [place + bytes([errno.ENOENT]) if self._today else bytes([255, number, 2])]
        name, kind = self.contents.parameters[number]
        form = form_of(kind)
        if channel == 2:
            if len(given) != form.size or kind & READ_ONLY:
                return []
            value = form.unpack(given)[0]
            # A value that is no number would leave the loops undefined: what is set stays.
            if math.isfinite(value):
                self._craft.set_parameter(name, value)
        value = self._craft.get_parameter(name)
        status = b"\0" if self._today and channel == 1 else b""
        return [place + status + packed(kind, value)]

    def _log(self, channel: int, data: bytes) -> list[bytes]:
        if not data:
            return []
        if channel == 0:
            limits = bytes([self.contents.most_blocks, self.contents.most_variables])
            return self._contents(data, self.contents.log_items, limits)
        if channel != 1:
            return []
        command, number = data[0], data[1] if len(data) > 1 else 0
        return [bytes([command, number, self._control(command, number, data[2:])])]

    def _control(self, command: int, number: int, data: bytes) -> int:
        block = self._blocks.get(number)
        if command == RESET:
            self._blocks.clear()
            return 0
        if command not in self._log_commands():
            return errno.ENOEXEC
        is_new = command in (CREATE_V2, APPEND_V2, START_V2)
        width = 2 if is_new else 1
        if command in (CREATE, CREATE_V2):
            if block is not None:
                return errno.EEXIST
            if len(self._blocks) >= self.contents.most_blocks:
                return errno.ENOMEM
            # today's firmware keeps a block whose variables it refuses
            block = LogBlock()
            error = self._append(block, data, width)
            if error == 0 or self._today:
                self._blocks[number] = block
            return error
        if block is None:
            return errno.ENOENT
        if command in (APPEND, APPEND_V2):
            return self._append(block, data, width)
        if command == DELETE:
            del self._blocks[number]
        elif command == STOP:
            block.period_ms = 0
        else:
            if len(data) < width:
                return errno.ENOEXEC
            block.period_ms = int.from_bytes(data[:width], "little") * (1 if is_new else 10)
            block.next_ms = self._craft.uptime_ms + block.period_ms
        return 0

    def _log_commands(self) -> tuple[int, ...]:
        old, new = (CREATE, APPEND), (CREATE_V2, APPEND_V2, START_V2)
        own = (*old, *new) if self._by_both else new if self._today else old
        return (*own, DELETE, START, STOP)

    def _append(self, block: LogBlock, data: bytes, width: int) -> int:
        """Until the first variable that is refused, as the firmware does. width: bytes of a
        variable's number."""
        added = [
            (int.from_bytes(data[at + 1 : at + 1 + width], "little"), data[at] & 0x0F)
            for at in range(0, len(data) - width, 1 + width)
        ]
        for variable, kind in added:
            if variable >= len(self.contents.variables) or kind not in _LOG_FORMAT:
                return errno.ENOENT
            both = [*block.variables, (variable, kind)]
            if sum(struct.calcsize(_LOG_FORMAT[kind]) for _, kind in both) > MAX_LOG_BYTES:
                return errno.E2BIG
            others = sum(len(b.variables) for b in self._blocks.values() if b is not block)
            if others + len(both) > self.contents.most_variables:
                return errno.ENOMEM
            block.variables = both
        return 0

    def _contents(self, data: bytes, items: list[bytes], limits: bytes) -> list[bytes]:
        """A table of contents: its size and checksum, or one item."""
        if not data:
            return []
        asked, is_new = data[0], data[0] in (GET_ITEM_V2, GET_INFO_V2)
        if asked > GET_INFO_V2 or not (is_new == self._today or self._by_both):
            return []
        width = 2 if is_new else 1
        if asked in (GET_INFO, GET_INFO_V2):
            size = min(len(items), 256**width - 1).to_bytes(width, "little")
            known_by = zlib.crc32(b"".join(items)).to_bytes(4, "little")
            return [bytes([asked]) + size + known_by + limits]
        if len(data) <= width:
            return []
        place = data[1 : 1 + width]
        number = int.from_bytes(place, "little")
        return [bytes([asked]) + place + items[number] if number < len(items) else bytes([asked])]

    def _value(self, state: CraftState, variable: int, kind: int) -> bytes:
        value = self.contents.variables[variable][2](state)
        if kind == HALF:
            value = min(max(value, -_HALF_MOST), _HALF_MOST)
        if kind in (FLOAT, HALF):
            return struct.pack(_LOG_FORMAT[kind], value)
        # a float is cut to 32 bits, and its lowest bytes are sent
        low, high = (0, 2**32 - 1) if kind == U32 else (-(2**31), 2**31 - 1)
        size = struct.calcsize(_LOG_FORMAT[kind])
        whole = int(min(max(value, low), high)) % 2 ** (8 * size)
        return whole.to_bytes(size, "little")

    def _banner(self) -> str:
        if not self._today:
            return (
                "SYS: ----------------------------\n"
                "SYS: Crazyflie is up and running!\n"
                "SYS: firmware stand-in, 2014.01.0\n"
            )
        return f"SYS: {self._craft.device} is up and running!\nSYS: firmware stand-in\n"


def _console(text: str) -> list[bytes]:
    raw = text.encode()
    return [bytes([CONSOLE << 4]) + raw[i : i + MAX_DATA] for i in range(0, len(raw), MAX_DATA)]


@dataclass(slots=True)
class ServerCounts:
    """Datagrams since the start: taken, answered, and clients forgotten for room."""

    received: int = 0
    sent: int = 0
    forgotten: int = 0


class CrtpServer(asyncio.DatagramProtocol):
    """Serves a craft that somebody else advances. ``close`` may be called twice."""

    def __init__(self, craft: StandIn, host: str = "127.0.0.1", port: int = DEFAULT_PORT) -> None:
        self.counts = ServerCounts()
        self._craft = craft
        self._address = (host, port)
        self._clients: OrderedDict[Address, Conversation] = OrderedDict()
        self._transport: asyncio.DatagramTransport | None = None
        self._logging: asyncio.Task[None] | None = None
        self._unbound = asyncio.Event()

    async def start(self) -> None:
        """Bind and serve. Raises OSError when the port is taken."""
        loop = asyncio.get_running_loop()
        self._unbound.clear()
        self._transport, _ = await loop.create_datagram_endpoint(
            lambda: self, local_addr=self._address
        )
        self._logging = loop.create_task(self._log(), name="crtp-log")

    @property
    def port(self) -> int:
        """The port that is served (useful after asking for port 0)."""
        if self._transport is None:
            return self._address[1]
        return int(self._transport.get_extra_info("sockname")[1])

    async def close(self) -> None:
        """Stop serving; the port is free behind it."""
        if self._logging is not None:
            self._logging.cancel()
            await asyncio.gather(self._logging, return_exceptions=True)
            self._logging = None
        if self._transport is not None:
            self._transport.close()
            self._transport = None
            await self._unbound.wait()

    def connection_lost(self, exc: Exception | None) -> None:
        self._unbound.set()

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self.counts.received += 1
        if not self._craft.powered:
            return
        client = self._clients.get(addr)
        if client is None:
            client = self._clients[addr] = Conversation(self._craft)
            if len(self._clients) > MAX_CLIENTS:
                self._clients.popitem(last=False)
                self.counts.forgotten += 1
        self._clients.move_to_end(addr)
        for packet in client.answer(data):
            self._send(packet, addr)

    def error_received(self, exc: Exception) -> None:
        """A client went away: its port answers no more. Its own silence is what matters."""

    def _send(self, packet: bytes, addr: Address) -> None:
        if self._transport is not None:
            self._transport.sendto(packet, addr)
            self.counts.sent += 1

    async def _log(self) -> None:
        while True:
            await asyncio.sleep(LOG_TICK_S / 2)
            now_ms = self._craft.uptime_ms
            if not self._craft.powered:
                continue
            for addr, client in list(self._clients.items()):
                for packet in client.due(now_ms):
                    self._send(packet, addr)
