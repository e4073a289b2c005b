"""The web viewer in a real browser, drawn without a GPU: it says how old its newest row is."""

import re

import pytest

from support.programs import on_free_ports
from support.waiting import until


@pytest.mark.timeout(600)
def test_the_web_viewer_says_how_old_its_newest_row_is(page_daemon, visit):
    ports = on_free_ports("viewer.port", "viewer.web_port")
    daemon = page_daemon("--viewer", "serve", *ports)
    daemon.recording()
    status = daemon.status_when(lambda one: one["viewer"]["sent"] > 0, "the viewer")
    page = visit(status["viewer"]["urls"][0])  # which fails if it asks another host
    said = page.locator("#live")
    until(lambda: re.fullmatch(r"live|\d+ s behind", said.text_content()), "an age", 300)
    assert page.evaluate("window.age_s()") >= 0.0
    until(lambda: daemon.status()["viewer"]["behind_s"] > 0.0, "the daemon hears of it", 120)
    daemon.process.send_signal(19)  # SIGSTOP: no row comes any more
    until(lambda: re.fullmatch(r"\d+ s behind", said.text_content()), "it is told as old", 120)
    daemon.process.send_signal(18)  # SIGCONT
