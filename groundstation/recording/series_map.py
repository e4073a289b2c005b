"""Logs of many series, each with a clock and columns of its own, through a column map.

The map names the series that gives the rows; of any other, a row has what was last known at its
time. A column is ``SERIES.FIELD``. A series goes by its own name, by the last part of a name with
slashes, and by its type, as far as only one series has that name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.recording.column_map import mapped_recording
from groundstation.recording.map_document import map_for
from groundstation.recording.map_plan import Plan, map_of_series, plan_of
from groundstation.recording.series import Series
from groundstation.recording.session import Recording

_Columns = Mapping[str, tuple[Series, NDArray[np.generic]]]
TOPIC = "topic"
"""By which the rows of one craft are chosen, ``--only topic=/cf1``."""
SHOWN = 12
"""Series that an error names."""


def read_mapped_series(
    path: Path,
    kind: Literal["ulog", "rosbag"],
    series: Sequence[Series],
    source: str | Path | None,
    damage: Sequence[str] = (),
    unread: Sequence[str] = (),
    notes: Sequence[str] = (),
    unclear: Mapping[str, str] | None = None,
) -> Recording:
    """Read a log by a map (None: the named one that knows it).

    unread: types of series that could not be read, told where a map finds too little. notes,
    unclear: what its reader has settled, and left open by field.

    Raises BadInputError where no map fits, and as ``read_mapped_csv``.
    """
    by_name = _called(series)
    columns = _columns(by_name)
    listed = _cut([f"{one.name} ({one.type})" if one.type else one.name for one in series])
    if unread:
        listed += f"; types that do not parse: {_cut(unread)}"
    if source is None:
        source = map_of_series(kind, columns)
        if source is None:
            _refuse_several(path, series, lambda some: map_of_series(kind, _columns(some)))
            raise BadInputError(
                f"{path}: no known map fits its series ({listed}); say which channel each is with"
                " 'groundstation convert FILE --map', and read the file with --columns"
            )
    column_map, map_path = map_for(path, kind, source)
    rows = by_name.get(column_map.rows)
    if rows is None:
        _refuse_several(path, series, lambda some: column_map.rows in some)
    if rows is None or (rows.type in unread and not len(rows.time_ns)):
        raise BadInputError(
            f"{path}: no series {column_map.rows!r} (rows in {map_path}); it has {listed}"
        )
    plan = plan_of(column_map, map_path, columns)
    for channel in (*plan.channels, *plan.kept):
        if channel.column not in columns:
            raise BadInputError(
                f"{path}: no column {channel.column!r} ({channel.key} in {map_path}); a column is"
                f" SERIES.FIELD, the series are {listed}"
            )
    values = _on_rows(plan, rows, columns)
    names = [name.rpartition(".")[2] for name in columns]
    return mapped_recording(path, plan, column_map, values, names, unclear or {}, damage, notes)


def under(series: Sequence[Series], topic: str) -> list[Series]:
    """The series of one craft or sensor: of each type of which there are some under a topic, those
    alone, and all of any other type."""
    types = {one.type for one in series if _is_under(one.name, topic)}
    return [one for one in series if _is_under(one.name, topic) or one.type not in types]


def _is_under(name: str, topic: str) -> bool:
    return f"{name}/".startswith(f"{topic.rstrip('/')}/")


def _refuse_several(
    path: Path, series: Sequence[Series], fits: Callable[[dict[str, Series]], object]
) -> None:
    """Raises BadInputError where a map fits the series under some topics, which it names: those of
    several crafts or sensors, of which no name is one's alone."""
    parts = [one.name.split("/") for one in series]
    topics = {"/".join(one[:size]) for one in parts for size in range(1, len(one) + 1)} - {""}
    found: list[str] = []
    for topic in sorted(topics, key=lambda one: (one.count("/"), one)):
        if not any(_is_under(topic, one) for one in found) and fits(_called(under(series, topic))):
            found.append(topic)
    if found:
        raise BadInputError(
            f"{path}: topics of several crafts or sensors: {_cut(found)}; make a file of one:"
            f" groundstation convert BAG ONE.mcap --only {TOPIC}={found[0]}"
        )


@np.errstate(invalid="ignore")  # what is no number stays none
def _on_rows(plan: Plan, rows: Series, columns: _Columns) -> NDArray[np.float64]:
    """The planned columns at the times of ``rows``, shape (n, k): the last value known by then, NaN
    before the first."""
    wanted = plan.wanted
    values = np.full((len(rows.time_ns), len(wanted)), np.nan)
    places: dict[str, NDArray[np.intp]] = {}
    for index, channel in enumerate(wanted):
        series, given = columns[str(channel.column)]
        if series is rows:
            values[:, index] = given
            continue
        if series.name not in places:
            found = np.searchsorted(series.time_ns, rows.time_ns, side="right") - 1
            places[series.name] = found
        place = places[series.name]
        known = place >= 0
        values[known, index] = np.asarray(given, np.float64)[place[known]]
    return values


def _columns(by_name: Mapping[str, Series]) -> _Columns:
    """Every column by its name, ``SERIES.FIELD``."""
    return {
        f"{name}.{field}": (one, values)
        for name, one in by_name.items()
        for field, values in one.columns.items()
    }


def _called(series: Sequence[Series]) -> dict[str, Series]:
    """Each series by every name that it alone has."""
    names = [
        (name, one)
        for one in series
        for name in {one.name, one.name.rpartition("/")[2], one.type} - {""}
    ]
    times = Counter(name for name, _ in names)
    return {name: one for name, one in names if times[name] == 1 or name == one.name}


def _cut(parts: Sequence[str]) -> str:
    more = f" and {len(parts) - SHOWN} more" if len(parts) > SHOWN else ""
    return ", ".join(parts[:SHOWN]) + more
