"""The dialogue that makes a column map: each channel's column, unit and sign, asked in the
terminal with what the file's names and numbers suggest."""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from groundstation import BadInputError
from groundstation.cli.progress import own_terminal
from groundstation.cli.terminal import show
from groundstation.text import counted, printable

if TYPE_CHECKING:
    from groundstation.recording.map_document import Chosen
    from groundstation.recording.map_guess import FileColumn, FileColumns, Guess

LISTED = 60
"""Columns that are listed; a log of many series has thousands."""
_HELP = (
    "Which column is each channel? Enter takes what is in brackets, - leaves the channel out;",
    "another column: its name or number. Then its unit and sign are asked.",
    "Axes: x forward, y left, z up; roll left side up, pitch nose down, yaw counter-clockwise.",
)


def ask_map(path: Path, map_path: Path) -> str:
    """The text of a column map, from a dialogue.

    Raises BadInputError where the answers end before the last question, or nothing was chosen, and
    as ``columns_of``.
    """
    from groundstation.recording.map_document import command_with, map_text, rows_of
    from groundstation.recording.map_guess import columns_of, guess_map

    file = columns_of(path)
    own_terminal()
    _list(file)
    guesses = guess_map(file.columns)
    for line in (*_HELP, *guesses.notes):
        show(line)
    show()
    try:
        chosen = _Questions(file, guesses.channels).ask()
    except EOFError as error:
        show()
        raise BadInputError(
            f"{path}: the answers ended before the last question; nothing was written"
        ) from error
    rows = rows_of(file.series, chosen)
    return map_text(chosen, path.name, file.kind, rows, command_with(path, map_path))


def _list(file: FileColumns) -> None:
    columns = file.columns
    show(f"{file.path}: {counted(len(columns), 'column')}")
    width = min(32, max(len(one.name) for one in columns))
    for number, one in enumerate(columns[:LISTED], 1):
        show(f"{number:>4}  {one.name:<{width}}  {_first(one)}")
    if len(columns) > LISTED:
        show(f"      and {len(columns) - LISTED} more: any of them can be named")


def _first(column: FileColumn) -> str:
    if not column.has_numbers:
        return "no numbers"
    known = column.values[np.isfinite(column.values)]
    first = ", ".join(f"{one:.6g}" for one in known[:3])
    return f"{first} ... ({known.min():.4g} to {known.max():.4g})"


class _Questions:
    """Asks for one channel after the other."""

    def __init__(self, file: FileColumns, guesses: Mapping[str, Guess]) -> None:
        self._columns, self._guesses = file.columns, guesses
        self._units: dict[str, str] = {}

    def ask(self) -> list[Chosen]:
        """Raises EOFError where no more answers come."""
        from groundstation.recording.map_guess import KEYS, quantity_of

        chosen: list[Chosen] = []
        passed = ""
        for key in KEYS:
            quantity = quantity_of(key)
            has = {quantity_of(one.key) for one in chosen}
            if quantity == passed or (quantity == "quaternion" and "attitude" in has):
                continue
            one = self._time() if key == "time" else self._channel(key)
            if one is not None:
                chosen.append(one)
            elif not any(quantity_of(other) == quantity for other in self._guesses):
                passed = quantity  # nothing of it is there
        return chosen

    def _time(self) -> Chosen:
        from groundstation.recording.map_document import Chosen

        while True:
            one = self._channel("time")
            if one is not None:
                return one
            answer = _read("  seconds between rows, for a file without a time column: ")
            try:
                step_s = float(answer)
            except ValueError:
                step_s = 0.0
            if 0.0 < step_s <= 10.0:
                return Chosen("time", 0, "", step_s=step_s)
            show("  Give seconds up to 10, 0.01 say.")

    def _channel(self, key: str) -> Chosen | None:
        """The answer to one channel, None where it is left out."""
        from groundstation.recording.map_document import Chosen

        guess = self._guesses.get(key)
        offered = "-" if guess is None else self._offered(guess)
        while True:
            answer = _read(f"{key} [{offered}]: ")
            if answer == "-" or (not answer and guess is None):
                return None
            if not answer and guess is not None:
                unit = self._units.get(key.partition(".")[0], guess.unit)
                return Chosen(key, guess.column.reference, unit, guess.sign)
            column = self._named(answer)
            if column is not None:
                unit = self._unit(key, column)
                return Chosen(key, column.reference, unit, self._sign(key, guess))

    def _offered(self, guess: Guess) -> str:
        unit = self._units.get(guess.key.partition(".")[0], guess.unit)
        sign = "-" if guess.sign < 0 else ""
        why = guess.why if unit == guess.unit else f"{guess.why.partition(';')[0]}; unit as before"
        measured = f"{sign}{unit}" if unit != "1" else sign
        label = f"{self._label(guess.column)} in {measured}" if measured else ""
        return f"{label or self._label(guess.column)}: {why}"

    def _label(self, column: FileColumn) -> str:
        number = next(n for n, one in enumerate(self._columns, 1) if one is column)
        return f"{number} {column.name}".strip()

    def _named(self, answer: str) -> FileColumn | None:
        """The column of a name or number; None where there is none, which is said."""
        names = [one.name for one in self._columns]
        found = [one for one in self._columns if one.name == answer]
        if not found and answer.isdecimal() and 1 <= int(answer) <= len(names):
            found = [self._columns[int(answer) - 1]]
        if len(found) == 1 and found[0].has_numbers:
            return found[0]
        if len(found) == 1:
            show(f"  Column {self._label(found[0])} holds no numbers. Give another one.")
        elif found:
            show(f"  {len(found)} columns are called {answer}: give the number of one.")
        else:
            near = difflib.get_close_matches(answer, names, n=1, cutoff=0.5)
            hint = f" Did you mean {near[0]}?" if near else ""
            show(f"  There is no column {answer}.{hint} Give a name, a number, or -.")
        return None

    def _unit(self, key: str, column: FileColumn) -> str:
        from groundstation.recording.map_document import UNITS
        from groundstation.recording.map_guess import guess_unit

        quantity = key.partition(".")[0]
        units = list(UNITS[quantity])
        if len(units) == 1:
            return units[0]
        guess, why = guess_unit(quantity, [column])
        if quantity in self._units:
            guess, why = self._units[quantity], "as before"
        while True:
            answer = _read(f"  unit, one of {', '.join(units)} [{guess}: {why}]: ") or guess
            if answer in units:
                self._units[quantity] = answer
                return answer
            show(f"  {answer} is no unit of {quantity}.")

    def _sign(self, key: str, guess: Guess | None) -> int:
        from groundstation.recording.map_guess import SIGNED

        if key.partition(".")[0] not in SIGNED:
            return 1
        usual = "-" if guess is not None and guess.sign < 0 else "+"
        while True:
            answer = _read(f"  sign, - where the axis points the other way [{usual}]: ") or usual
            if answer in ("+", "1", "+1", "-", "-1"):
                return -1 if answer.startswith("-") else 1
            show("  Give + or -.")


def _read(question: str) -> str:
    return input(printable(question)).strip()


def map_path_of(path: Path) -> Path:
    """Where the map of a file goes: beside it. Raises BadInputError, before anything is asked,
    where it is there already."""
    new = path.with_name(f"{path.stem or path.name}.map.toml")
    if new.exists():
        raise BadInputError(
            f"{new} exists already. It is used by: groundstation inspect {shlex.quote(str(path))}"
            f" --columns {shlex.quote(str(new))}"
        )
    return new
