"""A command is one module, and its name in a list."""

import json

from groundstation import cli
from groundstation.cli.app import add, app
from support import RECORDINGS
from support.daemons import in_process, require_failure

MODULE = '''
from pathlib import Path

import typer

from groundstation import BadInputError, open_recording
from groundstation.cli.model_files import AS_JSON
from groundstation.cli.terminal import show, show_json


def add_commands(app):
    app.command("count")(count)


def count(recording: Path, as_json: bool = AS_JSON) -> None:
    """Count the samples of a recording.

    Example: [bold]groundstation count flight.mcap[/bold]
    """
    samples = len(open_recording(recording).samples)
    if not samples:
        raise BadInputError(f"{recording}: no samples; give another")
    show_json({"samples": samples}) if as_json else show(f"{samples} samples")
'''


def test_a_command_is_added_by_one_module(tmp_path, monkeypatch):
    (tmp_path / "count_samples.py").write_text(MODULE)
    monkeypatch.setattr(cli, "__path__", [*cli.__path__, str(tmp_path)])
    monkeypatch.setattr(app, "registered_commands", list(app.registered_commands))
    add("count_samples")
    excerpt = RECORDINGS / "thesis_excerpt.csv"
    assert "count" in in_process("--help").stdout
    assert in_process("count", excerpt).stdout == "25 samples\n"
    assert json.loads(in_process("count", excerpt, "--json").stdout) == {"samples": 25}
    assert "nowhere" in require_failure(in_process("count", tmp_path / "nowhere"))
