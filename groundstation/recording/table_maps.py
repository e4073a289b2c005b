"""Which map a table is read by: the one that is named, the one that ships and fits, or the one that
knows most of its columns, with the table's own time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.recording.column_names import groups_of, unit_in_name
from groundstation.recording.map_document import (
    NAMED,
    UNITS,
    Clock,
    ColumnMap,
    load_column_map,
    map_for,
)
from groundstation.recording.map_plan import SILENT, Said, map_of_header, plan_of
from groundstation.recording.rows import EVERY_ROW, Rows
from groundstation.recording.table_header import base_name, called
from groundstation.recording.time_cells import FRACTION
from groundstation.recording.unit_guess import goes_on

KNOWN_FROM = 3
"""Columns that a map must know of a table: an axis of each kind, or all axes of one."""
ALL_COLUMNS = "columns"
"""Table that keeps every column of a file of which no channel is known."""
SHOWN = 12
"""Columns that an error names."""

Numbers = Callable[[str], NDArray[np.float64] | None]
"""The first numbers of a column, None where it holds none."""


def map_of_table(
    path: Path,
    names: Sequence[str],
    numbers: Numbers,
    source: str | Path | None,
    rows: Rows = EVERY_ROW,
    said: Said = SILENT,
) -> tuple[ColumnMap, Path]:
    """The map of a table, and where it is.

    names: of its columns, as it spells them. source: a map that the user named. said: the units
    that the table says.

    Raises BadInputError where the table has no time and nobody said how far apart its rows are, and
    as ``map_for``.
    """
    step = Clock(step=1.0 / rows.rate_hz) if rows.rate_hz else None
    exact = source if source is not None else map_of_header(names)
    if exact is not None:
        found, where = map_for(path, "csv", exact)
        return (msgspec.structs.replace(found, time=step) if step else found), where
    clock = step or _time_of(names, numbers, said)
    if clock is None:
        listed = ", ".join(names[:SHOWN]) or "they have no names"
        raise BadInputError(
            f"{path}: no column is a time ({listed}); say how many rows a second there are (--rate"
            " HZ), or which column it is with 'groundstation convert FILE --map'"
        )
    return nearest_map(names, clock) or (_all_columns(names, numbers, clock), path)


def nearest_map(names: Sequence[str], clock: Clock) -> tuple[ColumnMap, Path] | None:
    """The named map that knows most of a table's columns, with this clock; whose craft it is, the
    map does not say of another's table."""
    given = called(names)
    best, found = KNOWN_FROM - 1, None
    for where in NAMED.values():
        column_map = load_column_map(where)
        if column_map.kind != "csv":
            continue
        mapped = msgspec.structs.replace(
            column_map, time=clock, partial=True, vehicle=None, family=None
        )
        try:
            plan = plan_of(mapped, where, given)
        except BadInputError:
            continue  # it knows none
        known = sum(one.key != "time" for one in plan.channels)
        if known > best:
            best, found = known, (mapped, where)
    return found


def _time_of(names: Sequence[str], numbers: Numbers, said: Said) -> Clock | None:
    """The column that is named as times are and goes on, or else one that has a time's unit and
    does."""
    named = [one for one in groups_of(names) if one.quantity == "time"]
    measured = [one for one in names if said.unit_of(base_name(one)[0]) in UNITS["time"]]
    for name in (*(names[one.places[""]] for one in named), *measured):
        values = numbers(name) if said.unit_of(name) != FRACTION else None
        if values is not None and (len(values) < 2 or goes_on(values)):
            return Clock(column=base_name(name)[0], unit=unit_in_name(name, "time"))
    return None


def _all_columns(names: Sequence[str], numbers: Numbers, clock: Clock) -> ColumnMap:
    kept = [name for name in names if name and name != clock.column and numbers(name) is not None]
    return ColumnMap(
        time=clock, tables={ALL_COLUMNS: kept}, family="unknown", title="a table with a time column"
    )
