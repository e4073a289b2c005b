"""Any other CSV through a column map: what ``map_document`` describes, applied to numbers."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import attitude_of_quaternion
from groundstation.errors import BadInputError
from groundstation.recording.craft_family import family_of
from groundstation.recording.delimited import TextTable, open_table
from groundstation.recording.device_time import SYNTHESISED, host_time_from_ticks
from groundstation.recording.map_document import (
    NAMED,
    ColumnMap,
    map_for,
)
from groundstation.recording.map_plan import (
    Channel,
    Plan,
    Said,
    decided,
    plan_of,
)
from groundstation.recording.row_order import ROWS_METADATA, in_order
from groundstation.recording.session import Recording, Table
from groundstation.recording.table_header import base_name, called
from groundstation.telemetry.samples import SampleBatch, empty_samples

UNCLEAR_METADATA = "unclear"
"""Metadata record of what a file leaves open, field -> words."""
_LIMITS = {"ticks": (-4e18, 4e18), "debug": (0.0, 2.0**32 - 1)}


def read_mapped_csv(path: Path, source: str | Path) -> Recording:
    """Read any CSV by the columns that a map names: one of ``NAMED``, or a TOML file.

    A time that goes backwards starts a new segment; an empty cell is NaN; a channel that is
    not mapped is NaN. There are no raw packets.

    Raises RecordingError where a file cannot be opened, BadInputError where the map is wrong
    (file and key), a column is missing, or a cell does not read (file, line, column).
    """
    column_map, map_path = map_for(path, "csv", source)
    table = open_table(path, column_map.skip)
    plan = plan_of(column_map, map_path, called(table.names), said_by(table, str(source) in NAMED))
    places = [
        place_of(path, table.names, table.width, one, map_path)
        for one in (*plan.channels, *plan.kept)
    ]
    batches: list[SampleBatch] = []
    rest = [np.empty((0, len(plan.kept)))]
    unclear: dict[str, str] = {}
    for block in table.blocks(places):
        if not batches:
            plan, unclear = decided(plan, block.values)
        batches.append(_samples(plan, block.values, block.error))
        rest.append(block.values[:, len(plan.channels) :])
    samples = SampleBatch.concatenate(batches) if batches else empty_samples(0, plan.tick_s)
    kept = np.concatenate(rest)
    return _recording(path, plan, column_map, samples, kept, table.names, table.damage, unclear)


def said_by(table: TextTable, named: bool) -> Said:
    """What a table's header says. named: by a map that ships, which knows a format and not a file:
    the file's own unit holds for a column's whole name as well."""
    units: dict[str, str] = {}
    for name, unit in zip(table.names, table.units, strict=True):
        if unit:
            base = base_name(name)[0]
            units |= {base: unit} if base != name else {}
            units |= {name: unit} if named else {}
    return Said(units, table.said)


def mapped_recording(
    path: Path,
    plan: Plan,
    column_map: ColumnMap,
    values: NDArray[np.float64],
    names: Collection[str],
    unclear: Mapping[str, str],
    damage: Sequence[str] = (),
) -> Recording:
    """What a map makes of a file's columns (n, channels and kept of ``plan``). names: every column
    of the file. unclear: field -> what the file leaves open.

    Raises BadInputError for a value that cannot be (column, row).
    """

    def refuse(row: int, place: int, why: str) -> BadInputError:
        return BadInputError(f"{path}: {plan.channels[place].column}, row {row + 1}: {why}")

    samples = _samples(plan, values, refuse)
    kept = values[:, len(plan.channels) :]
    return _recording(path, plan, column_map, samples, kept, names, damage, unclear)


def _recording(
    path: Path,
    plan: Plan,
    column_map: ColumnMap,
    samples: SampleBatch,
    kept: NDArray[np.float64],
    names: Collection[str],
    damage: Sequence[str],
    unclear: Mapping[str, str],
) -> Recording:
    """Samples with their clock, tables from the columns that are kept, and metadata."""
    samples, order = in_order(samples, [kept])
    kept = order.of(kept)
    samples.host_time_ns[:] = host_time_from_ticks(samples.ticks, plan.tick_s, samples.segment)
    metadata = {"host_time": dict(SYNTHESISED), "column_map": plan.text}
    if unclear:
        metadata[UNCLEAR_METADATA] = dict(unclear)
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
        tables=_tables(plan.kept, kept, samples.time_s),
        metadata=metadata,
        damage=list(damage),
    )


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
) -> SampleBatch:
    """Samples from the columns (n, len(plan.channels) or more) that a plan names.

    error: what to raise for the cell at a row and column, and why.
    """
    samples = empty_samples(len(values), plan.tick_s)
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
    if "quaternion" in mapped:
        size = np.linalg.norm(quaternion, axis=1)
        known = np.isfinite(size) & (size > 0)
        unit = quaternion[known] / size[known, None]
        samples.attitude[known] = attitude_of_quaternion(unit)
    if plan.from_north:
        yaw = samples.attitude[:, 2]
        yaw[:] = np.remainder(yaw + 1.5 * np.pi, math.tau) - np.pi
    return samples
