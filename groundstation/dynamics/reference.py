"""Reference programmes: what a simulated craft is asked to do, angles over time.

Built in are ``hover``, ``step``, ``doublet`` and ``sine``, each on roll, pitch and yaw in turn;
any other is a CSV file with the columns ``time_s``, ``roll_deg``, ``pitch_deg``, ``yaw_deg`` and,
if wanted, ``height_m``, linear between its rows.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

SIZE_RAD, SETTLE_S, HOLD_S = np.radians(10.0), 1.0, 0.5
SINE_HZ, SINE_PERIODS = 1.0, 3
HEIGHT_M = 1.0
BUILT_IN = ("hover", "step", "doublet", "sine")
LONGEST_S, STEEPEST_RAD = 600.0, np.radians(60.0)


@dataclass(frozen=True, slots=True)
class Reference:
    """attitude: (n, 3) rad roll, pitch (nose down), yaw; height_m: (n,); rows 2 ms apart."""

    name: str
    attitude: Array
    height_m: Array

    def __len__(self) -> int:
        return len(self.attitude)


def load_reference(source: str | Path) -> Reference:
    """A built-in programme by name, or a CSV file by path.

    Raises BadInputError, naming the built-in ones or the row that is wrong.
    """
    if str(source) in BUILT_IN:
        attitude = _built_in(str(source))
        return Reference(str(source), attitude, np.full(len(attitude), HEIGHT_M))
    path = Path(source)
    if not path.is_file():
        raise BadInputError(
            f"reference {str(source)!r}: neither built in ({', '.join(BUILT_IN)}) nor a file"
        )
    table, found = read_rows(path, ("height_m",))
    has_height = "height_m" in found
    time = table[:, 0] - table[0, 0]
    grid = np.arange(0.0, time[-1], SAMPLE_PERIOD_S)
    columns = [np.interp(grid, time, table[:, i]) for i in range(1, table.shape[1])]
    attitude = np.radians(np.column_stack(columns[:3]))
    if np.abs(attitude[:, :2]).max() > STEEPEST_RAD:
        raise BadInputError(
            f"reference {path}: a tilt of {np.degrees(np.abs(attitude[:, :2]).max()):.0f} deg;"
            f" at most {np.degrees(STEEPEST_RAD):.0f} can be flown"
        )
    height = columns[3] if has_height else np.full(len(grid), HEIGHT_M)
    return Reference(path.stem, attitude, height)


def _built_in(name: str) -> Array:
    rest = np.zeros(round(SETTLE_S / SAMPLE_PERIOD_S))
    hold = np.ones(round(HOLD_S / SAMPLE_PERIOD_S))
    time = np.arange(0.0, SINE_PERIODS / SINE_HZ, SAMPLE_PERIOD_S)
    shapes = {
        "hover": 0.0 * hold,
        "step": hold,
        "doublet": np.concatenate([hold, -hold]),
        "sine": np.sin(2 * np.pi * SINE_HZ * time),
    }
    piece = np.concatenate([rest, SIZE_RAD * shapes[name], rest])
    attitude = np.zeros((3 * len(piece), 3))
    for axis in range(3):
        attitude[axis * len(piece) : (axis + 1) * len(piece), axis] = piece
    return attitude


def read_rows(path: Path, wanted: Sequence[str]) -> tuple[Array, list[str]]:
    """The rows of a CSV file (n, 4 + those of ``wanted`` that it has), time and angles first, and
    the names of its columns, in that order.

    Raises BadInputError naming what is missing, or the row that is wrong.
    """
    needed = ("time_s", "roll_deg", "pitch_deg", "yaw_deg")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            names = reader.fieldnames or []
            missing = [name for name in needed if name not in names]
            if missing:
                raise BadInputError(
                    f"reference {path}: no column {', '.join(missing)}; needed are"
                    f" {', '.join(needed)}, and {', '.join(wanted)} if wanted"
                )
            chosen = [*needed, *(name for name in wanted if name in names)]
            rows = []
            for number, row in enumerate(reader, 2):
                try:
                    rows.append([float(row[name]) for name in chosen])
                except (TypeError, ValueError) as error:
                    raise BadInputError(f"reference {path}, line {number}: {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"reference {path}: cannot be read: {error}") from error
    table = np.array(rows)
    if len(rows) < 2 or not np.isfinite(table).all() or (np.diff(table[:, 0]) < 0).any():
        raise BadInputError(
            f"reference {path}: needs two rows or more of finite numbers, time_s ascending"
        )
    if not 0.1 <= table[-1, 0] - table[0, 0] <= LONGEST_S:
        raise BadInputError(f"reference {path}: must last 0.1..{LONGEST_S:.0f} s")
    return table, chosen
