"""Our own CSV files: the thesis's layout (the packet's integers) and a table in physical units. A
CSV of another program is a map in ``maps/`` (``map_document.py``).

The thesis's layout has one line per sample, ``Timestamp,Battery,...,Debug``, exactly the
counts of the packet with the timestamp unwrapped (ticks of 73/72 us) and pitch as the
firmware sends it, nose up positive. The physical table names the unit in each header
(``gyro_x_deg_s``) and has the signs of the design, pitch nose down positive.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.paths import writing
from groundstation.recording.column_map import (
    in_order,
    order_of,
    read_mapped,
    read_mapped_csv,
    require_one_craft,
)
from groundstation.recording.delimited import Block, TextTable, open_table
from groundstation.recording.motor_columns import (
    NOT_KNOWN,
    changes,
    settle_duty,
    siblings,
    too_many,
)
from groundstation.recording.session import (
    CHANNELS,
    EVERY_ROW,
    SYNTHESISED,
    UNCLEAR_METADATA,
    Findings,
    Recording,
    Rows,
    host_time_from_ticks,
)
from groundstation.telemetry.packet import (
    ACCELEROMETER_M_S2,
    ANGLE_RAD,
    BATTERY_V,
    DUTY,
    GYRO_RAD_S,
    TICK_S,
    encode,
)
from groundstation.telemetry.samples import RawBatch, SampleBatch, empty_samples, packet_counts

THESIS_COLUMNS = (
    *("Timestamp", "Battery", "Motor1", "Motor2", "Motor3", "Motor4", "GyroX", "GyroY", "GyroZ"),
    *("AccX", "AccY", "AccZ", "Roll", "Pitch", "Yaw", "Debug"),
)
"""Header of the thesis's layout (thesis figure 5.7)."""


_TABLE_TICK_S = 1e-9
_MAX_TICKS = 2**47
"""Four years after the craft was switched on."""
_MAX_TIME_S = 4e9
"""Device or Unix time of a physical table, beyond the year 2090."""
_TABLE_LIMITS = {
    "time_s": (-_MAX_TIME_S, _MAX_TIME_S),
    "segment": (0, 2**31 - 1),
    "host_time_s": (-_MAX_TIME_S, _MAX_TIME_S),
    "debug": (0, 2**32 - 1),
}
_COMMAND, _DOUBTFUL = "command_", "doubtful_duty_"
"""How the duties' columns begin where it is not known whether they are the duty, or its range is
not known: a warning that goes along with the table."""
_DOUBT = (
    "the motors' duty is not known: the table has it as doubtful_duty_1 to 4; the recording that it"
    " was made of says why"
)
_WRITE_ROWS = 20_000


def read_csv(path: Path, source: str | Path | None = None, rows: Rows = EVERY_ROW) -> Recording:
    """Read a CSV file by a column map (None: in the thesis's layout, in physical units or with the
    columns that a named map knows, told apart by the header).

    A time that goes backwards starts a new segment. Host stamps are made from device time
    where the file has none. Rows that fit the packet are also given as raw packets, one copy
    each, so that the recording can be replayed.

    Raises RecordingError where the file cannot be opened, BadInputError (file, line, column)
    where it does not read. A torn last line is left out and named in ``damage``.
    """
    if source is not None:
        return read_mapped_csv(path, source, rows)
    table = open_table(path).chosen(rows)
    positions = {name.lower(): place for place, name in enumerate(table.names) if name}
    if "time_s" in positions and not rows.rate_hz:
        doubt = _doubt(positions)
        positions |= {f"duty_{m}": positions[f"{doubt}{m}"] for m in range(1, 5) if doubt}
        known = [positions[one.header] for one in CHANNELS if one.header in positions]
        time = positions["time_s"]
        if rows.only is None:
            require_one_craft(table, [time, *known], time)
        return _read_physical(table, positions, doubt)
    missing = [name for name in THESIS_COLUMNS if name.lower() not in positions]
    if not missing and not rows.rate_hz:
        return _read_thesis(table, [positions[name.lower()] for name in THESIS_COLUMNS])
    if len(missing) <= len(THESIS_COLUMNS) // 4 and not rows.rate_hz:
        raise BadInputError(f"{path}: the thesis's layout, but no column {', '.join(missing)}")
    return read_mapped(table, None, rows)


