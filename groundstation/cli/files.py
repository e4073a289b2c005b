"""Commands on recordings: inspect, convert, recover."""

from __future__ import annotations

import difflib
import shlex
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from groundstation import BadInputError
from groundstation.cli.model_files import AS_JSON, answer, require_new
from groundstation.cli.terminal import own_terminal, show, show_json, shown, spoken, tell_found
from groundstation.errors import DamagedRecordingError, RecordingError
from groundstation.paths import write_new
from groundstation.text import counted, printable

if TYPE_CHECKING:
    from groundstation import Recording
    from groundstation.recording.map_document import Chosen
    from groundstation.recording.map_guess import FileColumn, FileColumns, Guess

# What a folder of recordings holds, as ``inspect FOLDER`` shows it.


def list_folder(folder: Path, as_json: bool) -> None:
    """Oldest first: when, how long, from which link, how complete."""
    from groundstation.recording.mcap_scan import catalogue

    found = [entry.as_dict() for entry in catalogue(folder)]
    answer(as_json, found, map(_line, found) if found else [f"no recordings in {folder}"])


def _line(entry: dict[str, Any]) -> str:
    size = f"{entry['bytes'] / 1e6:8.1f} MB"
    if entry["state"] != "finished":
        hint = "" if entry["state"] == "recording" else "; see 'groundstation recover'"
        return f"{entry['file']:<44} {size}  {entry['state']}{hint}"
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(entry["start_ns"] * 1e-9))
    samples = "" if entry["samples"] is None else f", {entry['samples']} samples"
    part = f", part {entry['part']}" if (entry["part"] or 1) > 1 else ""
    marks = f", {entry['marks']} marks" if entry["marks"] else ""
    return (
        f"{entry['file']:<44} {size}  {began}  {entry['duration_s']:8.1f} s  {entry['link']}"
        f"{samples}{part}{marks}"
    )


# The dialogue that makes a column map: each channel's column, unit and sign, asked in the
# terminal with what the file's names and numbers suggest.


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


GAPS_SHOWN = 5
TABLE_WIDTH = 72
"""A narrower terminal wraps the lines: names cut to the same letters tell nothing."""


def _list_columns(asked: bool) -> None:
    if not asked:
        return
    from groundstation.recording.map_document import NAMED, load_column_map

    for name, path in NAMED.items():
        show(f"{name:<16}{load_column_map(path).title}")
    raise typer.Exit


COLUMNS = typer.Option(
    None,
    metavar="MAP",
    help="Columns of another program's file: a name of 'convert --list-columns', or TOML.",
)


ONLY = typer.Option(
    None,
    "--only",
    metavar="COLUMN=VALUE",
    help="The rows of one craft or sensor of a table that holds several; of a bag topic=/NAME.",
)
RATE = typer.Option(
    None,
    "--rate",
    metavar="HZ",
    min=0.1,
    max=100_000.0,
    help="Rows a second of a table that has no time column.",
)


def add_commands(app: typer.Typer) -> None:
    app.command("inspect")(inspect)
    app.command("convert")(convert)
    app.command("recover")(recover)


def inspect(
    file: Path = typer.Argument(
        help="A recording, another program's log, or a folder of recordings, which is listed."
    ),
    columns: str | None = COLUMNS,
    only: str | None = ONLY,
    rate_hz: float | None = RATE,
    as_json: bool = AS_JSON,
) -> None:
    """What is in a recording, its quality and its gaps.

    Example: [bold]groundstation inspect recordings/thesis_excerpt.csv[/bold]
    """
    from groundstation.recording.quality import inspect_recording
    from groundstation.recording.ros_bag import is_bag_folder

    if file.is_dir() and not is_bag_folder(file):
        if columns is not None:
            raise BadInputError(f"{file}: is a folder; --columns is for one file")
        list_folder(file, as_json)
        return
    recording = _open(file, columns, only, rate_hz)
    report = inspect_recording(recording)
    if as_json:
        show_json(report)
    else:
        _print_report(report)
    _raise_damage(recording)
    if not recording.being_written:
        _require_samples(recording)
        if report["verdict"].startswith("bad"):
            raise RecordingError(f"{recording.path}: bad, for the reason above")


