"""Parameters that outlast a power cycle: what today's firmware keeps in its EEPROM, and how clients
ask for it (CRTP port 2, channel 3).

A request is a command and the parameter's number, 16 bits, little-endian; the answer repeats both.
What is stored is loaded when the craft is switched on, over the value that its image was built
with; storing and clearing change no value that flies.
"""

from __future__ import annotations

import errno
import struct
from typing import Any, Protocol

MISC = 3
"""The channel of the parameters' port."""
GET_EXTENDED_TYPE, STORE, GET_STATE, CLEAR, GET_DEFAULT = range(2, 7)
GET_EXTENDED_TYPE_V2, GET_DEFAULT_V2 = 7, 8
"""Commands; those of version 2 put a status before the value."""
SECOND_VERSION = 11
"""The protocol that brought them."""
PARAM_FLOAT, PARAM_U8, PARAM_U32 = 0x06, 0x08, 0x0A
READ_ONLY, EXTENDED = 0x40, 0x10
"""Flags of a parameter's type: EXTENDED says that there is more to ask."""
FORMATS = {PARAM_FLOAT: "<f", PARAM_U8: "<B", PARAM_U32: "<I"}
PERSISTENT = 1
"""That a parameter can be stored, in its extended type."""
STORED, NOT_STORED = 1, 0
DONE, MISSING = b"\0", bytes([errno.ENOENT])
PERSISTENT_GROUPS = ("pid_rate.", "pid_attitude.")
"""What can be stored, of the parameters that the software craft has."""
_REQUEST = struct.Struct("<BH")


class Keeper(Protocol):
    """A craft. stored: by full name."""

    protocol: int
    settings: Any
    stored: dict[str, float]

    def get_parameter(self, name: str) -> float: ...

    def default_of(self, name: str) -> float: ...


def form_of(kind: int) -> struct.Struct:
    """How a value of a parameter's type is sent."""
    return struct.Struct(FORMATS[kind & ~(READ_ONLY | EXTENDED)])


def packed(kind: int, value: float) -> bytes:
    """A value as it is sent."""
    form = form_of(kind)
    return form.pack(value if form.format == "<f" else int(value))


def value_in(record: Any, name: str) -> float:
    """A parameter in a record of the firmware (``layout``)."""
    from firmware_sim.physics import gain_place

    column, axis = gain_place(name)
    value = record[column]
    return float(value if axis < 0 else value[axis])


def set_in(record: Any, name: str, value: float) -> None:
    """Set it there."""
    from firmware_sim.physics import gain_place

    column, axis = gain_place(name)
    if axis < 0:
        record[column] = value
    else:
        record[column][axis] = value


def answer(craft: Keeper, parameters: tuple[tuple[str, int], ...], data: bytes) -> bytes | None:
    """What a request of the misc channel is answered; None: nothing.

    parameters: name and type of each, in the order of their numbers.
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


def _kept(craft: Keeper, command: int, name: str) -> bool:
    """Store or clear a parameter; whether that was done. A build that runs in software has no
    EEPROM, and there is nothing to clear of what is not stored."""
    if craft.settings.software_build:
        return False
    if command == STORE:
        craft.stored[name] = craft.get_parameter(name)
        return True
    return craft.stored.pop(name, None) is not None
