"""From a craft's log blocks to samples: which variables are asked for, and the rows they make."""

from __future__ import annotations

import difflib
import math
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, LinkError
from groundstation.recording.motor_columns import samples_from_columns
from groundstation.telemetry.decoder import DecoderCounts
from groundstation.telemetry.packet import FULL_16_BIT
from groundstation.telemetry.samples import LogTable, SampleBatch, empty_samples

# Which log variables of a craft make telemetry, and how they fit into its log blocks.
#
# Names differ between releases of the firmware, so each channel has several, the best first; what
# is not listed is said with what it costs. A block holds 26 bytes of values.


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
    ("motor commands", "motors and thrust cannot be identified", _MOTORS),
    (
        "battery voltage",
        "motors are identified from their commands once it is given (convert --supply-v)",
        (_Choice(("pm.vbatMV",), "uint16_t"), _Choice(("pm.vbat",), "float")),
    ),
    ("accelerometer", "thrust cannot be identified", _ACCELEROMETER),
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


# From the packets of a craft's log blocks to samples; pure.
#
# A packet has a stamp of 24 bits in ms and no number: time is unwrapped with the host's clock,
# and what was lost shows only as a missing step. The blocks of one period are started one after
# the other, so their stamps may differ by a constant part of it: a row has the stamps of the
# first block, and the others are read there, on the line between their neighbours where they are
# not from the same moment. The motors are set 500 times a second: where rows are slower and a
# second block has their commands as well, a row holds the mean of both settings that acted before
# it, and their difference: today's attitude is new in every second of them, so they alternate
# with what its derivative makes of that, and motors that brake otherwise than they speed up
# answer to it.


TICK_S = 1e-6
"""Device time is kept in microseconds, as in microSD logs."""
WRAP_MS = 1 << 24
BACKWARDS_MS = 100
"""Blocks share one queue, so their stamps run forward: one so far back is a restart's, and readings
from before belong to no row that is to come."""
MOTORS = 4
"""Commands of 16 bits in a block."""
SETTING_MS = 2
"""How long the motors keep a command."""
_WRAPPING = ("stateEstimate.roll", "stateEstimate.yaw")

LogPacket = tuple[int, int, tuple[float, ...], int]
"""Number of the block in the plan, stamp, values, host time (Unix ns)."""


@dataclass(slots=True)
class _Reading:
    time_ms: int
    values: tuple[float, ...]
    host_ns: int