def convert(
    source: Path = typer.Argument(metavar="IN", help="Any readable recording."),
    target: Path | None = typer.Argument(
        None, metavar="OUT", help="A new .mcap, .csv, .parquet or .rrd file; not needed with --map."
    ),
    columns: str | None = COLUMNS,
    ask_map: bool = typer.Option(
        False, "--map", help="Ask in the terminal which column is what, and write a column map."
    ),
    only: str | None = ONLY,
    rate_hz: float | None = RATE,
    list_columns: bool = typer.Option(
        False, "--list-columns", is_eager=True, callback=_list_columns, help="Name the known maps."
    ),
    physical: bool = typer.Option(
        False, "--physical", help="CSV in physical units instead of the packet's integers."
    ),
    ros2: float = typer.Option(
        0.0,
        "--ros2",
        metavar="HZ",
        min=0.0,
        max=1000.0,
        help="MCAP for ROS 2's tools (profile ros2) with so many rows a second; 500: all.",
    ),
    supply_v: float | None = typer.Option(
        None, metavar="V", help="What the motors were fed with, of a craft that does not tell it."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Convert between recordings, logs and tables.

    Example: [bold]groundstation convert flight.mcap flight.csv --physical[/bold]
    """
    from groundstation.recording.formats import writer_of
    from groundstation.recording.session import CHANNELS

    if target is None and not ask_map:
        raise typer.BadParameter("give the new file's name", param_hint="OUT")
    if target is not None:
        writer = writer_of(target, physical=physical, ros2_hz=ros2)
    require_new(target)
    if ask_map:
        columns = _new_map(source, columns, as_json=as_json)
    if target is None:
        return
    recording = _open(source, columns, only, rate_hz)
    if not recording.tables:
        _require_samples(recording)
    if supply_v is not None:
        _give_supply(recording, supply_v)
    with shown(f"writing {target}"):
        writer(recording, target)
    names = [one.name for one in CHANNELS if one.is_in(recording.samples)]
    told = {"file": str(target), "samples": len(recording.samples), "channels": names}
    answer(as_json, told, [f"{target}: {len(recording.samples)} samples"])
    if target.suffix.lower() == ".csv" and not physical:
        _warn_of_packets(recording)
    _raise_damage(recording)


def recover(
    file: Path = typer.Argument(help="A torn or damaged MCAP file."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="The new file (default: FILE with .recovered.mcap)."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Copy everything readable of a torn recording into a fresh file.

    Example: [bold]groundstation recover sessions/flight.mcap[/bold]
    """
    from dataclasses import asdict

    from groundstation.recording.mcap_scan import recover as recover_file

    require_new(output)
    with shown(f"reading {file}"):
        report = recover_file(file, output)
    if report.sound:
        lines = [f"{file}: sound, {report.messages} messages; nothing to do"]
    else:
        lines = [
            *(f"  {line}" for line in report.damage),
            f"{report.output}: {report.messages} messages kept; {report.bytes_lost} bytes and at "
            f"most {report.seconds_lost:.2f} s inside damaged places lost",
        ]
    answer(as_json, asdict(report), lines)


def _new_map(source: Path, columns: str | None, *, as_json: bool) -> str:
    """Where the column map is that a dialogue has made, which is told with the command for it."""

    from groundstation.recording.map_document import command_with

    if columns is not None or as_json:
        other = "--json" if as_json else "--columns"
        raise BadInputError(f"--map asks for the columns in the terminal: leave {other} out")
    path = map_path_of(source)
    write_new(path, ask_map(source, path))
    show(f"{path}: written. It is used by: {command_with(source, path)}")
    return str(path)


def _give_supply(recording: Recording, supply_v: float) -> None:
    """Raises BadInputError where the craft told its battery: a measurement is not replaced."""
    import numpy as np

    if not 2.0 <= supply_v <= 20.0:
        raise BadInputError(f"--supply-v {supply_v:g}: must be 2..20 V")
    voltage = recording.samples.battery_v
    if np.isfinite(voltage).any():
        raise BadInputError(f"--supply-v: {recording.path.name} has the battery's voltage")
    voltage[:] = supply_v
    recording.metadata["supply"] = {"given_v": f"{supply_v:g}"}


def _open(
    path: Path, columns: str | None, only: str | None = None, rate_hz: float | None = None
) -> Recording:
    from groundstation import open_recording
    from groundstation.recording.session import rows_of

    rows = rows_of(only, rate_hz)
    with shown(f"reading {path}"):
        return open_recording(path, raw=True, column_map=columns, rows=rows)


def _warn_of_packets(recording: Recording) -> None:
    """The packet has a place for every channel, and no value that means 'not known'."""
    from groundstation.recording.session import CHANNELS, UNCLEAR_METADATA, UNUSUAL

    carried = [channel for channel in CHANNELS if channel.field not in UNUSUAL]
    missing = [channel.name for channel in carried if not channel.is_in(recording.samples)]
    if missing:
        show(
            f"groundstation: {recording.path} has no {', '.join(missing)}: written as 0; "
            "--physical leaves them out",
            error=True,
        )
    if duty := recording.metadata.get(UNCLEAR_METADATA, {}).get("duty"):
        show(f"groundstation: {recording.path}: {duty}", error=True)


def _require_samples(recording: Recording) -> None:
    """Raises RecordingError for a recording of nothing, once what there is has been told."""
    if not len(recording.samples):
        _raise_damage(recording)
        raise RecordingError(f"{recording.path}: no samples, so there is nothing to judge or write")


def _raise_damage(recording: Recording) -> None:
    """What was good has been used by now; the exit status tells that something was not."""
    if recording.damage:
        more = len(recording.damage) - 1
        also = f" (and {more} more damaged places)" if more else ""
        repair = "; 'groundstation recover' makes a sound copy" if recording.kind == "mcap" else ""
        raise DamagedRecordingError(f"{recording.path}: {recording.damage[0]}{also}{repair}")


def _print_report(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from groundstation.recording.session import CHANNELS

    tell_found(report["verdict"])
    spoken()
    console = Console()
    console.width = max(console.width, TABLE_WIDTH)
    packets = f"{report['raw_packets']}, {report['duplicates']} of them copies"
    for name in ("malformed", "damaged"):
        packets += f", {report[name]} {name}" * bool(report[name])
    facts = [
        ("file", f"{report['file']} ({report['kind']}, link {report['link']})"),
        ("verdict", report["verdict"]),
        ("span", f"{report['duration_s']:.3f} s, {report['segments']} segment(s)"),
        ("samples", f"{report['samples']} at {report['rate_hz']:.2f} Hz"),
        ("raw packets", packets),
        ("lost", f"{report['lost_samples']} samples in {report['gap_count']} gap(s)"),
    ]
    facts += [
        ("", f"{gap['duration_s'] * 1e3:.1f} ms at {gap['start_s']:.3f} s")
        for gap in report["gaps"][:GAPS_SHOWN]
    ]
    facts += [("note", text) for text in report["notes"]]
    facts += [("table", f"{name}: {rows} rows") for name, rows in report["tables"].items()]
    for mark in report["marks"]:
        facts.append((mark["link"] or mark["kind"], f"{mark['kind']}: {mark['text']}"))
    for name, text in facts:
        line = Text(f"{printable(name):<14}", "bold").append(printable(text), "not bold")
        console.print(line, highlight=False, soft_wrap=True)
    table = Table("channel", "unit", box=None, header_style="bold")
    counted = [("clipped", report["clipping"]), ("missing", report["missing_values"])]
    counted = [(name, counts) for name, counts in counted if counts]
    for heading in ("min", "mean", "max", *(name for name, _ in counted), "new, Hz"):
        table.add_column(heading, justify="right")
    for name, values in report["ranges"].items():
        numbers = (f"{values[key]:.4g}" for key in ("min", "mean", "max"))
        counts = (str(those.get(name, 0)) for _, those in counted)
        field = next(one.field for one in CHANNELS if one.name == name)
        hz = report["renewed_hz"].get(field)  # where it could be measured
        table.add_row(name, values["unit"], *numbers, *counts, "" if hz is None else f"{hz:.4g}")
    console.print(table)
    if report["missing"]:
        missing = ", ".join(report["missing"])
        console.print(f"[bold]without data  [/bold]{missing}", highlight=False, soft_wrap=True)