def write_csv(recording: Recording, path: Path) -> None:
    """Write the samples in the thesis's layout, integers exactly as the packets had them.

    Samples of another source (a microSD log) are rounded to the packet's counts and ticks; a
    channel without data is 0. Host stamps and copies are not part of this layout.

    Raises BadInputError where ``path`` exists, RecordingError where it cannot be written.
    """
    samples = recording.samples
    with _new_file(path) as file:
        file.write(",".join(THESIS_COLUMNS) + "\n")
        for first in range(0, len(samples), _WRITE_ROWS):
            counts = packet_counts(samples[first : first + _WRITE_ROWS])
            if samples.tick_s != TICK_S:
                seconds = counts["timestamp"] * samples.tick_s
                counts["timestamp"] = np.rint(seconds / TICK_S).astype(np.int64)
            rows = np.column_stack(list(counts.values()))
            _write_rows(file, rows, ["%d"] * len(THESIS_COLUMNS))


def write_table_csv(recording: Recording, path: Path) -> None:
    """Write the samples in physical units, each header with its unit.

    Columns: ``time_s`` (device time), ``segment``, ``host_time_s`` (Unix), the channels of
    ``session.CHANNELS`` and ``debug``. A channel the recording does not have is left out; a
    missing value is ``nan``. Reading the file gives the same samples, time to the nanosecond.
    Duties that may be commands of thrust are ``command_1`` to ``command_4``, those in doubt for
    another reason ``doubtful_duty_1`` to ``doubtful_duty_4``, and stay in doubt.

    Raises BadInputError where ``path`` exists, RecordingError where it cannot be written.
    """
    samples = recording.samples
    present = [channel for channel in CHANNELS if channel.is_in(samples)]
    open_ = recording.metadata.get(UNCLEAR_METADATA, {}).get("duty", "")
    called = "duty_" if not open_ else _COMMAND if open_ == NOT_KNOWN else _DOUBTFUL
    names = [channel.header for channel in present]
    names = [re.sub(r"^duty_(?=\d$)", called, one) for one in names]
    header = ["time_s", "segment", "host_time_s", *names, "debug"]
    formats = ["%.9f", "%d", "%.6f", *["%.9g"] * len(present), "%d"]
    with _new_file(path) as file:
        file.write(",".join(header) + "\n")
        for first in range(0, len(samples), _WRITE_ROWS):
            block = samples[first : first + _WRITE_ROWS]
            columns: list[NDArray[Any]] = [block.time_s, block.segment, block.host_time_ns / 1e9]
            columns += [channel.shown(block) for channel in present]
            _write_rows(file, np.column_stack([*columns, block.debug]), formats)


def _read_thesis(table: TextTable, places: list[int]) -> Recording:
    stamps: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    channels: list[NDArray[np.int32]] = [np.empty((0, 14), np.int32)]
    debugs: list[NDArray[np.uint32]] = [np.empty(0, np.uint32)]
    for block in table.blocks(places, whole=True):
        _require_range(block, slice(0, 1), -_MAX_TICKS, _MAX_TICKS)
        _require_range(block, slice(1, 15), -(2**31), 2**31 - 1)
        _require_range(block, slice(15, 16), 0, 2**32 - 1)
        stamps.append(block.values[:, 0].astype(np.int64))
        channels.append(block.values[:, 1:15].astype(np.int32))
        debugs.append(block.values[:, 15].astype(np.uint32))
    ticks, counts, debug = np.concatenate(stamps), np.concatenate(channels), np.concatenate(debugs)
    order = order_of(ticks, TICK_S, [counts, debug])
    ticks, counts, debug = order.ticks, order.of(counts), order.of(debug)
    host_time_ns = host_time_from_ticks(ticks, TICK_S, order.segment)
    samples = _from_counts(ticks, counts, debug, order.segment, host_time_ns)
    samples.copies[:] = order.copies
    return Recording(
        path=table.path,
        kind="csv",
        samples=samples,
        raw=_as_packets(ticks, counts, debug, host_time_ns),
        metadata={"host_time": dict(SYNTHESISED), **Findings().metadata(order.notes)},
        damage=table.damage,
    )


def _require_range(block: Block, columns: slice, low: float, high: float) -> None:
    values = block.values[:, columns]
    outside = np.argwhere(~((values >= low) & (values <= high)))
    if len(outside):
        row, column = (int(place) for place in outside[0])
        why = f"{values[row, column]:.15g} is outside {low:.15g}..{high:.15g}"
        raise block.error(row, columns.start + column, why)


