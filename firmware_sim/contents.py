"""What can be logged and set: the tables of contents of the firmware of 2014 and of today's, and
what of it outlasts a power cycle.

Types are those of the log (1 u8, 2 u16, 3 u32, 4 i8, 5 i16, 6 i32, 7 float, 8 half float) and of
the parameters (8 u8, 9 u16, 10 u32, 6 float; 0x40 marks what can only be read, 0x10 what can be
stored).
"""

from __future__ import annotations

import errno
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from firmware_sim.craft import CHOSEN, CPU_ID, FLOW_DECK, HEIGHT_DECK, CraftState, StandIn
from firmware_sim.physics import DRAG_NAMES, PARAMETER_NAMES, RESET_ESTIMATOR, THRUST_NAMES
from firmware_sim.settings import StandInSettings
from firmware_sim.supervisor import CAN_FLY, CRASHED, FLYING, LEVEL_OUT, LOCKED, PASSED

U8, U16, U32, I8, I16, I32, FLOAT, HALF = range(1, 9)
TODAY = 4
"""The protocol from which on numbers in the tables have 16 bits."""
DRAG_KNOWN = 12
"""The protocol from which on the Kalman filter has a drag."""
MOTORS_16_BIT = 8
"""The protocol from which on ``motor.m1`` is an unsigned number of 16 bits."""

MISC = 3
"""The channel of the parameters' port."""
GET_EXTENDED_TYPE, STORE, GET_STATE, CLEAR, GET_DEFAULT = range(2, 7)
GET_EXTENDED_TYPE_V2, GET_DEFAULT_V2 = 7, 8
"""Commands; those of version 2 put a status before the value."""
SECOND_VERSION = 11
"""The protocol that brought them."""
PARAM_FLOAT, PARAM_U8, PARAM_U16, PARAM_U32 = 0x06, 0x08, 0x09, 0x0A
READ_ONLY, EXTENDED = 0x40, 0x10
"""Flags of a parameter's type: EXTENDED says that there is more to ask."""
FORMATS = {PARAM_FLOAT: "<f", PARAM_U8: "<B", PARAM_U16: "<H", PARAM_U32: "<I"}
PERSISTENT = 1
"""That a parameter can be stored, in its extended type."""
STORED, NOT_STORED = 1, 0
DONE, MISSING = b"\0", bytes([errno.ENOENT])
PERSISTENT_GROUPS = ("pid_rate.", "pid_attitude.")
"""What can be stored, of the parameters that the software craft has."""
_REQUEST = struct.Struct("<BH")

Variable = tuple[str, int, Callable[[CraftState], float]]
"""Full name, type, value."""


@dataclass(frozen=True, eq=False)
class Contents:
    """The tables of one craft, in the order of their numbers."""

    parameters: tuple[tuple[str, int], ...]
    variables: tuple[Variable, ...]
    most_blocks: int
    most_variables: int

    @cached_property
    def parameter_items(self) -> list[bytes]:
        return [_item(name, kind) for name, kind in self.parameters]

    @cached_property
    def log_items(self) -> list[bytes]:
        return [_item(name, kind) for name, kind, _ in self.variables]


def contents_of(craft: StandIn) -> Contents:
    """What the firmware of this craft lists."""
    has = craft.settings
    if craft.protocol < TODAY:
        return Contents(PARAMETERS, VARIABLES, most_blocks=8, most_variables=64)
    motors = U16 if craft.protocol >= MOTORS_16_BIT or has.software_build else U32
    variables = _variables_of_today(motors, has)
    absent = ("pm.", "pwm.", "deck.") if has.software_build else ()
    return Contents(
        tuple(one for one in _parameters_of_today(craft.protocol) if not one[0].startswith(absent)),
        tuple(one for one in variables if not one[0].startswith(absent)),
        most_blocks=16,
        most_variables=128,
    )


def _parts(
    group: str, kind: int, field: str, names: Sequence[str] = "xyz", *, scale: float = 1.0
) -> Iterator[Variable]:
    for index, name in enumerate(names):
        yield f"{group}.{name}", kind, partial(_part, field, index, scale)


