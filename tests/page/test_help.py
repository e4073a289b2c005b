"""The documentation is built without a warning, and read offline under Help."""

import asyncio
import sys
import threading
from contextlib import contextmanager

import pytest
import uvicorn
from starlette.applications import Starlette

from groundstation.page.app import help_route
from support import ROOT
from support.programs import free_port, run_program
from support.waiting import until


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """As ``make docs`` builds it: a broken link, an unknown anchor or a page outside the navigation
    is a warning, and a warning ends the build."""
    folder = tmp_path_factory.mktemp("site")
    run_program(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", folder], cwd=ROOT, check=True
    )
    return folder


@contextmanager
def serving(site):
    """The address under which Help is."""
    port = free_port()
    settings = uvicorn.Config(Starlette(routes=[help_route(site)]), port=port, log_level="error")
    server = uvicorn.Server(settings)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve()))
    thread.start()
    try:
        until(lambda: server.started, "the server")
        yield f"http://127.0.0.1:{port}/help/"
    finally:
        server.should_exit = True
        thread.join()


def test_the_site_is_read_and_searched_and_asks_no_other_host(site, visit):
    with serving(site) as address:
        page = visit(address)
        page.get_by_role("link", name="Effects").first.click()
        page.wait_for_url("**/reference/effects.html")
        page.locator("h2#rotor_drag").wait_for()
        search, found = page.get_by_role("textbox", name="Search"), ".md-search-result__link"

        search.press_sequentially("recover")  # it listens to keys, not to a changed value
        page.locator(found).first.wait_for(timeout=200_000)


def test_every_reference_page_has_what_the_code_has(site):
    reference = {path.stem: path.read_text() for path in (site / "reference").glob("*.html")}
    assert "groundstation discrepancy" in reference["commands"]
    assert "recording.keep_mb" in reference["configuration"]
    assert "drag_n_s_m" in reference["effects"]
    assert "POST /command/acquire" in reference["control_api"]
    assert "nanobench" in reference["formats"]
    assert "A recording in memory" in reference["python"] or "samples" in reference["python"]


def test_where_nothing_was_built_help_says_how_and_shows_the_sources(tmp_path, visit):
    with serving(tmp_path) as address:
        page = visit(address)
        assert "make docs" in page.inner_text("body")
        page.get_by_role("link", name="telemetry", exact=True).click()
        assert "# Packets, duplicates, device time" in page.inner_text("body")
