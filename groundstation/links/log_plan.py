"""Which log variables of a craft make telemetry, and how they fit into its log blocks.

Names differ between releases of the firmware, so each channel has several, the best first; what
is not listed is said with what it costs. A block holds 26 bytes of values.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from groundstation.errors import BadInputError, LinkError

BLOCK_BYTES = 26
TYPE_BYTES = {
    "uint8_t": 1,
    "uint16_t": 2,
    "uint32_t": 4,
    "int8_t": 1,
    "int16_t": 2,
    "int32_t": 4,
    "FP16": 2,
    "float": 4,
}
QUATERNION = "stateEstimateZ.quat"
"""Attitude in 4 bytes, see ``log_rows.decompressed``."""

Variable = tuple[str, str]
"""Full name, and the type it is sent as."""


@dataclass(frozen=True, slots=True)
class _Choice:
    """One way to a channel. names: of the variables; known_as: the same in ``log_rows``."""

    names: tuple[str, ...]
    kind: str
    known_as: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        return len(self.names) * TYPE_BYTES[self.kind]


@dataclass(frozen=True, slots=True)
class LogPlan:
    """What is asked of the craft.

    blocks: variables of each block; a row of telemetry needs one packet of each.
    known_as: variable -> the column that ``samples_from_columns`` knows.
    missing: what the craft does not have, in words.
    extra: blocks of what the user wants besides, which no row waits for.
    again: number of the block that holds the motors' commands a second time, for rows slower than
    these are set; 0: none does.
    """

    blocks: tuple[tuple[Variable, ...], ...]
    known_as: Mapping[str, str]
    missing: tuple[str, ...]
    extra: tuple[tuple[Variable, ...], ...] = ()
    again: int = 0


def _each(pattern: str, parts: str | Sequence[str]) -> tuple[str, ...]:
    return tuple(pattern.format(part) for part in parts)


_ANGLES = ("roll", "pitch", "yaw")
_GYRO = _Choice(_each("gyro.{}", "xyz"), "float")
_ACCELEROMETER = (_Choice(_each("acc.{}", "xyz"), "float"),)
_MOTORS = (  # before November 2022 motor.* was the thrust that is asked for
    _Choice(_each("pwm.m{}_pwm", "1234"), "uint16_t"),
    _Choice(_each("motor.m{}", "1234"), "uint16_t"),
)
_CHANNELS: tuple[tuple[str, str, tuple[_Choice, ...]], ...] = (
    (
        "motor commands",
        "motors and thrust cannot be identified",
        _MOTORS,
    ),
    (
        "battery voltage",
        "motors are identified from their commands once it is given (convert --supply-v)",
        (_Choice(("pm.vbatMV",), "uint16_t"), _Choice(("pm.vbat",), "float")),
    ),
    (
        "accelerometer",
        "thrust cannot be identified",
        _ACCELEROMETER,
    ),
    (
        "attitude",
        "angles cannot be compared",
        (
            _Choice(_each("stateEstimate.{}", _ANGLES), "float"),
            _Choice(_each("stabilizer.{}", _ANGLES), "float", _each("stateEstimate.{}", _ANGLES)),
        ),
    ),
    (
        "rotor speeds",
        "motors are fitted from their commands and the battery",
        (
            _Choice(_each("rpm.m{}", "1234"), "uint16_t"),
            _Choice(_each("motor.m{}_rpm", "1234"), "uint16_t", _each("rpm.m{}", "1234")),
        ),
    ),
)


def plan_log(listed: Mapping[str, str], wanted: Sequence[str] = (), slow: bool = False) -> LogPlan:
    """The blocks for a craft. listed: variable -> type, its table of contents. wanted: further
    variables. slow: the motors are set more often than rows come.

    Raises LinkError where it does not even list a gyro, BadInputError for a wanted variable that
    it does not list.
    """
    if not _is_listed(_GYRO, listed):
        raise LinkError("the craft's firmware lists no gyro.x, gyro.y and gyro.z to be logged")
    chosen, missing = [_GYRO], []
    for name, cost, choices in _CHANNELS:
        choice = next((each for each in choices if _is_listed(each, listed)), None)
        if choice is None:
            missing.append(f"no {name} ({' or '.join(c.names[0] for c in choices)}): {cost}")
        else:
            chosen.append(choice)
    if sum(choice.size for choice in chosen) > 2 * BLOCK_BYTES and QUATERNION in listed:
        # all of it in two blocks: the attitude in 4 bytes instead of 12
        attitude = _Choice((QUATERNION,), "uint32_t")
        chosen = [attitude if "roll" in each.names[0] else each for each in chosen]
    blocks = _packed(_groups(chosen))
    known_as = {
        name: column
        for choice in chosen
        for name, column in zip(choice.names, choice.known_as or choice.names, strict=True)
    }
    again = 0
    if slow and (motors := next((choice for choice in chosen if choice in _MOTORS), None)):
        # half a thousandth of 1 g is less than a tenth of the accelerometer's noise
        halved = [replace(one, kind="FP16") if one in _ACCELEROMETER else one for one in chosen]
        for way in (blocks, _packed(_groups(halved))):
            if not again:
                blocks, again = _motors_again(way, motors)
    return LogPlan(blocks, known_as, tuple(missing), _packed(_wanted(listed, wanted)), again)


def _groups(chosen: Sequence[_Choice]) -> list[list[Variable]]:
    return [[(name, choice.kind) for name in choice.names] for choice in chosen]


def _motors_again(
    blocks: tuple[tuple[Variable, ...], ...], motors: _Choice
) -> tuple[tuple[tuple[Variable, ...], ...], int]:
    """The blocks with the motors' commands in a second one as well, where one has room, and its
    number: half a period later they are often others."""
    again = tuple((name, motors.kind) for name in motors.names)
    for number, block in enumerate(blocks):
        room = BLOCK_BYTES - _size(block)
        if number > 0 and again[0] not in block and room >= motors.size:
            return (*blocks[:number], (*block, *again), *blocks[number + 1 :]), number
    return blocks, 0


def _wanted(listed: Mapping[str, str], wanted: Sequence[str]) -> list[list[Variable]]:
    for name in wanted:
        if name not in listed:
            near = difflib.get_close_matches(name, listed, n=3) or sorted(listed)[:3]
            raise BadInputError(
                f"--log {name}: the craft's firmware does not list it; near are {', '.join(near)}"
            )
    return [[(name, listed[name])] for name in wanted]


def _is_listed(choice: _Choice, listed: Mapping[str, str]) -> bool:
    return all(name in listed for name in choice.names)


def _packed(groups: Sequence[Sequence[Variable]]) -> tuple[tuple[Variable, ...], ...]:
    """Groups in as few blocks as first fit finds, none of them torn."""
    blocks: list[list[Variable]] = []
    for group in groups:
        for block in blocks:
            if _size(block) + _size(group) <= BLOCK_BYTES:
                block += group
                break
        else:
            blocks.append(list(group))
    return tuple(tuple(block) for block in blocks)


def _size(variables: Sequence[Variable]) -> int:
    return sum(TYPE_BYTES[kind] for _, kind in variables)
