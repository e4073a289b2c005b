"""Any other CSV through a column map: what ``map_document`` describes, applied to numbers."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import attitude_of_quaternion
from groundstation.errors import BadInputError
from groundstation.recording.craft_family import family_of
from groundstation.recording.delimited import TextTable, open_table
from groundstation.recording.device_time import SYNTHESISED, host_time_from_ticks
from groundstation.recording.map_document import NAMED, ColumnMap, map_for
from groundstation.recording.map_plan import (
    SILENT,
    Channel,
    Plan,
    Said,
    decided,
    plan_of,
)
from groundstation.recording.motor_columns import changes, too_many
from groundstation.recording.row_order import ROWS_METADATA, in_order
from groundstation.recording.rows import EVERY_ROW, Rows
from groundstation.recording.session import Recording, Table
from groundstation.recording.table_header import base_name, called
from groundstation.recording.table_maps import SHOWN, map_of_table
from groundstation.recording.takes_turns import refusal, whose_column
from groundstation.recording.thrust_command import DIFFERS, differs, is_command, settle_duty
from groundstation.recording.time_cells import FRACTION
from groundstation.telemetry.packet import FULL_16_BIT
from groundstation.telemetry.samples import SampleBatch, empty_samples

UNCLEAR_METADATA = "unclear"
"""Metadata record of what a file leaves open, field -> words."""
NO_CHANNEL = "channels"
"""Its field that says which columns there are instead, where none is of a channel."""
NOTES_METADATA = "notes"
"""Metadata record of what was found while reading and settled."""
COMMAND_TABLE = "command"
"""Table that keeps the firmware's ``motor.m1..m4`` where the duty comes from elsewhere."""
_LIMITS = {"ticks": (-4e18, 4e18), "debug": (0.0, 2.0**32 - 1)}


def read_mapped_csv(
    path: Path, source: str | Path | None = None, rows: Rows = EVERY_ROW
) -> Recording:
    """Read any CSV by the columns that a map names: one of ``NAMED``, a TOML file, or the one that
    ships and knows the header (None).

    A time that goes backwards starts a new segment; an empty cell is NaN; a channel that is
    not mapped is NaN. There are no raw packets.

    Raises RecordingError where a file cannot be opened, BadInputError where the map is wrong
    (file and key), a column is missing, or a cell does not read (file, line, column).
    """
    skip = 0 if source is None else map_for(path, "csv", source)[0].skip
    table = chosen(open_table(path, skip), rows)
    said = said_by(table, named=False)
    column_map, map_path = map_of_table(path, table.names, table.first_numbers, source, rows, said)
    named = map_path in (path, *NAMED.values())
    plan = plan_of(column_map, map_path, called(table.names), said_by(table, named))
    places = [place_of(path, table.names, table.width, one, map_path) for one in plan.wanted]
    if rows.only is None:
        require_one_craft(path, table.names, table.first_cells, places, _clock_of(plan, places))
    batches: list[SampleBatch] = []
    rest = [np.empty((0, len(plan.kept)))]
    unclear: dict[str, str] = {}
    count, untimed, moved = 0, 0, np.zeros(len(plan.wanted), np.intp)
    for block in table.blocks(places):
        if not batches:
            plan, unclear = decided(plan, block.values, named)
        timed = _timed(plan, block.values)
        values = block.values[timed]
        untimed += len(block.values) - len(values)
        batches.append(_samples(plan, values, _at(block.error, timed), count))
        count += len(values)
        moved += changes(values)
        rest.append(_kept(plan, values))
    _say_untimed(path, unclear, untimed, count)
    plan, crowd = _of_four(plan, moved, batches)
    unclear |= crowd
    samples = SampleBatch.concatenate(batches) if batches else empty_samples(0, plan.tick_s)
    kept = np.concatenate(rest)
    return _recording(path, plan, column_map, samples, kept, table.names, table.damage, unclear)