def _part(field: str, index: int, scale: float, state: CraftState) -> float:
    return scale * float(getattr(state, field)[index])


ANGLES = ("roll", "pitch", "yaw")
COMMANDS = ("cmd_thrust", "cmd_roll", "cmd_pitch", "cmd_yaw")
SPEEDS = ("vx", "vy", "vz")
VARIANCES = ("varX", "varY", "varZ", "varPX", "varPY", "varPZ")
"""Of position, and of velocity, whose letter is that of momentum."""
MOTORS = ("m1", "m2", "m3", "m4")

PARAMETERS: tuple[tuple[str, int], ...] = tuple(
    (name, PARAM_U8 if name in ("imu_acc_lpf.factor", "flightmode.althold") else PARAM_FLOAT)
    for name in PARAMETER_NAMES
)
"""Of 2014."""

VARIABLES: tuple[Variable, ...] = (
    *_parts("stabilizer", FLOAT, "angles_deg", ANGLES),
    ("stabilizer.thrust", U16, lambda s: s.thrust),
    *_parts("gyro", FLOAT, "gyro_dps"),
    *_parts("acc", FLOAT, "accel_g"),
    *_parts("motor", I32, "motors", MOTORS),
    ("pm.vbat", FLOAT, lambda s: s.battery_v),
    ("pm.state", I8, lambda s: s.power_state),
)
"""Of 2014."""


def _parameters_of_today(protocol: int) -> Iterator[tuple[str, int]]:
    for name, kind in PARAMETERS:
        if not name.startswith(("sensorfusion6.", "imu_acc_lpf.")):
            yield name, kind | (EXTENDED if name.startswith(PERSISTENT_GROUPS) else 0)
    for name in CHOSEN:
        yield name, PARAM_U8
    for name in (HEIGHT_DECK, FLOW_DECK):
        yield name, PARAM_U8 | READ_ONLY
    for name in CPU_ID:
        yield name, PARAM_U32 | READ_ONLY
    yield RESET_ESTIMATOR, PARAM_U8
    for name in THRUST_NAMES:
        yield name, PARAM_U16
    if protocol >= DRAG_KNOWN:
        for name in DRAG_NAMES:
            yield name, PARAM_FLOAT


def _variables_of_today(motors: int, has: StandInSettings) -> Iterator[Variable]:
    yield from _parts("gyro", FLOAT, "gyro_dps")
    yield from _parts("acc", FLOAT, "accel_g")
    yield from _parts("stabilizer", FLOAT, "angles_deg", ANGLES)
    yield "stabilizer.thrust", FLOAT, lambda s: s.thrust
    yield from _parts("stateEstimate", FLOAT, "angles_deg", ANGLES)
    for index, name in enumerate(("qx", "qy", "qz", "qw")):
        yield f"stateEstimate.{name}", FLOAT, partial(_quaternion_part, index)
    yield "stateEstimateZ.quat", U32, lambda s: compressed(quaternion_of(s.angles_deg))
    yield from _parts("motor", motors, "motors", MOTORS)
    yield from _parts("controller", FLOAT, "commands", COMMANDS)
    yield from _parts("pwm", U32, "motors", [f"{m}_pwm" for m in MOTORS])
    yield "pm.vbat", FLOAT, lambda s: s.battery_v
    yield "pm.vbatMV", U16, lambda s: 1000.0 * s.battery_v
    yield "pm.state", I8, lambda s: s.power_state
    yield "supervisor.info", U16, supervisor_bits
    if has.rotor_speed_deck:
        yield from _parts("rpm", U16, "rotor_rev_s", MOTORS, scale=60.0)
    yield from _parts("stateEstimate", FLOAT, "estimate_m")
    yield from _parts("stateEstimate", FLOAT, "estimate_m_s", SPEEDS)
    yield from _parts("stateEstimateZ", I16, "estimate_m", scale=1000.0)
    yield from _parts("stateEstimateZ", I16, "estimate_m_s", SPEEDS, scale=1000.0)
    yield from _parts("kalman", FLOAT, "variances", VARIANCES)
    if has.height_deck or has.flow_deck:
        yield "range.zrange", U16, lambda s: 1000.0 * s.range_m