@dataclass(slots=True)
class LogRows:
    """Packets in, rows out. plan, period_ms: as the craft was asked. segment: of the first row.

    apart_ms: how far the blocks' stamps were apart at most.
    """

    plan: LogPlan
    period_ms: int
    segment: int = 0
    apart_ms: int = 0
    _counts: Counter[str] = field(default_factory=Counter)  # as ``DecoderCounts``
    _waiting: list[deque[_Reading]] = field(default_factory=list)
    _newest: tuple[int, int] | None = None  # time, host time
    _last_ms: int | None = None  # of the last row of this segment
    _host_ns: int = 0
    _extra: dict[int, list[_Reading]] = field(default_factory=dict)
    _set: tuple[NDArray[Any], ...] | None = None  # time, segment, motors of the last row

    def __post_init__(self) -> None:
        self._waiting = [deque() for _ in self.plan.blocks]

    def add(self, packets: Iterable[LogPacket]) -> SampleBatch:
        """The rows that these packets complete; those of ``plan.extra`` wait for ``take_extra``."""
        rows: list[tuple[int, int, int, tuple[float, ...]]] = []
        for block, stamp, values, host_ns in packets:
            if block >= len(self._waiting):
                if self._newest is not None:  # else nobody knows the time of it yet
                    time_ms = self._unwrapped(stamp, host_ns)
                    self._extra.setdefault(block, []).append(_Reading(time_ms, values, host_ns))
                continue
            self._counts["packets"] += 1
            time_ms = self._unwrapped(stamp, host_ns)
            if self._newest is not None and time_ms < self._newest[0] - BACKWARDS_MS:
                self._counts["restarts"] += 1
                self._newest = None
                self._begin_segment()
            readings = self._waiting[block]
            if readings and time_ms <= readings[-1].time_ms:
                self._counts["late"] += 1
                continue
            readings.append(_Reading(time_ms, values, host_ns))
            if self._newest is None or time_ms > self._newest[0]:
                self._newest = time_ms, host_ns
            rows += self._complete()
            while len(readings) > 1 and readings[1].time_ms < self._newest[0] - BACKWARDS_MS:
                readings.popleft()
        return self._samples(rows)

    def take_extra(self) -> list[LogTable]:
        """What has come of ``plan.extra`` since the last call: a table for each block."""
        extra, self._extra = self._extra, {}
        several = len(self.plan.extra) > 1
        tables = []
        for block, readings in sorted(extra.items()):
            number = block - len(self.plan.blocks)
            names = [name for name, _ in self.plan.extra[number]]
            values = np.array([one.values for one in readings], np.float64)
            tables.append(
                LogTable(
                    f"log{number + 1}" if several else "log",
                    np.array([one.host_ns for one in readings], np.int64),
                    np.array([one.time_ms for one in readings], np.float64) / 1000.0,
                    {name: values[:, column] for column, name in enumerate(names)},
                )
            )
        return tables

    def counts(self) -> DecoderCounts:
        """Totals, as those of packets of telemetry."""
        return DecoderCounts(**self._counts)

    def restart(self, plan: LogPlan, period_ms: int) -> None:
        """The craft was asked anew, or again: what follows is another segment."""
        self.plan, self.period_ms = plan, period_ms
        self._newest, self._extra = None, {}
        self._begin_segment()

    def _begin_segment(self) -> None:
        if self._last_ms is not None:
            self.segment += 1
        self._last_ms = None
        self._waiting = [deque() for _ in self.plan.blocks]

    def _unwrapped(self, stamp: int, host_ns: int) -> int:
        if self._newest is None:
            return stamp
        time_ms, seen_ns = self._newest
        expected = time_ms + (host_ns - seen_ns) / 1e6
        return stamp + WRAP_MS * round((expected - stamp) / WRAP_MS)

    def _complete(self) -> list[tuple[int, int, int, tuple[float, ...]]]:
        """(time, host time, segment, values of all blocks) of the rows that need not wait."""
        rows = []
        first, others = self._waiting[0], self._waiting[1:]
        assert self._newest is not None
        while first:
            reading = first[0]
            read = [self._read_at(block, reading.time_ms) for block in range(1, len(self._waiting))]
            final = self._newest[0] >= reading.time_ms + 2 * self.period_ms
            if not final and any(one is None for one in read):
                break
            first.popleft()
            parts = [one for one in read if one is not None]
            if len(parts) == len(read):
                values = sum((one.values for one in parts), reading.values)
                host_ns = max([reading.host_ns, *(one.host_ns for one in parts), self._host_ns])
                self._host_ns = host_ns
                self._count(reading.time_ms)
                rows.append((reading.time_ms, host_ns, self.segment, values))
            for readings in others:
                while len(readings) > 1 and readings[1].time_ms <= reading.time_ms:
                    readings.popleft()
        return rows

    def _read_at(self, block: int, time_ms: int) -> _Reading | None:
        """A block at the time of a row: the reading of that moment, or between two neighbours."""
        before = after = None
        for one in self._waiting[block]:
            if one.time_ms <= time_ms:
                before = one
            else:
                after = one
                break
        same = 1 if self.period_ms > 2 else 0  # a timer may be served one tick late
        near = [one for one in (before, after) if one and abs(one.time_ms - time_ms) <= same]
        if near:
            one = min(near, key=lambda one: abs(one.time_ms - time_ms))
            if block == self.plan.again:  # the same as in the first block
                unknown = (math.nan,) * MOTORS
                one = replace(one, values=(*one.values[:-MOTORS], *unknown))
            return one
        if before is None or after is None:
            return None
        span = after.time_ms - before.time_ms
        if span > 1.5 * self.period_ms:
            return None
        apart_ms = min(time_ms - before.time_ms, after.time_ms - time_ms)
        self.apart_ms = max(self.apart_ms, apart_ms)
        share = (time_ms - before.time_ms) / span
        names = [name for name, _ in self.plan.blocks[block]]
        values = tuple(
            self._between(name, share, *pair)
            for name, *pair in zip(names, before.values, after.values, strict=True)
        )
        if block == self.plan.again:  # as they were set, and before the row
            values = (*values[:-MOTORS], *before.values[-MOTORS:])
        return _Reading(time_ms, values, after.host_ns)

    def _between(self, name: str, share: float, before: float, after: float) -> float:
        if name == QUATERNION:  # a code, not a number
            return before if share < 0.5 else after
        change = after - before
        if self.plan.known_as[name] in _WRAPPING:
            change = (change + 180.0) % 360.0 - 180.0
        return before + share * change

    def _count(self, time_ms: int) -> None:
        c = self._counts
        c["samples"] += 1
        if self._last_ms is not None:
            lost = round((time_ms - self._last_ms) / self.period_ms) - 1
            if lost > 0:
                c.update(lost=lost, bursts=1)
                c["longest_burst"] = max(c["longest_burst"], lost)
        self._last_ms = time_ms

    def _samples(self, rows: list[tuple[int, int, int, tuple[float, ...]]]) -> SampleBatch:
        if not rows:
            return empty_samples(0, TICK_S)
        names = [name for block in self.plan.blocks for name, _ in block]
        table = np.array([values for *_, values in rows], np.float64)
        again = table[:, :0]
        if self.plan.again:
            last = sum(map(len, self.plan.blocks[: self.plan.again + 1]))
            between = slice(last - MOTORS, last)
            again = table[:, between]
            table = np.delete(table, between, axis=1)
            del names[between]
        columns: dict[str, NDArray[Any]] = {
            self.plan.known_as[name]: table[:, column] for column, name in enumerate(names)
        }
        if QUATERNION in columns:
            codes = columns.pop(QUATERNION).astype(np.uint32)
            parts = decompressed(codes)
            columns |= {f"stateEstimate.q{part}": parts[:, i] for i, part in enumerate("xyzw")}
        ticks = np.array([time_ms for time_ms, *_ in rows], np.int64) * round(1e-3 / TICK_S)
        samples, _ = samples_from_columns(columns, ticks, TICK_S, "deg/s")
        samples.host_time_ns[:] = [host_ns for _, host_ns, *_ in rows]
        samples.segment[:] = [segment for _, _, segment, _ in rows]
        follows = self._as_they_acted(samples)
        if again.size:
            step = again / FULL_16_BIT - samples.duty
            both = np.isfinite(step)
            samples.duty[both] += 0.5 * step[both]
            if self.period_ms == 2 * SETTING_MS:
                both &= follows[:, None]
                samples.duty_step[both] = step[both]
        return samples

    def _as_they_acted(self, samples: SampleBatch) -> NDArray[np.bool_]:
        """A block holds what the motors were set to after its gyro was read; a row has what acted
        before: the row before's. The first row, and one behind a loss, keeps its own: the rest
        (n,) is returned."""
        columns: tuple[NDArray[Any], ...] = (samples.ticks, samples.segment, samples.duty.copy())
        last = self._set if self._set is not None else tuple(one[:1] for one in columns)
        self._set = tuple(column[-1:] for column in columns)
        ticks, segment, duty = (
            np.concatenate([old, new[:-1]]) for old, new in zip(last, columns, strict=True)
        )
        step = samples.ticks - ticks
        follows = (segment == samples.segment) & (step > 0)
        follows &= step * TICK_S < 1.5e-3 * self.period_ms
        samples.duty[follows] = duty[follows]
        return np.asarray(follows)


def decompressed(codes: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Unit quaternions (n, 4), x y z w, from the firmware's 32 bits (n,).

    The two highest bits are the place of the largest part, which is positive; then, in order, a
    sign and 9 bits of magnitude of each other part, full scale 1/sqrt(2).
    """
    parts = np.zeros((len(codes), 4))
    largest = codes >> 30
    shift = np.full(len(codes), 20)
    for place in range(4):
        others = largest != place
        code = codes >> np.maximum(shift, 0).astype(np.uint32)
        size = (code & 511) / 511.0 * math.sqrt(0.5)
        parts[others, place] = np.where(code & 512, -size, size)[others]
        shift -= np.where(others, 10, 0)
    rest = np.maximum(1.0 - (parts**2).sum(axis=1), 0.0)
    parts[np.arange(len(codes)), largest] = np.sqrt(rest)
    return parts
