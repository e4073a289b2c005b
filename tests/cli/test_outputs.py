"""New files and answers for programs: one rule each, whichever command."""

import json

import pytest
import typer
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.errors import BadInputError
from support import RECORDINGS

EXCERPT = RECORDINGS / "thesis_excerpt.csv"
TORN = RECORDINGS / "thesis_excerpt.mcap"


def commands(group, *path):
    """Every command as (words, click command)."""
    for name, one in getattr(group, "commands", {}).items():
        yield from commands(one, *path, name)
    if not hasattr(group, "commands"):
        yield path, group


EVERY = dict(commands(typer.main.get_command(app)))
SILENT = {("run",), ("install", "udev"), ("install", "service")}
"""What answers nothing that a program would read: the daemon is asked with ``status``."""


def parameters(command):
    return {name: one for one in command.params for name in one.opts}


def test_json_is_a_flag_that_prints_and_after_discrepancy_alone_a_file():
    options = {words: parameters(command).get("--json") for words, command in EVERY.items()}
    assert {words for words, option in options.items() if option is None} == SILENT
    files = {words for words, option in options.items() if option and not option.is_flag}
    assert files == {("discrepancy",)}


MISSING = [
    ("convert", EXCERPT, "{}"),
    ("recover", TORN, "-o", "{}"),
    ("attitude", RECORDINGS / "stand_in_flight.mcap", "-o", "{}"),
    ("simulate", "--model", "thesis", "--reference", "hover", "-o", "{}"),
    ("compare", EXCERPT, "--model", "thesis", "--html", "{}"),
    ("pid", "evaluate", "--html", "{}"),
    ("pid", "design", "--model", "thesis", "-o", "{}"),
    ("fit", "body", EXCERPT, "-o", "{}"),
    *(
        ("discrepancy", EXCERPT, "--model", "thesis", option, "{}")
        for option in ("-o", "--json", "--html", "--rerun")
    ),
]


@pytest.mark.parametrize("arguments", MISSING, ids=lambda one: f"{one[0]} {one[-2]}")
def test_no_command_makes_the_folder_of_a_file_or_writes_over_one(tmp_path, arguments):
    taken = tmp_path / "taken.mcap"
    taken.write_bytes(b"mine")
    for path, told in (
        (tmp_path / "nodir" / "new.mcap", "there is no folder"),
        (taken, "exists already"),
    ):
        words = [str(one).replace("{}", str(path)) for one in arguments]
        with pytest.raises(BadInputError, match=told):
            CliRunner().invoke(app, words, catch_exceptions=False)
    assert [one.name for one in tmp_path.iterdir()] == ["taken.mcap"]
    assert taken.read_bytes() == b"mine"


def test_a_page_that_was_asked_for_is_named_in_the_answer(tmp_path):
    page = tmp_path / "page.html"
    arguments = ["pid", "evaluate", "--html", str(page)]
    done = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert done.output.rstrip().endswith(f"written: {page}")
    assert page.exists()


def test_convert_answers_programs_too(tmp_path):
    out = tmp_path / "excerpt.mcap"
    done = CliRunner().invoke(app, ["convert", str(EXCERPT), str(out), "--json"])
    assert json.loads(done.stdout) == {"file": str(out), "samples": 25}