def supervisor_bits(state: CraftState) -> int:
    """Can be armed, is armed, arms itself, can fly, flies, has tumbled, is locked, has crashed."""
    at = state.supervisor
    bits = (
        at == PASSED,
        state.armed,
        state.arms_itself,
        at in CAN_FLY,
        at in (FLYING, LEVEL_OUT),
        state.tumbled,
        at == LOCKED,
        at == CRASHED,
    )
    return sum(bit << place for place, bit in enumerate(bits))


def _quaternion_part(index: int, state: CraftState) -> float:
    return quaternion_of(state.angles_deg)[index]


def quaternion_of(angles_deg: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """(x, y, z, w), body to inertial, from roll, pitch (nose up) and yaw in deg."""
    roll, pitch, yaw = (math.radians(angle) / 2 for angle in angles_deg)
    pitch = -pitch
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def compressed(quaternion: tuple[float, float, float, float]) -> int:
    """32 bits: the place of the largest part, then sign and 9 bits of each of the others."""
    largest = max(range(4), key=lambda i: abs(quaternion[i]))
    code = largest
    for index, part in enumerate(quaternion):
        if index != largest:
            negative = (part < 0) != (quaternion[largest] < 0)
            code = code << 10 | negative << 9 | int(511 * abs(part) * math.sqrt(2) + 0.5)
    return code


def _item(name: str, kind: int) -> bytes:
    group, _, variable = name.partition(".")
    return bytes([kind]) + group.encode() + b"\0" + variable.encode() + b"\0"


def form_of(kind: int) -> struct.Struct:
    """How a value of a parameter's type is sent."""
    return struct.Struct(FORMATS[kind & ~(READ_ONLY | EXTENDED)])


def packed(kind: int, value: float) -> bytes:
    """A value as it is sent."""
    form = form_of(kind)
    return form.pack(value if form.format == "<f" else int(value))


def misc_answer(
    craft: StandIn, parameters: tuple[tuple[str, int], ...], data: bytes
) -> bytes | None:
    """What a request of the misc channel is answered, by which today's firmware keeps parameters in
    its EEPROM; None: nothing.

    A request is a command and the parameter's number, 16 bits, little-endian; the answer repeats
    both. What is stored is loaded when the craft is switched on, over the value that its image was
    built with; storing and clearing change no value that flies. parameters: name and type of each,
    in the order of their numbers.
    """
    if len(data) < _REQUEST.size:
        return None
    asked = data[: _REQUEST.size]
    command, number = _REQUEST.unpack(asked)
    newer = command in (GET_EXTENDED_TYPE_V2, GET_DEFAULT_V2)
    if not GET_EXTENDED_TYPE <= command <= GET_DEFAULT_V2:
        return None
    if newer and craft.protocol < SECOND_VERSION:
        return None
    if number >= len(parameters):
        return asked + MISSING
    name, kind = parameters[number]
    before = DONE if newer else b""
    if command in (GET_DEFAULT, GET_DEFAULT_V2):
        known = not kind & READ_ONLY
        return asked + (before + packed(kind, craft.default_of(name)) if known else MISSING)
    if not kind & EXTENDED:
        return asked + MISSING
    if command in (GET_EXTENDED_TYPE, GET_EXTENDED_TYPE_V2):
        return asked + before + bytes([PERSISTENT])
    if command == GET_STATE:
        default, stored = packed(kind, craft.default_of(name)), craft.stored.get(name)
        if stored is None:
            return asked + bytes([NOT_STORED]) + default
        return asked + bytes([STORED]) + default + packed(kind, stored)
    return asked + (DONE if _kept(craft, command, name) else MISSING)


def _kept(craft: StandIn, command: int, name: str) -> bool:
    """Store or clear a parameter; whether that was done. A build that runs in software has no
    EEPROM, and there is nothing to clear of what is not stored."""
    if craft.settings.software_build:
        return False
    if command == STORE:
        craft.stored[name] = craft.get_parameter(name)
        return True
    return craft.stored.pop(name, None) is not None
