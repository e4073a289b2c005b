"""New files and answers for programs: one rule each, whichever command."""

import json

import pytest
import typer

from groundstation.cli.app import app
from groundstation.errors import BadInputError
from groundstation.links.software_craft import SoftwareCraft
from groundstation.recording.mcap_file import write_mcap
from groundstation.recording.session import Recording
from support import RECORDINGS
from support.commands import done, run
from support.packets import packet_recording

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
    ("fit", "body", EXCERPT, "-o", "new.json", "--html", "{}"),
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
        with pytest.raises(BadInputError, match=told):
            run(*(str(one).replace("{}", str(path)) for one in arguments))
    assert [one.name for one in tmp_path.iterdir()] == ["taken.mcap"]
    assert taken.read_bytes() == b"mine"


def test_a_page_that_was_asked_for_is_named_in_the_answer(tmp_path):
    page = tmp_path / "page.html"
    assert run("pid", "evaluate", "--html", page).rstrip().endswith(f"written: {page}")
    assert page.exists()


def test_convert_answers_programs_too(tmp_path):
    out = tmp_path / "excerpt.mcap"
    found = json.loads(done("convert", EXCERPT, out, "--json").stdout)
    assert (found["file"], found["samples"]) == (str(out), 25)
    assert {"gyro_x", "battery", "duty_4", "yaw"} < set(found["channels"])


def test_a_flight_of_the_software_craft_is_inspected_with_its_marks(tmp_path):
    craft = SoftwareCraft("crazyflie21", "learn", seed=1)
    craft.wait(0.5)
    craft.mark("take-off")
    craft.wait(0.5)
    craft.save(tmp_path / "flight1.mcap")
    assert "mark: take-off" in run("inspect", tmp_path / "flight1.mcap")


def test_events_and_counts_of_another_program_s_file_may_lack_what_ours_have(tmp_path):
    made = packet_recording(range(100))
    events = [{"time_ns": 1, "kind": "mark"}, {"time_ns": 2, "kind": "mark", "text": 5, "link": []}]
    metadata = {"rows": {"copies": "many", "out_of_order": ""}}
    path = tmp_path / "theirs.mcap"
    write_mcap(Recording(path, "mcap", made.samples, events=events, metadata=metadata), path)
    assert "mark: 5" in run("inspect", path)
