"""``python -m groundstation.page.reading``: what the page shows of a file, read in a process of its
own: a file of strangers costs the page nothing.

``series FILE``: a recording's channels. On standard output: four bytes with the length of a JSON
header, the header, then for each of its tables the times (float64) and the columns (float32),
little endian, one after the other.

``columns FILE``: the columns of another program's file and what they probably are, as JSON for the
form with which the page asks for them; ``null`` where a map that ships with the program knows the
file. With a file of the form's answers behind FILE: the text of the column map that they make.
"""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, GroundStationError
from groundstation.page.follower import COLUMNS, TELEMETRY
from groundstation.recording.csv_file import THESIS_COLUMNS
from groundstation.recording.formats import open_recording
from groundstation.recording.map_document import UNITS, Chosen, known_map, map_text, rows_of
from groundstation.recording.map_guess import (
    KEYS,
    SIGNED,
    FileColumn,
    FileColumns,
    columns_of,
    guess_map,
    quantity_of,
)
from groundstation.recording.mcap_schemas import SAMPLE_FIELDS
from groundstation.recording.session import Recording
from groundstation.telemetry.samples import SampleBatch
from groundstation.text import printable

ROWS_MOST = 40_000
"""Of a table that has more every nth is shown, each as it was recorded."""
EVENTS_MOST = 500


@dataclass(frozen=True, slots=True)
class Series:
    """time_s: (n,), from the first sample on, never backwards; columns: name -> (n,)."""

    name: str
    time_s: NDArray[np.float64]
    columns: dict[str, NDArray[np.float32]]


def write(recording: Recording, out: BinaryIO) -> None:
    """Everything of a recording that can be plotted."""
    begin_s, tables = series(recording)
    head: dict[str, Any] = {
        "file": recording.path.name,
        "vehicle": recording.metadata.get("vehicle", {}).get("profile", ""),
        "damage": recording.damage[:5],
        "events": list(_events(recording)),
        "tables": [],
    }
    arrays: list[NDArray[Any]] = []
    for one in tables:
        step = max(1, -(-len(one.time_s) // ROWS_MOST))
        head["tables"].append(
            {
                "name": one.name,
                "columns": list(one.columns),
                "rows": len(one.time_s[::step]),
                "every": step,
            }
        )
        arrays.append((one.time_s[::step] - begin_s).astype("<f8"))
        arrays += [column[::step].astype("<f4") for column in one.columns.values()]
    encoded = json.dumps(head).encode()
    encoded += b" " * (-(len(encoded) + 4) % 8)  # so that numbers lie where they can be read
    out.write(struct.pack("<I", len(encoded)) + encoded)
    for array in arrays:
        content = array.tobytes()
        out.write(content + b"\0" * (-len(content) % 8))


def series(recording: Recording) -> tuple[float, list[Series]]:
    """When the first sample was measured, s; the samples, and the tables that have numbers."""
    found = []
    samples = recording.samples
    if len(samples):
        found.append(Series(TELEMETRY, _onward(samples), dict(_channels(samples))))
    for name, table in recording.tables.items():
        columns = {
            key: values.astype(np.float32)
            for key, values in table.columns.items()
            if values.ndim == 1 and values.dtype.kind in "fiub"
        }
        order = np.argsort(table.time_s, kind="stable")
        if columns and len(order):
            ordered = {key: values[order] for key, values in columns.items()}
            found.append(Series(name, table.time_s[order], ordered))
    return (float(found[0].time_s[0]) if found else 0.0), found


def _channels(samples: SampleBatch) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Those that have any value, in the units of the page."""
    attributes = {field: name for name, (field, _) in SAMPLE_FIELDS.items()}
    for name, field, factor, parts in COLUMNS:
        with np.errstate(over="ignore"):  # what float32 does not hold is infinite, and not drawn
            values = np.asarray(getattr(samples, attributes[field]) * factor, np.float32)
        columns = values.reshape(len(samples), -1)
        for part, column in zip(parts, columns.T, strict=True):
            if np.isfinite(column).any():
                yield f"{name}.{part}", column


def _onward(samples: SampleBatch) -> NDArray[np.float64]:
    """Times that go on where the craft's clock began anew, by the clock of the host."""
    time_s = samples.time_s.copy()
    for row in np.flatnonzero(np.diff(samples.segment) != 0) + 1:
        host_s = float(samples.host_time_ns[row] - samples.host_time_ns[row - 1]) * 1e-9
        time_s[row:] += time_s[row - 1] + max(host_s, 1e-3) - time_s[row]
    return time_s


def _events(recording: Recording) -> Iterator[dict[str, Any]]:
    if not len(recording.samples):
        return
    first_ns = int(recording.samples.host_time_ns[0])
    for event in recording.events[:EVENTS_MOST]:
        if isinstance(at_ns := event.get("time_ns"), int):
            text = printable(f"{event.get('kind', '')}: {event.get('text', '')}")
            yield {"time_s": round((at_ns - first_ns) * 1e-9, 3), "text": text}


# The form that asks for a file's columns.


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
    small = {one.lower() for one in names} if file.kind == "csv" else set()
    is_ours = "time_s" in small or {one.lower() for one in THESIS_COLUMNS} <= small
    return is_ours or known_map(file.kind, names) is not None


def _shown(column: FileColumn) -> str:
    """A column's name and its first numbers."""
    known = column.values[np.isfinite(column.values)][:3]
    numbers = ", ".join(f"{one:.5g}" for one in known)
    return printable(f"{column.name or f'column {column.reference}'}: {numbers}")


def main(what: str, path: str, answers: str | None = None) -> int:
    try:
        if what == "series":
            write(open_recording(path), sys.stdout.buffer)
        elif answers is None:
            print(json.dumps(form_of(columns_of(Path(path)))))
        else:
            print(map_of_answers(columns_of(Path(path)), Path(answers).read_bytes()), end="")
    except GroundStationError as error:
        print(printable(str(error)), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:4]))
