"""What is shown of a command that says nothing: when, what, and that nothing of it stays."""

import io
import json

import pytest

from groundstation import compiling
from groundstation.cli import terminal as progress
from groundstation.cli.terminal import line, own_terminal, show, shown, spoken, tell_found, watched
from support.waiting import until


class Screen(io.StringIO):
    """A terminal that remembers."""

    def isatty(self):
        return True


@pytest.fixture
def on_screen(monkeypatch):
    """Called in the test: between fixture and test pytest puts its own stream in place."""

    def begin():
        made = Screen()
        monkeypatch.setattr("sys.stderr", made)
        monkeypatch.setattr(progress, "SILENT_S", 0.05)
        return made

    return begin


def drawn(screen, text):
    until(lambda: text in screen.getvalue(), text)


def test_a_command_that_is_silent_says_what_it_does_and_how_far_it_is(on_screen):
    screen = on_screen()
    with watched():
        drawn(screen, "working")
        with shown("reading") as show_share:
            drawn(screen, "reading")
            show_share(0.5, "fitting the body")
            drawn(screen, f"[{'=' * 12}{' ' * 12}] fitting the body")
            show_share(-1.0, "weighing rotor_drag")  # no further than before
            drawn(screen, f"[{'=' * 12}{' ' * 12}] weighing rotor_drag")
    assert screen.getvalue().endswith(progress.CLEAR)


def test_what_is_printed_stands_on_a_clean_line(on_screen):
    screen = on_screen()
    with watched():
        drawn(screen, "working")
        show("the answer", error=True)
    assert f"{progress.CLEAR}the answer\n" in screen.getvalue()


def test_a_command_that_draws_by_itself_is_left_alone(on_screen):
    screen = on_screen()
    with watched():
        own_terminal()
        spoken()
    assert screen.getvalue() == ""


def test_where_nobody_looks_nothing_is_drawn(capsys):
    with watched(), shown("reading") as show_share:
        show_share(0.5, "fitting")
    assert capsys.readouterr().err == ""


def test_compiling_is_told_only_while_something_is_compiled():
    assert "compiling" not in line(0, 0.5, "reading", 2.0)
    compiling.begin("a kernel")
    try:
        assert "reading; first time here: compiling, once per machine, 2 s" in line(
            0, 0.5, "reading", 2.0
        )
    finally:
        compiling.end("a kernel")
    assert "compiling" not in line(0, 0.5, "reading", 2.0)


def test_what_was_found_is_told_to_the_program_that_waits(tmp_path, monkeypatch):
    told = tmp_path / "progress.json"
    monkeypatch.setenv("GROUNDSTATION_PROGRESS", str(told))
    with shown("reading") as show_share:
        show_share(0.5, "fitting")
        assert json.loads(told.read_text()) == {"share": 0.5, "stage": "fitting"}
        tell_found("c0 1 +- 0.1")
    assert json.loads(told.read_text()) == {"found": "c0 1 +- 0.1"}
