"""The firmware's side of CRTP, protocol version 1: commander, parameters, logging, console.

One datagram is one packet: a header byte (port << 4 | channel) and up to 30 bytes of data.
``Conversation`` is the protocol for one client, without I/O; ``crtp_server`` puts it on UDP.
"""

from __future__ import annotations

import errno
import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_sim.craft import CraftState, StandIn
from firmware_sim.physics import PARAMETER_NAMES

CONSOLE, PARAM, COMMANDER, MEM, LOG, LINK = 0, 2, 3, 4, 5, 15
MAX_DATA = 30
MAX_BLOCKS, MAX_VARIABLES, MAX_LOG_BYTES = 8, 64, 26
NULL_PACKET = b"\xff"

_PARAM_FLOAT, _PARAM_U8 = 0x06, 0x08
_PARAM_FORMAT = {_PARAM_FLOAT: "<f", _PARAM_U8: "<B"}
_LOG_FORMAT = {1: "<B", 2: "<H", 3: "<I", 4: "<b", 5: "<h", 6: "<i", 7: "<f"}
_LOG_LIMITS = {
    1: (0, 255),
    2: (0, 65535),
    3: (0, 2**32 - 1),
    4: (-128, 127),
    5: (-32768, 32767),
    6: (-(2**31), 2**31 - 1),
}
_SETPOINT = struct.Struct("<fffH")

BANNER = (
    "SYS: ----------------------------\n"
    "SYS: Crazyflie is up and running!\n"
    "SYS: firmware stand-in, 2014.01.0\n"
)

PARAMETERS: tuple[tuple[str, int], ...] = tuple(
    (name, _PARAM_U8 if name in ("imu_acc_lpf.factor", "flightmode.althold") else _PARAM_FLOAT)
    for name in PARAMETER_NAMES
)
"""(full name, type) in the order of the table of contents."""

VARIABLES: tuple[tuple[str, int, Callable[[CraftState], float]], ...] = (
    ("stabilizer.roll", 7, lambda s: s.angles_deg[0]),
    ("stabilizer.pitch", 7, lambda s: s.angles_deg[1]),
    ("stabilizer.yaw", 7, lambda s: s.angles_deg[2]),
    ("stabilizer.thrust", 2, lambda s: s.thrust),
    ("gyro.x", 7, lambda s: s.gyro_dps[0]),
    ("gyro.y", 7, lambda s: s.gyro_dps[1]),
    ("gyro.z", 7, lambda s: s.gyro_dps[2]),
    ("acc.x", 7, lambda s: s.accel_g[0]),
    ("acc.y", 7, lambda s: s.accel_g[1]),
    ("acc.z", 7, lambda s: s.accel_g[2]),
    ("motor.m1", 6, lambda s: s.motors[0]),
    ("motor.m2", 6, lambda s: s.motors[1]),
    ("motor.m3", 6, lambda s: s.motors[2]),
    ("motor.m4", 6, lambda s: s.motors[3]),
    ("pm.vbat", 7, lambda s: s.battery_v),
    ("pm.state", 4, lambda s: s.power_state),
)
"""(full name, type, value) of what can be logged, in the order of the table of contents."""


@dataclass(slots=True)
class LogBlock:
    """What a client asked to be logged: (variable, type to send it as)."""

    variables: list[tuple[int, int]] = field(default_factory=list)
    period_ms: int = 0
    next_ms: int = 0


