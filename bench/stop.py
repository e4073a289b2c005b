"""How long a Stop that is pressed on the page takes until zero thrust is handed to the radio.

A daemon that flies the software craft, with a page, and what keeps the page busy beside it. The end
is the time of the event that the daemon notes behind its setpoint; the largest of ``PRESSES``.
"""

from __future__ import annotations

import contextlib
import http.client
import multiprocessing
import os
import re
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from urllib.parse import urlsplit

from bench.daemon import busy, page_address, run_daemon, until_status
from bench.table import Row
from groundstation.errors import GroundStationError
from groundstation.service.client import ask

PRESSES, EVERY_S, SETTLE_S = 40, 0.1, 2.0
MOST_S = 0.3
PAGE_PORT, COMMAND_PORT = 19081, 19851
DAEMON = (
    *("--link", "stand-in", "--command", f"udp://127.0.0.1:{COMMAND_PORT}"),
    *("--viewer", "off", "--page", "--set", f"page.port={PAGE_PORT}"),
)
FLOOD, SILENT = 6, 230
PATIENCE_S = 60.0


def rows() -> Iterator[Row]:
    with (
        tempfile.TemporaryDirectory(prefix="bench-") as name,
        run_daemon(Path(name), *DAEMON) as control,
    ):
        until_status(control, lambda status: status["command"]["state"] == "connected")
        browser = _Browser(control)
        loads: list[tuple[str, list[Callable[[int], None]], bool]] = [
            ("idle", [], False),
            ("six device scans", [lambda number: browser.get("/devices")], False),
            (
                "a flood of wrong tokens",
                [lambda number: browser.get("/?token=x", bare=True)],
                False,
            ),
            (f"{SILENT} silent connections", [], True),
        ]
        every = [load for _, load_of, _ in loads for load in load_of]
        loads.append(("all of them, and both cores busy", every, True))
        for what, work, silent in loads:
            spinning = (os.cpu_count() or 0) if len(work) > 1 else 0
            with busy(spinning), _under(work, silent):
                time.sleep(SETTLE_S)
                # a browser is a process of its own: it does not wait for what loads the page
                with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pressing:
                    took_s = pressing.submit(_presses, control, browser).result()
            yield Row(f"Stop, {what}: largest of {PRESSES}", took_s[-1], None, "s", most=MOST_S)
            yield Row(f"Stop, {what}: median", took_s[PRESSES // 2], None, "s")


class _Browser:
    """One that was let in."""

    def __init__(self, control: Path) -> None:
        parts = urlsplit(page_address(control))
        answer = self._ask("GET", f"{parts.path}?{parts.query}", {})
        self._cookie = {"Cookie": str(answer.headers["set-cookie"]).split(";")[0]}
        document = self._ask("GET", "/", self._cookie).read().decode()
        found = re.search(r'name="change-token" content="([^"]+)"', document)
        assert found is not None
        origin = f"http://127.0.0.1:{PAGE_PORT}"
        self._change = {**self._cookie, "Origin": origin, "X-Change-Token": found[1]}

    def get(self, path: str, *, bare: bool = False) -> None:
        with contextlib.suppress(OSError, http.client.HTTPException):
            self._ask("GET", path, {} if bare else self._cookie).read()

    def stop(self) -> None:
        self._ask("POST", "/do/command/stop", self._change).read()

    def _ask(self, method: str, path: str, headers: dict[str, str]) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", PAGE_PORT, timeout=PATIENCE_S)
        connection.request(method, path, headers=headers)
        return connection.getresponse()


def _presses(control: Path, browser: _Browser) -> list[float]:
    return sorted(_press(control, browser) for _ in range(PRESSES))


def _press(control: Path, browser: _Browser) -> float:
    pressed_ns = time.time_ns()
    browser.stop()
    stops = [one for one in _events(control) if one["kind"] == "stop"]
    time.sleep(EVERY_S)
    if not stops or stops[-1]["time_ns"] < pressed_ns:
        return PATIENCE_S  # it never came
    return float(stops[-1]["time_ns"] - pressed_ns) * 1e-9


def _events(control: Path) -> list[dict]:
    """Once the daemon answers: under a flood of requests it may refuse."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return list(ask(control, "GET", "/events"))
        except GroundStationError:
            if time.monotonic() > end_s:
                raise
        time.sleep(EVERY_S)


@contextlib.contextmanager
def _under(work: list[Callable[[int], None]], silent: bool) -> Iterator[None]:
    ended = threading.Event()

    def keep(load: Callable[[int], None], number: int) -> None:
        while not ended.is_set():
            load(number)

    threads = [
        threading.Thread(target=keep, args=(load, number), daemon=True)
        for load in work
        for number in range(FLOOD)
    ]
    sitting: list[socket.socket] = []
    if silent:
        threads.append(threading.Thread(target=_sit, args=(sitting, ended), daemon=True))
    for one in threads:
        one.start()
    try:
        yield
    finally:
        ended.set()
        for one in threads:
            one.join(PATIENCE_S)
        for connection in sitting:
            connection.close()


def _sit(sitting: list[socket.socket], ended: threading.Event) -> None:
    """Connections that say nothing, each begun anew when it is cut off."""
    while not ended.wait(0.01):
        if len(sitting) >= SILENT:
            sitting.pop(0).close()
        with contextlib.suppress(OSError):
            sitting.append(socket.create_connection(("127.0.0.1", PAGE_PORT), 5.0))