def _from_counts(
    ticks: NDArray[np.int64],
    counts: NDArray[np.int32],
    debug: NDArray[np.uint32],
    segment: NDArray[np.int32],
    host_time_ns: NDArray[np.int64],
) -> SampleBatch:
    """Samples from (n, 14) counts: battery, motors, gyro, accelerometer, angles."""
    samples = empty_samples(len(ticks))
    samples.ticks[:], samples.host_time_ns[:], samples.segment[:] = ticks, host_time_ns, segment
    samples.debug[:] = debug
    numbers = counts.astype(np.float32)
    samples.battery_v[:] = numbers[:, 0] * np.float32(BATTERY_V)
    samples.duty[:] = numbers[:, 1:5] * np.float32(DUTY)
    samples.gyro[:] = numbers[:, 5:8] * np.float32(GYRO_RAD_S)
    samples.accelerometer[:] = numbers[:, 8:11] * np.float32(ACCELEROMETER_M_S2)
    samples.attitude[:] = numbers[:, 11:14] * np.float32(ANGLE_RAD)
    samples.attitude[:, 1] *= -1  # the firmware's pitch is nose up positive
    return samples


def _as_packets(
    ticks: NDArray[np.int64],
    counts: NDArray[np.int32],
    debug: NDArray[np.uint32],
    host_time_ns: NDArray[np.int64],
) -> RawBatch | None:
    """The rows as packets, or None where a value does not fit its field (simulated data)."""
    try:
        packets = encode(
            timestamp=ticks,
            battery=counts[:, 0],
            motors=counts[:, 1:5],
            gyro=counts[:, 5:8],
            accelerometer=counts[:, 8:11],
            angles=counts[:, 11:14],
            debug=debug,
        )
    except ValueError:
        return None
    return RawBatch(packets, host_time_ns)


def _doubt(positions: Mapping[str, int]) -> str:
    """How the duties' columns begin where they are in doubt, or empty."""
    found = [
        one for one in (_COMMAND, _DOUBTFUL) if all(f"{one}{m}" in positions for m in range(1, 5))
    ]
    return found[0] if found and "duty_1" not in positions else ""


def _read_physical(table: TextTable, positions: dict[str, int], doubt: str) -> Recording:
    channels = [channel for channel in CHANNELS if channel.header in positions]
    extras = [name for name in _TABLE_LIMITS if name in positions]
    names = [*extras, *(channel.header for channel in channels)]
    beside = siblings([f"duty_{m}" for m in range(1, 5)], positions)
    moved = np.zeros(len(names) + len(beside), np.intp)
    blocks = []
    for block in table.blocks([positions[name] for name in (*names, *beside)]):
        moved += changes(block.values)
        for place, name in enumerate(names[: len(extras)]):
            _require_range(block, slice(place, place + 1), *_TABLE_LIMITS[name])
        values = dict(zip((*names, *beside), block.values.T, strict=True))
        ticks = np.rint(values["time_s"] / _TABLE_TICK_S).astype(np.int64)
        samples = empty_samples(len(ticks), _TABLE_TICK_S)
        samples.ticks[:] = ticks
        for channel in channels:
            channel.of(samples)[:] = values[channel.header] / channel.scale
        samples.segment[:] = values.get("segment", 0)
        samples.debug[:] = values.get("debug", 0)
        if "host_time_s" in values:
            samples.host_time_ns[:] = np.rint(values["host_time_s"] * 1e9)
        blocks.append(samples)
    samples = SampleBatch.concatenate(blocks) if blocks else empty_samples(0, _TABLE_TICK_S)
    found, notes = Findings(table.damage), {}
    motors = [k for k, one in enumerate(channels, len(extras)) if one.field == "duty"]
    if why := too_many(moved[motors], moved[len(names) :], beside):
        samples.duty[:] = np.nan
        found.unclear["duty"] = why
    if doubt == _COMMAND:
        settle_duty(samples, found)
    elif doubt:
        found.unclear["duty"] = _DOUBT
    if "segment" not in positions:
        samples, order = in_order(samples)
        notes = order.notes
    metadata = found.metadata(notes)
    if "host_time_s" not in positions:
        samples.host_time_ns[:] = host_time_from_ticks(
            samples.ticks, samples.tick_s, samples.segment
        )
        metadata["host_time"] = dict(SYNTHESISED)
    return Recording(table.path, "csv", samples, metadata=metadata, damage=table.damage)


def _write_rows(file: TextIO, rows: NDArray[Any], formats: list[str]) -> None:
    line = ",".join(formats) + "\n"
    file.write(line * len(rows) % tuple(rows.ravel().tolist()))


@contextlib.contextmanager
def _new_file(path: Path) -> Iterator[TextIO]:
    """A file that did not exist before, and does not exist after a failure."""
    with writing(path):
        file = path.open("x", encoding="ascii", newline="")
        try:
            with file:
                yield file
        except BaseException:
            path.unlink(missing_ok=True)
            raise