class Conversation:
    """CRTP with one client: its packets in, the craft's answers out."""

    def __init__(self, craft: StandIn) -> None:
        self._craft = craft
        self._blocks: dict[int, LogBlock] = {}

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
        elif port == PARAM:
            return [bytes([packet[0]]) + body for body in self._parameter(channel, data)]
        elif port == LOG:
            return [bytes([packet[0]]) + body for body in self._log(channel, data)]
        elif port == MEM and channel == 0 and data[:1] == b"\x01":
            return [bytes([packet[0], 1, 0])]
        elif port == LINK and channel == 0:
            return [packet]
        elif port == LINK and channel == 1:
            return [bytes([packet[0]]) + bytes(MAX_DATA), *_console(BANNER)]
        return []

    def due(self, now_ms: int) -> list[bytes]:
        """Log packets due at a device time in ms (10 ms grid)."""
        out = []
        state: CraftState | None = None
        for number, block in self._blocks.items():
            if block.period_ms == 0 or now_ms < block.next_ms:
                continue
            block.next_ms = now_ms + block.period_ms - now_ms % block.period_ms
            state = state or self._craft.state()
            stamp = (now_ms & 0xFFFFFF).to_bytes(3, "little")
            values = b"".join(_log_value(state, *variable) for variable in block.variables)
            out.append(bytes([LOG << 4 | 2, number]) + stamp + values)
        return out

    def _setpoint(self, data: bytes) -> None:
        if len(data) != _SETPOINT.size:
            return
        roll, pitch, yaw, thrust = _SETPOINT.unpack(data)
        if all(map(math.isfinite, (roll, pitch, yaw))):
            self._craft.command(roll, pitch, yaw, thrust)

    def _parameter(self, channel: int, data: bytes) -> list[bytes]:
        if not data:
            return []
        if channel == 0:
            return _contents(data, PARAMETER_CONTENTS, b"")
        number = data[0]
        if number >= len(PARAMETERS):
            return [bytes([0xFF, number, errno.ENOENT])]
        name, kind = PARAMETERS[number]
        form = struct.Struct(_PARAM_FORMAT[kind])
        if channel == 2 and len(data) == 1 + form.size:
            value = form.unpack(data[1:])[0]
            # A value that is no number would leave the loops undefined: what is set stays.
            if math.isfinite(value):
                self._craft.set_parameter(name, value)
        elif channel != 1:
            return []
        value = self._craft.get_parameter(name)
        return [bytes([number]) + form.pack(value if kind == _PARAM_FLOAT else int(value))]

    def _log(self, channel: int, data: bytes) -> list[bytes]:
        if not data:
            return []
        if channel == 0:
            return _contents(data, LOG_CONTENTS, bytes([MAX_BLOCKS, MAX_VARIABLES]))
        if channel != 1:
            return []
        command, number = data[0], data[1] if len(data) > 1 else 0
        return [bytes([command, number, self._control(command, number, data[2:])])]

    def _control(self, command: int, number: int, data: bytes) -> int:
        block = self._blocks.get(number)
        if command == 5:
            self._blocks.clear()
            return 0
        if command == 0:
            if block is not None:
                return errno.EEXIST
            if len(self._blocks) >= MAX_BLOCKS:
                return errno.ENOMEM
            block = LogBlock()
            error = self._append(block, data)
            if error == 0:
                self._blocks[number] = block
            return error
        if command not in (1, 2, 3, 4):
            return errno.ENOEXEC
        if block is None:
            return errno.ENOENT
        if command == 1:
            return self._append(block, data)
        if command == 2:
            del self._blocks[number]
        elif command == 3:
            if not data:
                return errno.ENOEXEC
            block.period_ms, block.next_ms = 10 * data[0], 0
        else:
            block.period_ms = 0
        return 0

    def _append(self, block: LogBlock, data: bytes) -> int:
        added = [(data[i + 1], data[i] & 0x0F) for i in range(0, len(data) - 1, 2)]
        for variable, kind in added:
            if variable >= len(VARIABLES) or kind not in _LOG_FORMAT:
                return errno.ENOENT
        if sum(len(b.variables) for b in self._blocks.values()) + len(added) > MAX_VARIABLES:
            return errno.ENOMEM
        both = block.variables + added
        if sum(struct.calcsize(_LOG_FORMAT[kind]) for _, kind in both) > MAX_LOG_BYTES:
            return errno.E2BIG
        block.variables = both
        return 0


def _contents(data: bytes, items: list[bytes], limits: bytes) -> list[bytes]:
    """A table of contents: its size and checksum, or one item."""
    if data[0] == 1:
        checksum = zlib.crc32(b"".join(items)).to_bytes(4, "little")
        return [bytes([1, len(items)]) + checksum + limits]
    if data[0] == 0 and len(data) > 1:
        if data[1] < len(items):
            return [bytes([0, data[1]]) + items[data[1]]]
        return [bytes([0])]
    return []


def _item(name: str, kind: int) -> bytes:
    group, _, variable = name.partition(".")
    return bytes([kind]) + group.encode() + b"\0" + variable.encode() + b"\0"


PARAMETER_CONTENTS = [_item(name, kind) for name, kind in PARAMETERS]
LOG_CONTENTS = [_item(name, kind) for name, kind, _ in VARIABLES]


def _log_value(state: CraftState, variable: int, kind: int) -> bytes:
    value = VARIABLES[variable][2](state)
    if kind == 7:
        return struct.pack("<f", value)
    low, high = _LOG_LIMITS[kind]
    return struct.pack(_LOG_FORMAT[kind], int(min(max(value, low), high)))


def _console(text: str) -> list[bytes]:
    raw = text.encode()
    return [bytes([CONSOLE << 4]) + raw[i : i + MAX_DATA] for i in range(0, len(raw), MAX_DATA)]
