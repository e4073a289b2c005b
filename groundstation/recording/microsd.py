"""Logs of the Crazyflie's microSD card deck (binary versions 1 and 2).

Little-endian: byte 0xBC; version u16; number of event types u16; per type its id u16 (0xFFFF
for the fixed-frequency one), its name, the number of variables u16 and each variable as
``group.name(letter)``, texts ended by NUL; then records of event id u16, timestamp (version
1: u32 in ms, version 2: u64 in us) and packed values; last the CRC-32 of all before.
"""

from __future__ import annotations

import bisect
import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.paths import reading
from groundstation.recording.column_map import in_order, read_mapped
from groundstation.recording.delimited import ColumnTable
from groundstation.recording.motor_columns import (
    COMMANDS,
    DIFFERS,
    differs,
    motor_columns_of,
    samples_from_columns,
    settle_duty,
)
from groundstation.recording.session import (
    SYNTHESISED,
    TODAY,
    Findings,
    Recording,
    Table,
    host_time_from_ticks,
)
from groundstation.telemetry.packet import FULL_16_BIT
from groundstation.telemetry.samples import SampleBatch

# Where the records of a microSD log lie, in a sound file and in a damaged one.


CRC_BYTES = 4
"""The checksum after the last record."""
Offsets = dict[int, NDArray[np.int64]]
"""Event id -> byte position of each of its records."""
Dtypes = Mapping[int, np.dtype[Any]]
"""Event id -> a record: ``#id`` u2, ``#time`` u4 or u8, then the variables."""

_NEAR_US = 1_000_000
"""Two records in a row are closer in time than this, but for a pause of the logger."""
_CHAIN = 3
"""So many records in a row must fit before a place behind damage is trusted."""


def scan(
    data: bytes, first_record: int, dtypes: Dtypes, time_unit_us: int
) -> tuple[Offsets, list[str]]:
    """Positions of the records of a file whose checksum matches.

    Returns the positions and a line for what is left over (a fault of the logger).
    """
    sizes = {number: dtype.itemsize for number, dtype in dtypes.items()}
    found: dict[int, list[int]] = {number: [] for number in sizes}
    position, end = first_record, len(data) - CRC_BYTES
    while position < end:
        number = data[position] | data[position + 1] << 8
        size = sizes.get(number)
        if size is None or position + size > end:
            break
        found[number].append(position)
        position += size
    damage = []
    if position < end:
        damage.append(
            f"byte {position}: no record of an event that the header names; "
            f"{end - position} bytes left out"
        )
    return _arrays(found), damage


def scan_damaged(
    data: bytes, first_record: int, dtypes: Dtypes, time_unit_us: int
) -> tuple[Offsets, list[str]]:
    """Positions of the records that still read, and a line for each thing that is wrong.

    A record counts if its event exists and its time is near the one before. Where that fails,
    reading resumes at the next place from which several records in a row fit.
    """
    walk = _Walk(data, dtypes, time_unit_us)
    found: dict[int, list[int]] = {number: [] for number in dtypes}
    damage = []
    position, end = first_record, len(data)
    last: _Step | None = None
    while end - position > CRC_BYTES:
        step = walk.step(position)
        if step is None and walk.is_cut_off(position):
            break
        if step is None or (last and abs(step.time_us - last.time_us) > _NEAR_US):
            resumed = walk.resume(position if last is None else last.start + 1)
            if last is not None and walk.is_false(last, resumed):
                found[last.number].pop()
                position = last.start
            if resumed > position:
                damage.append(f"bytes {position}..{resumed - 1} are no records and were left out")
            position = resumed
            step = walk.step(position)
            if step is None:
                break
        found[step.number].append(position)
        last, position = step, step.end
    left = end - position
    if left == CRC_BYTES:
        damage.append("the checksum does not match: some values may be wrong, or the end is torn")
    elif left:
        damage.append(f"the file is torn: it ends inside the record that starts at byte {position}")
    else:
        damage.append("the file is torn: its checksum is missing")
    return _arrays(found), damage