def chosen(table: TextTable, rows: Rows) -> TextTable:
    """A table of the rows that are asked for.

    Raises BadInputError where it has no such column or no such row."""
    if rows.only is None:
        return table
    name, value = rows.only
    if name not in table.names:
        raise BadInputError(f"{table.path}: --only {name}={value}: there is no column {name!r}")
    table.only = table.names.index(name), value
    values = list(dict.fromkeys(table.first_cells(table.only[0])))
    if value not in values:
        listed = ", ".join(values[:SHOWN])
        raise BadInputError(f"{table.path}: --only {name}={value}: the column has {listed}")
    return table


def require_one_craft(
    path: Path,
    names: Sequence[str],
    texts: Callable[[int], Sequence[str]],
    taken: Sequence[int],
    time: int | None,
) -> None:
    """Raises BadInputError where the rows of a table are several crafts' or sensors'; arguments as
    ``whose_column``."""
    found = whose_column(names, texts, taken, time)
    if found is not None:
        raise BadInputError(f"{path}: {refusal(*found)}")


def _clock_of(plan: Plan, places: Sequence[int]) -> int | None:
    """Place of the clock among a plan's columns, None where it has none."""
    return None if plan.step_s else places[0]


def said_by(table: TextTable, named: bool) -> Said:
    """What a table's header says. named: by a map that ships, which knows a format and not a file:
    the file's own unit holds for a column's whole name too, and so does that of a date."""
    units: dict[str, str] = {}
    names = table.names or [str(place + 1) for place in range(table.width)]
    for place, (name, unit) in enumerate(zip(names, table.units, strict=True)):
        if unit:
            units |= {base_name(name)[0]: unit} if base_name(name)[0] != name else {}
            is_time = unit == FRACTION or place in table.dated | table.fractions
            units |= {name: unit} if named or is_time else {}
    return Said(units, table.said)


