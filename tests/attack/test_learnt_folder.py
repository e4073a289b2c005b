"""A folder that somebody else made, given to ``learn -o``: pipes, devices, links and scripts."""

import errno
import json
import os

import pytest

from groundstation.dynamics.model import save_model, vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.learn.planning import (
    JOURNAL,
    Journal,
    Limits,
    Planned,
    Task,
    flight_of,
    journal_in,
)
from groundstation.learn.story import read_found
from groundstation.paths import write_whole, written_whole
from groundstation.shell import LOG, SCRIPT, Shell
from support.daemons import in_process, require_failure

pytestmark = pytest.mark.timeout(60)

TASK = Task(link="daemon", vehicle="", height_m=0.5, reach_m=1.0, seed=1, batteries=1)
LIMITS = Limits(reach_m=1.0, height_m=0.5)
PLANNED = Planned(flight_of((), "nothing", LIMITS, 1), (), {}, 1)


def gone_on_with(folder):
    (folder / SCRIPT).touch()
    with Shell(folder, {"craft.toml": ""}, lambda line: None, goes_on=True):
        pass


WRITERS = {
    "learn.json": lambda folder: Journal(task=TASK).save(folder),
    "model.json": lambda folder: save_model(
        vehicle_model(load_vehicle("crazyflie21")), folder / "model.json"
    ),
    "plan1.json": lambda folder: PLANNED.write(folder / "plan1.json"),
    "commands.sh": gone_on_with,
}


@pytest.mark.parametrize("target", [None, "/dev/zero", "/dev/full", "/dev/stdin"])
def test_a_journal_that_is_no_file_is_refused_in_one_line(tmp_path, target):
    if target is None:
        os.mkfifo(tmp_path / JOURNAL)
    else:
        (tmp_path / JOURNAL).symlink_to(target)
    line = require_failure(in_process("learn", "-o", tmp_path))
    assert "cannot be read" in line
    assert "learn in another folder" in line


@pytest.mark.parametrize("text", ["[" * 100_000, '{"task": ' * 5000, "nonsense", "{}"])
def test_a_journal_that_is_none_is_refused_in_one_line(tmp_path, text):
    (tmp_path / JOURNAL).write_text(text)
    with pytest.raises(BadInputError, match="cannot be read"):
        journal_in(tmp_path)


@pytest.mark.parametrize("name", WRITERS)
def test_a_link_is_replaced_and_what_it_names_stays_as_it_was(tmp_path, name):
    victim, folder = tmp_path / "victim", tmp_path / "learnt"
    victim.write_text("precious")
    folder.mkdir()
    for linked in (name, f".{name}", f"{name}.new"):
        (folder / linked).symlink_to(victim)
    WRITERS[name](folder)
    assert victim.read_text() == "precious"
    assert not (folder / name).is_symlink()
    assert (folder / name).stat().st_size != len("precious")


def test_a_pipe_of_the_name_is_replaced_at_once(tmp_path):
    os.mkfifo(tmp_path / JOURNAL)
    Journal(task=TASK).save(tmp_path)
    assert journal_in(tmp_path).task == TASK


def test_a_log_that_is_a_link_or_a_pipe_is_refused(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for name, make in (("link", lambda path: path.symlink_to(victim)), ("pipe", os.mkfifo)):
        folder = tmp_path / name
        folder.mkdir()
        make(folder / LOG)
        with pytest.raises(BadInputError, match="cannot be written"):
            gone_on_with(folder)
    assert victim.read_text() == "precious"


def test_a_script_that_came_with_the_folder_is_written_anew(tmp_path):
    (tmp_path / SCRIPT).write_text("rm -rf ~\n")
    with Shell(tmp_path, {"craft.toml": ""}, lambda line: None, "learn", goes_on=True) as shell:
        shell.keep("groundstation", "fit", "body")
    text = (tmp_path / SCRIPT).read_text()
    assert "rm -rf" not in text
    assert text.splitlines()[-1] == "groundstation fit body"


@pytest.mark.parametrize("content", ["[" * 100_000, "{}", "null"])
@pytest.mark.parametrize("read", [read_found, lambda path: Planned.read(path, LIMITS)])
def test_a_plan_or_findings_that_are_none_are_refused_in_words(tmp_path, read, content):
    path = tmp_path / "found1.json"
    path.write_text(content)
    with pytest.raises(BadInputError, match="remove it"):
        read(path)


def test_a_file_is_written_whole_or_stays_as_it_was(tmp_path):
    path = tmp_path / "note.json"
    write_whole(path, json.dumps({"first": 1}), durable=True)

    def write_on_a_full_disk():
        with written_whole(path) as file:
            file.write(b"half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match="No space"):
        write_on_a_full_disk()
    assert json.loads(path.read_text()) == {"first": 1}
    assert os.listdir(tmp_path) == ["note.json"]
