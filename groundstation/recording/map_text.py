"""A column map as the text of its TOML file."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from groundstation.documents import decode_toml
from groundstation.errors import BadInputError
from groundstation.recording.map_document import ColumnMap, Kind
from groundstation.text import printable

_HEADING = ("attitude.yaw", "quaternion.z")
"""What has a heading: PX4's is from the north, by the frame of its ULog."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """A channel's column, unit and sign. step_s: seconds between rows, of time without a column."""

    key: str
    column: str | int
    unit: str
    sign: int = 1
    step_s: float = 0.0


def map_text(
    chosen: Sequence[Chosen], file: str, kind: Kind = "csv", rows: str = "", command: str = ""
) -> str:
    """The TOML text of a map. file: that it was made for. rows: series that gives the rows of a log
    of many. command: that reads the file with it, for a remark.

    Raises BadInputError where no channel but time is chosen, or a unit or column is none.
    """
    if not any(one.key != "time" for one in chosen):
        raise BadInputError(f"{file}: no channel was given a column; a map needs one beside time")
    remarks = (f"Columns of {file}", command)
    lines = [f"# {printable(one)}" for one in remarks if one]
    if kind != "csv":
        lines += [f"kind = {_text(kind)}", f"rows = {_text(rows)}"]
    if kind == "ulog" and any(one.key in _HEADING for one in chosen):
        lines.append('yaw_from = "north"')
    for one in chosen:
        lines += ["", f"[{one.key}]"]
        if one.step_s:
            lines.append(f"step = {one.step_s!r}")
            continue
        column = one.column if isinstance(one.column, int) else _text(one.column)
        lines += [f"column = {column}", f"unit = {_text(one.unit)}"]
        if one.sign < 0:
            lines.append("sign = -1")
    text = "\n".join(lines) + "\n"
    try:
        decode_toml(text.encode(), ColumnMap)
    except ValueError as error:
        raise BadInputError(f"{file}: no column map: {error}") from error
    return text


def rows_of(series: Sequence[str], chosen: Sequence[Chosen]) -> str:
    """The series that gives the rows of a log of many: that of the gyro, or else of another
    channel; empty for a table."""
    order = {"gyro.x": 0, "gyro.y": 1, "accelerometer.x": 2, "time": 4}
    first = min(chosen, key=lambda one: order.get(one.key, 3), default=None)
    named = "" if first is None else str(first.column)
    return max((one for one in series if named.startswith(f"{one}.")), key=len, default="")


def command_with(file: Path, map_path: Path) -> str:
    """The command that reads a file by a map, as a shell takes it."""
    return f"groundstation inspect {shlex.quote(str(file))} --columns {shlex.quote(str(map_path))}"


def _text(value: str) -> str:
    """A string of TOML: JSON's, but for DEL, which TOML wants escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
