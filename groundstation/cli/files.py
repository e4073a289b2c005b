"""Commands on recordings: inspect, convert, recover."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from groundstation.errors import BadInputError, DamagedRecordingError

if TYPE_CHECKING:
    from groundstation.recording.session import Recording

GAPS_SHOWN = 5


def add_commands(app: typer.Typer) -> None:
    app.command("inspect")(inspect)
    app.command("convert")(convert)
    app.command("recover")(recover)


def inspect(
    file: Path = typer.Argument(help="A recording: .mcap, .csv, .rrd or a microSD log."),
    columns: Path | None = typer.Option(None, help="Column map (TOML) for any other CSV."),
    as_json: bool = typer.Option(False, "--json", help="Print JSON for programs."),
) -> None:
    """What is in a recording, its quality and its gaps.

    Example: [bold]groundstation inspect recordings/thesis_excerpt.csv[/bold]
    """
    from groundstation.recording.quality import inspect_recording

    recording = _open(file, columns)
    report = inspect_recording(recording)
    if as_json:
        typer.echo(json.dumps(report, indent=2))
    else:
        _print_report(report)
    _raise_damage(recording)


def convert(
    source: Path = typer.Argument(metavar="IN", help="Any readable recording."),
    target: Path = typer.Argument(metavar="OUT", help="A new .mcap, .csv or .rrd file."),
    columns: Path | None = typer.Option(None, help="Column map (TOML) for any other CSV."),
    physical: bool = typer.Option(
        False, "--physical", help="CSV in physical units instead of the packet's integers."
    ),
) -> None:
    """Convert between recordings, logs and tables.

    Example: [bold]groundstation convert flight.mcap flight.csv --physical[/bold]
    """
    writer = _writer(target, physical)
    if target.exists():
        raise BadInputError(f"{target} exists already; nothing is ever overwritten")
    recording = _open(source, columns)
    with _progress(f"writing {target}"):
        writer(recording, target)
    typer.echo(f"{target}: {len(recording.samples)} samples")
    if target.suffix.lower() == ".csv" and not physical:
        _warn_of_zeros(recording)
    _raise_damage(recording)


def recover(
    file: Path = typer.Argument(help="A torn or damaged MCAP file."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="The new file (default: FILE with .recovered.mcap)."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print JSON for programs."),
) -> None:
    """Copy everything readable of a torn recording into a fresh file.

    Example: [bold]groundstation recover sessions/flight.mcap[/bold]
    """
    from dataclasses import asdict

    from groundstation.recording.recover import recover as recover_file

    with _progress(f"reading {file}"):
        report = recover_file(file, output)
    if as_json:
        typer.echo(json.dumps(asdict(report), default=str, indent=2))
    elif report.sound:
        typer.echo(f"{file}: sound, {report.messages} messages; nothing to do")
    else:
        for line in report.damage:
            typer.echo(f"  {line}")
        typer.echo(
            f"{report.output}: {report.messages} messages kept; {report.bytes_lost} bytes and at "
            f"most {report.seconds_lost:.2f} s inside damaged places lost"
        )


def _open(path: Path, columns: Path | None) -> Recording:
    from groundstation.recording.open_recording import open_recording

    with _progress(f"reading {path}"):
        return open_recording(path, raw=True, column_map=columns)


def _writer(target: Path, physical: bool) -> Callable[[Recording, Path], None]:
    kind = target.suffix.lower()
    if physical and kind != ".csv":
        raise BadInputError(f"{target}: --physical is for CSV files")
    if kind == ".mcap":
        from groundstation.recording.recording_file import write_mcap

        return write_mcap
    if kind == ".csv":
        from groundstation.recording.csv_file import write_csv, write_table_csv

        return write_table_csv if physical else write_csv
    if kind == ".rrd":
        from groundstation.viewer.rrd import write_rrd

        return write_rrd
    raise BadInputError(f"{target}: the name must end in .mcap, .csv or .rrd")


def _warn_of_zeros(recording: Recording) -> None:
    """The packet has a place for every channel, and no value that means 'not known'."""
    from groundstation.recording.channels import CHANNELS

    carried = [channel for channel in CHANNELS if channel.field != "rotor_rev_s"]
    missing = [channel.name for channel in carried if not channel.is_in(recording.samples)]
    if missing:
        typer.echo(
            f"groundstation: {recording.path} has no {', '.join(missing)}: written as 0; "
            "--physical leaves them out",
            err=True,
        )


def _raise_damage(recording: Recording) -> None:
    """What was good has been used by now; the exit status tells that something was not."""
    if recording.damage:
        more = len(recording.damage) - 1
        also = f" (and {more} more damaged places)" if more else ""
        repair = "; 'groundstation recover' makes a sound copy" if recording.kind == "mcap" else ""
        raise DamagedRecordingError(f"{recording.path}: {recording.damage[0]}{also}{repair}")


@contextlib.contextmanager
def _progress(text: str) -> Iterator[None]:
    """A spinner on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield


def _packets_line(report: dict[str, Any]) -> str:
    line = f"{report['raw_packets']}, {report['duplicates']} of them copies"
    for name in ("malformed", "damaged"):
        line += f", {report[name]} {name}" * bool(report[name])
    return line


def _print_report(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    facts = [
        ("file", f"{report['file']} ({report['kind']}, link {report['link']})"),
        ("verdict", report["verdict"]),
        ("span", f"{report['duration_s']:.3f} s, {report['segments']} segment(s)"),
        ("samples", f"{report['samples']} at {report['rate_hz']:.2f} Hz"),
        ("raw packets", _packets_line(report)),
        ("lost", f"{report['lost_samples']} samples in {report['gap_count']} gap(s)"),
    ]
    facts += [
        ("", f"{gap['duration_s'] * 1e3:.1f} ms at {gap['start_s']:.3f} s")
        for gap in report["gaps"][:GAPS_SHOWN]
    ]
    for name, jitter in report["jitter"].items():
        if jitter:
            shown = ", ".join(f"{key} {value * 1e3:.3f} ms" for key, value in jitter.items())
            facts.append((name.removesuffix("_s").replace("_", " "), shown))
    facts += [("table", f"{name}: {rows} rows") for name, rows in report["tables"].items()]
    facts += [(each["link"], f"{each['kind']}: {each['text']}") for each in report["marks"]]
    for name, text in facts:
        console.print(f"[bold]{name:<14}[/bold]", end="", highlight=False)
        console.print(text, highlight=False, markup=False, soft_wrap=True)
    table = Table("channel", "unit", box=None, header_style="bold")
    for heading in ("min", "mean", "max", "clipped"):
        table.add_column(heading, justify="right")
    for name, values in report["ranges"].items():
        numbers = (f"{values[key]:.4g}" for key in ("min", "mean", "max"))
        table.add_row(name, values["unit"], *numbers, str(report["clipping"].get(name, 0)))
    console.print(table)
    if report["missing"]:
        missing = ", ".join(report["missing"])
        console.print(f"[bold]without data  [/bold]{missing}", highlight=False, soft_wrap=True)