def mapped_recording(
    path: Path,
    plan: Plan,
    column_map: ColumnMap,
    values: NDArray[np.float64],
    names: Collection[str],
    unclear: Mapping[str, str],
    damage: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> Recording:
    """What a map makes of a file's columns (n, channels, kept and beside of ``plan``). names: every
    column of the file. unclear: field -> what the file leaves open. notes: what was settled.

    Raises BadInputError for a value that cannot be (column, row).
    """

    def refuse(row: int, place: int, why: str) -> BadInputError:
        return BadInputError(f"{path}: {plan.channels[place].column}, row {row + 1}: {why}")

    samples = _samples(plan, values, refuse)
    plan, crowd = _of_four(plan, changes(values), [samples])
    kept, unclear = _kept(plan, values), {**unclear, **crowd}
    return _recording(path, plan, column_map, samples, kept, names, damage, unclear, notes)


@np.errstate(invalid="ignore")  # damage may leave a NaN that numpy signals when it is converted
def mapped_columns(
    path: Path,
    names: Sequence[str],
    numbers: Callable[[str], NDArray[np.float64]],
    source: str | Path | None,
    said: Said = SILENT,
    damage: Sequence[str] = (),
    rows: Rows = EVERY_ROW,
    texts: Callable[[int], Sequence[str]] | None = None,
) -> Recording:
    """What a map makes of a table's columns. numbers: those of a column (n,). texts: some cells of
    the column at a place, where its rows may be several crafts'.

    Raises BadInputError as ``read_mapped_csv``.
    """

    def there(name: str) -> NDArray[np.float64] | None:
        try:
            return numbers(name)
        except BadInputError:
            return None

    column_map, map_path = map_of_table(path, names, there, source, rows, said)
    plan = plan_of(column_map, map_path, called(names), said)
    places = [place_of(path, names, len(names), one, map_path) for one in plan.wanted]
    if texts is not None and rows.only is None:
        require_one_craft(path, names, texts, places, _clock_of(plan, places))
    values = np.column_stack([numbers(names[k]) for k in places])
    plan, unclear = decided(plan, values, map_path in (path, *NAMED.values()))
    timed = _timed(plan, values)
    _say_untimed(path, unclear, len(values) - len(timed), len(timed))
    values = values[timed]
    return mapped_recording(path, plan, column_map, values, names, unclear, damage)


def _recording(
    path: Path,
    plan: Plan,
    column_map: ColumnMap,
    samples: SampleBatch,
    kept: NDArray[np.float64],
    names: Collection[str],
    damage: Sequence[str],
    unclear: Mapping[str, str],
    settled: Sequence[str] = (),
) -> Recording:
    """Samples with their clock, tables from the columns that are kept, and metadata."""
    samples, order = in_order(samples, [kept])
    kept = order.of(kept)
    samples.host_time_ns[:] = host_time_from_ticks(samples.ticks, plan.tick_s, samples.segment)
    metadata: dict[str, dict[str, str]] = {
        "host_time": dict(SYNTHESISED),
        "column_map": plan.text,
    }
    tables = _tables(plan.kept, kept, samples.time_s)
    note, open_ = _settled(plan, column_map, samples, tables)
    unclear = {**({"duty": open_} if open_ else {}), **unclear}
    if notes := [*settled, *([note] if note else [])]:
        metadata[NOTES_METADATA] = {str(k): note for k, note in enumerate(notes, 1)}
    if unclear:
        metadata[UNCLEAR_METADATA] = unclear
    if order.notes:
        metadata[ROWS_METADATA] = order.notes
    if column_map.vehicle is not None:
        metadata["vehicle"] = {"profile": column_map.vehicle}
    elif column_map.family is not None:
        metadata["vehicle"] = {"family": column_map.family, "because": column_map.title}
    else:
        metadata["vehicle"] = family_of(names, samples)
    return Recording(
        path=path,
        kind=column_map.kind,
        samples=samples,
        tables=tables,
        metadata=metadata,
        damage=list(damage),
    )


def _timed(plan: Plan, values: NDArray[np.float64]) -> NDArray[np.intp]:
    """Rows that have a time."""
    if plan.step_s:
        return np.arange(len(values))
    return np.flatnonzero(np.isfinite(values[:, 0]))


def _at(
    error: Callable[[int, int, str], BadInputError], rows: NDArray[np.intp]
) -> Callable[[int, int, str], BadInputError]:
    """What to raise for a row of those that were chosen."""
    return lambda row, place, why: error(int(rows[row]), place, why)


def _say_untimed(path: Path, unclear: dict[str, str], untimed: int, timed: int) -> None:
    """Raises BadInputError where no row has a time."""
    if untimed and not timed:
        raise BadInputError(f"{path}: no row has a time")
    if untimed:
        unclear["time"] = f"{untimed} rows without a time were left out"


def _kept(plan: Plan, values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[:, len(plan.channels) : len(plan.channels) + len(plan.kept)]


def _of_four(
    plan: Plan, moved: NDArray[np.intp], batches: Sequence[SampleBatch]
) -> tuple[Plan, dict[str, str]]:
    """The plan, and the samples, without motors where more than four of a file move, and that in
    words. moved: how often each wanted column changes."""
    motors = [k for k, one in enumerate(plan.channels) if one.field == "duty"]
    names = [str(one.column) for one in plan.beside]
    why = too_many(moved[motors], moved[len(moved) - len(names) :], names)
    if not why:
        return plan, {}
    for batch in batches:
        batch.duty[:] = batch.rotor_rev_s[:] = np.nan
    channels = tuple(one for one in plan.channels if one.field not in ("duty", "rotor_rev_s"))
    return replace(plan, channels=channels), {"duty": why}


def _settled(
    plan: Plan, column_map: ColumnMap, samples: SampleBatch, tables: Mapping[str, Table]
) -> tuple[str, str]:
    """Make the motors' column the duty where it is the thrust command of a Crazyflie: a note, and
    what stays open, either empty."""
    duty = [channel for channel in plan.channels if channel.field == "duty"]
    known = column_map.vehicle is not None
    if duty and (column_map.commands or all(is_command(one.column, known) for one in duty)):
        return settle_duty(samples)
    for channel in duty:
        beside = tables.get(COMMAND_TABLE, Table(samples.time_s, {})).columns
        command = beside.get(f"motor.m{(channel.index or 0) + 1}")
        if command is not None and channel.index is not None:
            asked = command.astype(np.float64) / FULL_16_BIT
            if differs(asked, samples.duty[:, channel.index].astype(np.float64)):
                return DIFFERS, ""
    return "", ""


def _tables(
    kept: Sequence[Channel], values: NDArray[np.float64], time_s: NDArray[np.float64]
) -> dict[str, Table]:
    """The columns (n, len(kept)) that are no channel of the samples, by the map's table names."""
    tables: dict[str, Table] = {}
    for channel, column in zip(kept, values.T, strict=True):
        table = tables.setdefault(channel.field, Table(time_s, {}))
        table.columns[str(channel.column)] = column
    return tables


def place_of(path: Path, names: Sequence[str], width: int, channel: Channel, map_path: Path) -> int:
    """Position in a row of the column that a channel names. names: of the file's columns, empty
    without a header. width: how many there are.

    Raises BadInputError where there is no such column, or more than one.
    """
    if isinstance(channel.column, int):
        if channel.column > width:
            raise BadInputError(
                f"{map_path}: {channel.key}.column is {channel.column}, but {path} has "
                f"{width} columns"
            )
        return channel.column - 1
    given = list(names)
    if channel.column not in given:
        given = [base_name(one)[0] for one in given]
    found = given.count(channel.column)
    if found == 1:
        return given.index(channel.column)
    if found > 1:
        raise BadInputError(
            f"{path}: {found} columns are named {channel.column!r} "
            f"({channel.key} in {map_path}); give the column's number instead"
        )
    if not names:
        raise BadInputError(
            f"{path}: no header line, so {channel.key}.column in {map_path} must be a number"
        )
    near = difflib.get_close_matches(channel.column, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise BadInputError(f"{path}: no column {channel.column!r} ({channel.key} in {map_path}){hint}")


@np.errstate(over="ignore", invalid="ignore")  # beyond what a channel holds is no value
def _samples(
    plan: Plan,
    values: NDArray[np.float64],
    error: Callable[[int, int, str], BadInputError],
    first: int = 0,
) -> SampleBatch:
    """Samples from the columns (n, len(plan.channels) or more) that a plan names.

    error: what to raise for the cell at a row and column, and why. first: number of the first row.
    """
    samples = empty_samples(len(values), plan.tick_s)
    if plan.step_s:
        numbers = np.arange(first, first + len(values))
        samples.ticks[:] = np.rint(numbers * (plan.step_s / plan.tick_s))
    quaternion = np.full((len(values), 4), np.nan)
    mapped = {channel.field for channel in plan.channels}
    for place, channel in enumerate(plan.channels):
        cells = values[:, place]
        if channel.field in _LIMITS:
            low, high = _LIMITS[channel.field]
            scaled = np.rint(cells * channel.scale)
            wrong = np.flatnonzero(~((scaled >= low) & (scaled <= high)))
            if len(wrong):
                row = int(wrong[0])
                raise error(row, place, f"{cells[row]:g} cannot be {channel.key}")
            getattr(samples, channel.field)[:] = scaled
            continue
        if channel.zero is not None:
            cells = np.maximum(cells - channel.zero, 0.0)
        if channel.field == "quaternion":
            quaternion[:, channel.index] = cells * channel.scale
        else:
            target = getattr(samples, channel.field)
            target = target if channel.index is None else target[:, channel.index]
            target[:] = cells * channel.scale
    if "quaternion" in mapped and not plan.by_angles:
        size = np.linalg.norm(quaternion, axis=1)
        known = np.isfinite(size) & (size > 0)
        unit = quaternion[known] / size[known, None]
        samples.attitude[known] = attitude_of_quaternion(unit)
    if plan.from_north:
        yaw = samples.attitude[:, 2]
        yaw[:] = np.remainder(yaw + 1.5 * np.pi, math.tau) - np.pi
    return samples
