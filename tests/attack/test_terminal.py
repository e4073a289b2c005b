"""Escape sequences and new lines in recordings, marks and names: shown, never obeyed."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import groundstation.cli as commands
from groundstation.cli.control import events
from groundstation.recording.mcap_file import McapRecorder
from groundstation.report.page import figure, svg
from groundstation.telemetry.packet import TICK_S
from groundstation.telemetry.samples import empty_samples
from groundstation.text import printable
from support import RECORDINGS
from support.daemons import Daemon, groundstation

EVIL = "\x1b]0;owned\x07\x1b[2J\n00:00:00  recorder  all is well\x9b31m\u202eabc"


def is_tame(text):
    return not any(
        (ord(c) < 32 and c != "\n") or 0x7F <= ord(c) < 0xA0 or c == "\u202e" for c in text
    )


@pytest.fixture
def evil(tmp_path):
    """A recording that somebody made to command the terminal."""
    path = tmp_path / f"{EVIL[:9]}.mcap"
    samples = empty_samples(500, TICK_S)
    samples.ticks[:] = np.arange(500) * 148
    samples.host_time_ns[:] = 1_700_000_000_000_000_000 + np.arange(500) * 2_000_000
    metadata = {"session": {"link": EVIL, "session": EVIL, "part": "1"}}
    with McapRecorder(path, metadata, low_space_bytes=0) as recorder:
        recorder.samples(samples)
        recorder.event({"time_ns": int(samples.host_time_ns[0]), "link": "[/bold]" + EVIL,
                        "kind": "mark", "text": EVIL})  # fmt: skip
    return path


@pytest.mark.parametrize(
    ("command", "lines"), [("inspect", None), ("folder", 1), ("recover", 1), ("convert", None)]
)
def test_a_recording_cannot_command_the_terminal(evil, command, lines):
    target = evil
    if command == "folder":
        command, target = "inspect", evil.parent
    more = [evil.with_name(f"{EVIL[:9]}.csv")] if command == "convert" else []
    result = groundstation(command, target, *more)
    assert result.returncode in (0, 1)
    assert "Traceback" not in result.stderr
    assert is_tame(result.stdout + result.stderr)
    assert not any(line.startswith("00:00:00") for line in result.stdout.splitlines())
    assert lines is None or len(result.stdout.splitlines()) == lines


def test_events_of_a_daemon_are_one_tame_line_each(monkeypatch, capsys):
    entry = {"time_ns": 0, "link": EVIL, "kind": "mark", "text": EVIL}
    monkeypatch.setattr("groundstation.cli.control.ask", lambda *arguments: [entry, entry])
    events(as_json=False)
    said = capsys.readouterr().out
    assert is_tame(said)
    assert len(said.splitlines()) == 2
    events(as_json=True)
    said = capsys.readouterr().out
    assert is_tame(said)
    assert json.loads(said)[0]["text"] == EVIL


def test_the_daemons_own_log_is_tame(tmp_path):
    name = f"{EVIL[:9]}.csv"
    (tmp_path / name).write_bytes((RECORDINGS / "thesis_excerpt.csv").read_bytes())
    with Daemon(tmp_path, "--link", f"replay:{name}", "--no-record") as daemon:
        assert daemon.wait() == 0
        assert is_tame(daemon.stdout + daemon.stderr)
        assert r"\x1b]0;owned" in daemon.stdout


def test_a_name_with_dollars_is_a_title_and_no_formula():
    made, (axes, *_) = figure()
    axes.set_title(r"$\foo$.mcap")
    axes.text(0.5, 0.5, r"$\frac{$ " + EVIL)
    axes.plot([0, 1], label=r"$\bar")
    axes.legend()
    assert "<svg" in svg(made)


def test_every_line_is_printed_in_one_place():
    folder = Path(commands.__file__).parent
    calls = [
        f"{path.name}: {ast.unparse(node)}"
        for path in sorted(folder.glob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "typer.echo")
    ]
    allowed = ("terminal.py: ", "main.py: print(f'groundstation: {printable(", "install")
    assert [one for one in calls if not one.startswith(allowed)] == []


def test_printable_keeps_what_people_read():
    assert printable("Flug über Köln, 3 µs → 日本") == "Flug über Köln, 3 µs → 日本"
