"""A real browser, and daemons with a page."""

import os
import re
import shutil

import pytest

from support.daemons import Daemon
from support.programs import free_port
from support.waiting import WHOLE_TEST_S, in_real_time, until

CHROMIUM = shutil.which("chromium")
PATIENCE_MS = 120_000


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    """Browser and daemon run in real time: what fails where the machine gave none is run again."""
    with in_real_time(last_s=WHOLE_TEST_S):
        return (yield)


@pytest.fixture(scope="module")  # its event loop runs in this thread until it is ended
def chromium():
    """Headless Chromium; each test opens contexts of its own, as different people do."""
    library = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("Debian's chromium is not installed")
    with library.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM,
            args=["--no-sandbox"] if os.getuid() == 0 else [],
            timeout=PATIENCE_MS,
        )
        yield browser
        browser.close()


@pytest.fixture
def visit(chromium):
    """visit(url, ...): a page in a browser of its own; what it asked of other hosts, and what its
    scripts said was wrong, fails the test."""
    contexts, wrong = [], []

    def open_page(url, **options):
        context = chromium.new_context(**options)
        contexts.append(context)
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(f"script: {error}"))
        page.on("request", lambda request: foreign(request.url))
        page.goto(url)
        return page

    def foreign(url):
        if not re.match(r"(http://127\.0\.0\.1:\d+/|data:)", url):
            wrong.append(f"asked outside: {url}")

    yield open_page
    for context in contexts:
        context.close()
    assert not wrong


class PageDaemon(Daemon):
    """A daemon with a page."""

    def __init__(self, folder, *arguments, port=None, **options):
        self.port = port or free_port()
        super().__init__(folder, "--page", "--set", f"page.port={self.port}", *arguments, **options)

    def address(self):
        """A new one-time address."""
        self.status_when(lambda status: status["page"]["state"] == "serving", "the page")
        return self.ask("POST", "/page/address")["url"]

    def page_process(self):
        """The process that serves the page."""

        def find():
            return [one for one in self.children() if "groundstation.page" in one.cmdline()]

        return until(find, "the page's process")[0]


@pytest.fixture
def page_daemon(tmp_path):
    """page_daemon(*arguments): a daemon with a page, ended with the test."""
    running = []

    def start(*arguments, folder=tmp_path, **options):
        running.append(PageDaemon(folder, *arguments, **options))
        return running[-1]

    yield start
    for daemon in running:
        daemon.process.end()


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    """A daemon with a page whose stand-in flies."""
    with PageDaemon(tmp_path_factory.mktemp("flying")) as daemon:
        daemon.recording()
        yield daemon
        assert daemon.stop() == 0, daemon.stderr