def longest_in_order(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """The most rows that can be kept so that time never runs backwards, shape (n,)."""
    keep = np.ones(len(times), np.bool_)
    if np.all(np.diff(times) >= 0):
        return keep
    ends: list[int] = []
    last_rows: list[int] = []
    previous = np.full(len(times), -1)
    for row, time in enumerate(times.tolist()):
        length = bisect.bisect_right(ends, time)
        previous[row] = last_rows[length - 1] if length else -1
        ends[length : length + 1] = [time]
        last_rows[length : length + 1] = [row]
    keep[:] = False
    row = last_rows[-1]
    while row >= 0:
        keep[row] = True
        row = int(previous[row])
    return keep


@dataclass(frozen=True, slots=True)
class _Step:
    number: int
    start: int
    end: int
    time_us: int


class _Walk:
    """One record at a time through bytes that may be damaged."""

    def __init__(self, data: bytes, dtypes: Dtypes, time_unit_us: int) -> None:
        self._data = data
        self._sizes = {number: dtype.itemsize for number, dtype in dtypes.items()}
        self._time_bytes = {n: dtype["#time"].itemsize for n, dtype in dtypes.items()}
        self._unit_us = time_unit_us

    def step(self, position: int) -> _Step | None:
        """The record at ``position``, if an event has this id and it lies in the file."""
        number = int.from_bytes(self._data[position : position + 2], "little")
        size = self._sizes.get(number)
        if size is None or position + size > len(self._data):
            return None
        stamp = self._data[position + 2 : position + 2 + self._time_bytes[number]]
        time_us = int.from_bytes(stamp, "little") * self._unit_us
        return _Step(number, position, position + size, time_us)

    def is_cut_off(self, position: int) -> bool:
        """Whether a record starts here and the end of the file cuts it off."""
        number = int.from_bytes(self._data[position : position + 2], "little")
        return number in self._sizes and position + self._sizes[number] > len(self._data)

    def is_false(self, last: _Step, resumed: int) -> bool:
        """Whether damage turned one event's id into another's: then the length is wrong."""
        sizes = set(self._sizes.values())
        return resumed < last.end or (
            resumed - last.end not in sizes
            and resumed - last.start in sizes - {last.end - last.start}
        )

    def resume(self, position: int) -> int:
        """The first place at or after ``position`` where records follow each other."""
        marks = [struct.pack("<H", number) for number in self._sizes]
        while True:
            places = [place for mark in marks if (place := self._data.find(mark, position)) >= 0]
            if not places:
                return len(self._data)
            position = min(places)
            if self._is_chain(position):
                return position
            position += 1

    def _is_chain(self, position: int) -> bool:
        last: _Step | None = None
        for _ in range(_CHAIN):
            step = self.step(position)
            if step is None:
                left = len(self._data) - position
                return last is not None and (left <= CRC_BYTES or self.is_cut_off(position))
            if last is not None and abs(step.time_us - last.time_us) > _NEAR_US:
                return False
            last, position = step, step.end
        return True


def _arrays(found: dict[int, list[int]]) -> Offsets:
    return {number: np.array(places, np.int64) for number, places in found.items()}


MAGIC = 0xBC
TICK_S = 1e-6
"""Device time of both versions is kept in microseconds."""
FIXED_FREQUENCY_ID = 0xFFFF
MAX_TIME_US = 1 << 47
"""Four years after the craft was switched on."""
_TIMESTAMPS = {1: ("<u4", 1000), 2: ("<u8", 1)}
"""Version -> type of a record's timestamp, microseconds per count."""
_LETTERS = {
    **{"b": "<i1", "B": "<u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "l": "<i4"},
    **{"L": "<u4", "q": "<i8", "Q": "<u8", "e": "<f2", "f": "<f4", "d": "<f8", "?": "?"},
}
_VARIABLE = re.compile(r"(.+)\((.)\)")


@dataclass(frozen=True, slots=True)
class _Header:
    """events: id -> name, and the fields ``#id``, ``#time`` and the variables of its records."""

    version: int
    events: dict[int, tuple[str, np.dtype[np.void]]]
    first_record: int


def read_microsd(path: Path, source: str | Path | None = None) -> Recording:
    """Read a microSD log: every event in ``tables``, the fixed-frequency one as samples.

    source: a column map, whose columns are the variables of that event and ``time``, us; None: the
    firmware's names are known.

    Table columns keep the file's names and types; the gyro's unit and its reason are in
    ``metadata["microsd"]``. Host stamps are made from device time. A checksum that does not match,
    a torn end or bytes that are no record are lines of ``damage``; everything that still reads is
    there.

    Raises RecordingError where the file cannot be opened, BadInputError where it is not a
    microSD log or its header does not read, or as ``read_mapped`` for the map.
    """
    with reading(path):
        data = path.read_bytes()
    header = _read_header(data, path)
    unit_us = _TIMESTAMPS[header.version][1]
    sound = zlib.crc32(memoryview(data)[:-CRC_BYTES]) == int.from_bytes(data[-CRC_BYTES:], "little")
    dtypes = {number: dtype for number, (_, dtype) in header.events.items()}
    offsets, damage = (scan if sound else scan_damaged)(data, header.first_record, dtypes, unit_us)
    tables: dict[str, Table] = {}
    columns, time_us = {}, np.empty(0, np.int64)
    for number, (name, dtype) in header.events.items():
        records = _gather(data, offsets[number], dtype)
        ticks = records["#time"].astype(np.int64) * unit_us
        values = {variable: records[variable] for variable in (dtype.names or ())[2:]}
        tables[name] = Table(ticks.astype(np.float64) * TICK_S, values)
        if number == FIXED_FREQUENCY_ID:
            columns, time_us = values, ticks
    if FIXED_FREQUENCY_ID not in header.events:
        damage.append("no fixed-frequency event: there are tables but no samples")
    usable = (time_us >= 0) & (time_us < MAX_TIME_US)
    if not sound:
        usable[usable] = longest_in_order(time_us[usable])
    if not usable.all():
        damage.append(f"{(~usable).sum()} samples with an impossible time were left out")
        columns = {name: values[usable] for name, values in columns.items()}
        time_us = time_us[usable]
    if source is not None:
        given = {"time": time_us, **columns}
        table = ColumnTable(
            path, list(given), lambda name: given[name].astype(np.float64), damage=damage
        )
        recording = read_mapped(table, source)
        return replace(recording, kind="microsd", tables={**tables, **recording.tables})
    samples, notes = samples_from_columns(columns, time_us, TICK_S, None)
    samples, order = in_order(samples)
    samples.host_time_ns[:] = host_time_from_ticks(samples.ticks, TICK_S, samples.segment)
    found = Findings(damage)
    _settle(samples, {name: order.of(values) for name, values in columns.items()}, found)
    return Recording(
        path=path,
        kind="microsd",
        samples=samples,
        tables=tables,
        metadata={
            **found.metadata(order.notes),
            "host_time": dict(SYNTHESISED),
            "vehicle": {"family": TODAY, "because": "no 1.0 carries a microSD deck"},
            "microsd": {"version": str(header.version), **notes},
        },
        damage=damage,
    )


def _settle(samples: SampleBatch, columns: Mapping[str, NDArray[Any]], found: Findings) -> None:
    """Make the motors' column the duty where it is a thrust command."""
    motors = motor_columns_of(columns)
    if motors.crowd:
        found.unclear["duty"] = motors.crowd
        return
    if motors.note:
        found.notes.append(motors.note)
    if motors.are_commands:
        settle_duty(samples, found)
        return
    for m, name in enumerate(COMMANDS):
        command = columns.get(name)
        if command is None:
            continue
        full = 255.0 if command.dtype.itemsize == 1 else FULL_16_BIT
        if differs(command.astype(np.float64) / full, samples.duty[:, m].astype(np.float64)):
            found.notes.append(DIFFERS)
            return


def _read_header(data: bytes, path: Path) -> _Header:
    if not data:
        raise BadInputError(f"{path}: the file is empty")
    if data[0] != MAGIC:
        raise BadInputError(f"{path}: not a microSD log (it starts with 0x{data[0]:02x}, not 0xbc)")
    try:
        version, count = struct.unpack_from("<HH", data, 1)
        if version not in _TIMESTAMPS:
            raise BadInputError(f"{path}: microSD log version {version}; 1 and 2 can be read")
        events: dict[int, tuple[str, np.dtype[np.void]]] = {}
        position = 5
        for _ in range(count):
            (number,) = struct.unpack_from("<H", data, position)
            name, position = _text(data, position + 2)
            (variables,) = struct.unpack_from("<H", data, position)
            position += 2
            fields = [("#id", "<u2"), ("#time", _TIMESTAMPS[version][0])]
            for _ in range(variables):
                variable, position = _text(data, position)
                match = _VARIABLE.fullmatch(variable)
                if match is None or match[2] not in _LETTERS:
                    raise ValueError(f"the variable {variable} has no known type")
                fields.append((match[1], _LETTERS[match[2]]))
            if number in events or any(known == name for known, _ in events.values()):
                raise ValueError(f"the event {name!r} is there twice")
            events[number] = name, np.dtype(fields)
    except BadInputError:
        raise
    except (struct.error, ValueError) as error:
        why = "it ends too early" if isinstance(error, struct.error) else error
        raise BadInputError(f"{path}: the header of the microSD log is damaged: {why}") from error
    return _Header(version, events, position)


def _text(data: bytes, position: int) -> tuple[str, int]:
    end = data.find(b"\0", position)
    if end < 0:
        raise ValueError(f"a name at byte {position} has no end")
    try:
        return data[position:end].decode("utf-8"), end + 1
    except UnicodeDecodeError as error:
        raise ValueError(f"the name at byte {position} is no text") from error


def _gather(data: bytes, offsets: NDArray[np.int64], dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """The records at ``offsets`` as a structured array."""
    if len(offsets) == 0:
        return np.empty(0, dtype)
    codes = np.frombuffer(data, np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(codes, dtype.itemsize)
    return windows[offsets].view(dtype)[:, 0]
