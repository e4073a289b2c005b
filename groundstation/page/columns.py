"""``python -m groundstation.page.columns FILE``: the columns of another program's file and what
they probably are, as JSON for the form with which the page asks for them; ``null`` where a map that
ships with the program knows the file.

With a file of the form's answers behind FILE: the text of the column map that they make.

Files are read in a process of its own, as by ``series.py``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from groundstation.errors import BadInputError, GroundStationError
from groundstation.recording.csv_file import THESIS_COLUMNS
from groundstation.recording.map_document import UNITS, Chosen, map_text, rows_of
from groundstation.recording.map_guess import (
    KEYS,
    SIGNED,
    FileColumn,
    FileColumns,
    columns_of,
    guess_map,
    quantity_of,
)
from groundstation.recording.map_plan import map_of_header, map_of_series
from groundstation.text import printable

COLUMNS_MOST = 5000
"""A log of every topic has three thousand."""
_NAMES = {
    **{"time": "Time", "battery": "Battery", "duty": "Motor", "gyro": "Gyro"},
    **{"accelerometer": "Accelerometer", "attitude": "Attitude", "quaternion": "Quaternion"},
    **{"rotor": "Rotor speed"},
}


def map_of_answers(file: FileColumns, answers: bytes) -> str:
    """The TOML text of a map. answers: a JSON list of ``Chosen``. Raises BadInputError."""
    try:
        chosen = msgspec.json.decode(answers, type=list[Chosen])
    except msgspec.MsgspecError as error:
        raise BadInputError(f"{file.path.name}: no answers of the form: {error}") from error
    for one in chosen:
        if one.key not in KEYS:
            raise BadInputError(f"{file.path.name}: {one.key} is no channel")
    return map_text(chosen, file.path.name, file.kind, rows_of(file.series, chosen))


def form_of(file: FileColumns) -> dict[str, Any] | None:
    """The form for a file; None where the program knows its columns."""
    if _is_known(file):
        return None
    guesses = guess_map(file.columns)
    units = {quantity_of(key): one.unit for key, one in guesses.channels.items()}
    channels = []
    for key in KEYS:
        guess = guesses.channels.get(key)
        quantity, _, part = key.partition(".")
        channels.append(
            {
                "key": key,
                "label": f"{_NAMES[quantity]} {part.removeprefix('m')}".strip(),
                "units": list(UNITS[quantity]),
                "signed": quantity in SIGNED,
                "column": None if guess is None else guess.column.reference,
                "unit": units.get(quantity, ""),
                "sign": 1 if guess is None else guess.sign,
                "why": "" if guess is None else guess.why,
            }
        )
    with_numbers = [one for one in file.columns if one.has_numbers][:COLUMNS_MOST]
    return {
        "columns": [{"reference": one.reference, "text": _shown(one)} for one in with_numbers],
        "channels": channels,
        "notes": list(guesses.notes),
    }


def _is_known(file: FileColumns) -> bool:
    names = [one.name for one in file.columns]
    if file.kind != "csv":
        return map_of_series(file.kind, names) is not None
    small = {one.lower() for one in names}
    is_ours = "time_s" in small or {one.lower() for one in THESIS_COLUMNS} <= small
    return is_ours or map_of_header(names) is not None


def _shown(column: FileColumn) -> str:
    """A column's name and its first numbers."""
    known = column.values[np.isfinite(column.values)][:3]
    numbers = ", ".join(f"{one:.5g}" for one in known)
    return printable(f"{column.name or f'column {column.reference}'}: {numbers}")


def main(path: str, answers: str | None = None) -> int:
    try:
        file = columns_of(Path(path))
        if answers is None:
            print(json.dumps(form_of(file)))
        else:
            print(map_of_answers(file, Path(answers).read_bytes()), end="")
    except GroundStationError as error:
        print(printable(str(error)), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
