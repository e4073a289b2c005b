"""The daemon in a terminal: a line that keeps the operator informed, and a real Ctrl-C."""

import pytest

from groundstation.recording.formats import open_recording
from support import RECORDINGS
from support.commands import Terminal
from support.daemons import gaps
from support.programs import on_free_ports
from support.waiting import until


@pytest.mark.parametrize("viewer", ["off", "serve"])
def test_ctrl_c_in_a_terminal_finishes_the_recording(tmp_path, viewer):
    ports = on_free_ports("viewer.port", "viewer.web_port")
    with Terminal(tmp_path, "run", "--viewer", viewer, *ports) as terminal:
        terminal.until("Ctrl-C stops and finishes the recording")
        terminal.until("streaming")
        terminal.until("samples/s  0.00 % lost")
        if viewer == "serve":
            terminal.until("serving at http://127.0.0.1:")
        terminal.type(b"\x03")
        assert terminal.ends() == 0, terminal.shown
    assert "Traceback" not in terminal.shown
    assert "fault" not in terminal.shown
    (path,) = (tmp_path / "sessions").glob("*.mcap")
    recording = open_recording(path)
    assert (recording.damage, gaps(recording)) == ([], 0)


def test_a_silent_wait_shows_a_word_and_a_bar_which_are_gone_when_the_answer_comes(tmp_path):
    """A first ``inspect`` compiles: as the terminal shows it, and what is left on the screen."""
    cold = {"NUMBA_CACHE_DIR": str(tmp_path / "nothing_compiled_yet")}
    flight = RECORDINGS / "stand_in_flight.mcap"
    with Terminal(tmp_path, "inspect", flight, environment=cold) as terminal:
        terminal.until("compiling, once per machine")
        assert terminal.ends(270) == 0
    bars, _, answer = terminal.shown.rpartition("\r\x1b[K")
    assert "[===" in bars or " ===" in bars
    assert f"reading {flight}" in bars
    assert answer.lstrip().startswith("\x1b[1mfile") or answer.startswith("file")
    assert "working" not in answer


@pytest.mark.parametrize("ci", ["", "true"])
def test_the_page_is_opened_where_somebody_sees_it_and_never_in_ci(tmp_path, ci):
    opened, browser = tmp_path / "opened", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" >> {opened}\n')
    browser.chmod(0o755)
    seen = {"BROWSER": f"{browser} %s", "DISPLAY": ":9", "CI": ci}
    options = ("run", "--page", *on_free_ports("page.port"))
    with Terminal(tmp_path, *options, environment=seen) as terminal:
        if ci:
            terminal.until("receiving")
            assert terminal.shows("/?token=")
        else:
            until(opened.exists, "the browser")
            address = opened.read_text().strip()
            port = options[-1].partition("=")[2]
            assert address.startswith(f"http://127.0.0.1:{port}/?token=")
            assert not terminal.shows(address)  # the one that is printed lets another browser in
        terminal.type(b"\x03")
        assert terminal.ends() == 0
    assert opened.exists() == (not ci)
