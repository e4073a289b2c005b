"""Commands in a folder: shown, logged, kept for repeating, and never left behind."""

import os
import signal
import subprocess
from subprocess import Popen

import pytest

from groundstation.errors import BadInputError, GroundStationError
from groundstation.shell import LOG, SCRIPT, Shell
from support.programs import run_program


def python(text):
    return ("python", "-c", text)


@pytest.fixture
def said():
    return []


@pytest.fixture
def shell(tmp_path, said):
    with Shell(tmp_path / "story", {"input.txt": "here"}, said.append) as opened:
        yield opened


def test_a_command_runs_in_the_folder_and_is_shown_logged_and_kept(shell, said):
    shell.run(*python("print(open('input.txt').read())"))
    shell.run(*python("print('kept')"), into="out.txt")
    assert said[0] == "$ python -c 'print(open('\"'\"'input.txt'\"'\"').read())'"
    assert "here" in (shell.folder / LOG).read_text()
    assert (shell.folder / "out.txt").read_text() == "kept\n"
    script = (shell.folder / SCRIPT).read_text()
    assert script.rstrip().endswith("> out.txt")
    run_program(["sh", "-n", shell.folder / SCRIPT], check=True)


def test_what_was_run_can_be_run_again_elsewhere(shell):
    shell.run(*python("print(open('input.txt').read() + ' again')"), into="out.txt")
    again = shell.folder.parent / "again"
    run_program(["sh", shell.folder / SCRIPT, again], check=True)
    assert (again / "out.txt").read_text() == "here again\n"


def test_a_failure_says_what_the_command_said_and_leaves_no_half_file(shell):
    with pytest.raises(GroundStationError, match=r"failed \(1\): no such thing; .*log\.txt"):
        shell.run(*python("print('half'); raise SystemExit('no such thing')"), into="half.json")
    assert not (shell.folder / "half.json").exists()
    assert (shell.folder / SCRIPT).read_text().rstrip().splitlines()[-1].startswith("# failed: ")


def test_names_with_a_star_are_those_of_the_folder(shell):
    shell.run(*python("open('b1', 'w'); open('b2', 'w')"))
    shell.run(*python("import sys; print(sys.argv[1:])"), "b*", into="out.txt")
    assert (shell.folder / "out.txt").read_text() == "['b1', 'b2']\n"
    with pytest.raises(GroundStationError, match="no such file"):
        shell.run(*python("pass"), "d*")


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(BadInputError, match="not an empty folder"):
        Shell(tmp_path, {})
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_settings_of_the_user_s_daemon_do_not_reach_its_commands(tmp_path, monkeypatch):
    monkeypatch.setenv("GROUNDSTATION_LINK_NAME", "usb")
    with Shell(tmp_path / "story", {}, lambda line: None) as shell:
        shell.run(*python("import os; print(os.environ.get('GROUNDSTATION_LINK_NAME'))"), into="o")
        assert (shell.folder / "o").read_text() == "None\n"


def test_a_folder_that_was_begun_is_gone_on_with_where_that_is_asked_for(tmp_path):
    with Shell(tmp_path / "story", {"input.txt": "here"}, lambda line: None) as shell:
        shell.run(*python("print('one')"), into="one.txt")
    with Shell(tmp_path / "story", {"input.txt": "else"}, lambda line: None, goes_on=True) as shell:
        shell.keep(*python("print('one')"))
        shell.run(*python("print(open('input.txt').read())"), into="two.txt")
    assert (tmp_path / "story" / "two.txt").read_text() == "here\n"
    script = (tmp_path / "story" / SCRIPT).read_text()
    assert script.count("#!/bin/sh") == 1
    assert script.index("print('\"'\"'one") < script.index("two.txt")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_a_command_starts_leaves_nothing_running(shell, monkeypatch, number):
    def interrupted(number, frame):
        raise KeyboardInterrupt

    class StruckAtBirth(Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            born.append(self.pid)
            signal.raise_signal(number)

    born = []
    before = signal.signal(number, interrupted)
    monkeypatch.setattr(subprocess, "Popen", StruckAtBirth)
    try:
        with pytest.raises(KeyboardInterrupt):
            shell.run(*python("import time; time.sleep(100)"))
        assert signal.getsignal(number) is interrupted
    finally:
        signal.signal(number, before)
    for pid in born:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert len(born) == 1
