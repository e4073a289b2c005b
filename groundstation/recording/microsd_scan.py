"""Where the records of a microSD log lie, in a sound file and in a damaged one."""

from __future__ import annotations

import bisect
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
