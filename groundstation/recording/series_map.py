"""Logs of many series, each with a clock and columns of its own, through a column map.

The map names the series that gives the rows; of any other, a row has what was last known at its
time. A column is ``SERIES.FIELD``. A series goes by its own name, by the last part of a name with
slashes, and by its type, as far as only one series has that name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.recording.column_map import mapped_recording
from groundstation.recording.map_document import map_for
from groundstation.recording.map_plan import Plan, map_of_series, plan_of
from groundstation.recording.session import Recording


@dataclass(frozen=True, slots=True)
class Series:
    """One series of a log.

    time_ns: (n,) when each row came, in order, on a clock that all series of the file share.
    columns: name -> (n,) numbers.
    type: of its messages, or empty.
    """

    name: str
    time_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.generic]]
    type: str = ""


_Columns = Mapping[str, tuple[Series, NDArray[np.generic]]]
NONE: Mapping[str, float] = {}
MOTORS = ("duty", "rotor_rev_s")
MAV_TYPES = {
    **{
        1: "a fixed wing",
        3: "a coaxial helicopter",
        4: "a helicopter",
        10: "a rover",
        11: "a boat",
    },
    **{12: "a submarine", 13: "a hexarotor", 14: "an octorotor", 15: "a tricopter"},
    **dict.fromkeys((19, 20, 21, 22, 23, 24, 25), "a VTOL"),
}
"""Crafts by MAVLink's MAV_TYPE that are no quadrotor, which is 2."""
SHOWN = 12
"""Series that an error names."""


def read_mapped_series(
    path: Path,
    kind: Literal["ulog", "rosbag"],
    series: Sequence[Series],
    source: str | Path | None,
    damage: Sequence[str] = (),
    unread: Sequence[str] = (),
    parameters: Mapping[str, float] = NONE,
) -> Recording:
    """Read a log by a map (None: the named one that knows it).

    unread: types of series that could not be read, told where a map finds too little. parameters:
    of the craft, as far as the log has them.

    Raises BadInputError where no map fits, and as ``read_mapped_csv``.
    """
    by_name = _called(series)
    columns = {
        f"{name}.{field}": (one, values)
        for name, one in by_name.items()
        for field, values in one.columns.items()
    }
    listed = _cut([f"{one.name} ({one.type})" if one.type else one.name for one in series])
    if unread:
        listed += f"; types that do not parse: {_cut(unread)}"
    if source is None:
        source = map_of_series(kind, columns)
        if source is None:
            raise BadInputError(
                f"{path}: no known map fits its series ({listed}); name one of 'groundstation"
                " convert --list-columns' with --columns, or describe the columns in a TOML file"
            )
    column_map, map_path = map_for(path, kind, source)
    rows = by_name.get(column_map.rows)
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
    plan, unclear = _of_a_quadrotor(plan, column_map.only, parameters)
    values = _on_rows(plan, rows, columns)
    names = [name.rpartition(".")[2] for name in columns]
    return mapped_recording(path, plan, column_map, values, names, unclear, damage)


def _of_a_quadrotor(
    plan: Plan, only: Mapping[str, Sequence[int]], parameters: Mapping[str, float]
) -> tuple[Plan, dict[str, str]]:
    """The plan without motors where the log's parameters say that they are another craft's, and
    that in words."""
    for name, values in only.items():
        if name in parameters and parameters[name] not in values:
            channels = tuple(one for one in plan.channels if one.field not in MOTORS)
            what = f"{name} {parameters[name]:g}"
            if name == "MAV_TYPE" and parameters[name] in MAV_TYPES:
                what += f", {MAV_TYPES[int(parameters[name])]}"
            return replace(plan, channels=channels), {
                "duty": f"not of a quadrotor ({what}): its motors are left out"
            }
    return plan, {}


def _on_rows(plan: Plan, rows: Series, columns: _Columns) -> NDArray[np.float64]:
    """The planned columns at the times of ``rows``, shape (n, k): the last value known by then, NaN
    before the first."""
    wanted = (*plan.channels, *plan.kept)
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
