"""What the operator's page costs the daemon, and itself.

Two daemons at line rate side by side, of which one has a page that one browser, then twenty ask ten
times a second; what each has used in the same ten seconds is compared, so that whatever else the
machine does meets both.
"""

from __future__ import annotations

import http.client
import json
import statistics
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import psutil

from bench.daemon import at_line_rate, page_address
from bench.table import Row
from groundstation.service.client import ask

SETTLE_S, WINDOW_S, WINDOWS = 12.0, 10.0, 6
BROWSERS = 1, 20
ASK_S = 0.1
PORT = 19080


def rows() -> Iterator[Row]:
    """Medians over the windows; the spread is half of what the middle half of them span."""
    page = "--page", "--set", f"page.port={PORT}"
    with (
        at_line_rate("--viewer", "off", "--no-page") as bare,
        at_line_rate("--viewer", "off", *page) as shown,
    ):
        page_address(shown)
        process = _page_process()
        for count in BROWSERS:
            yield from _asked_by(count, bare, shown, process)
        lost = [ask(path, "GET", "/status")["recording"]["dropped"] for path in (bare, shown)]
    yield Row("both recorders: dropped", float(sum(lost)), None, "items", most=0.0)


def _asked_by(count: int, bare: Path, shown: Path, process: psutil.Process) -> Iterator[Row]:
    ended = threading.Event()
    browsers = [
        threading.Thread(target=_browse, args=(page_address(shown), ended), daemon=True)
        for _ in range(count)
    ]
    for one in browsers:
        one.start()
    time.sleep(SETTLE_S)
    shares = [_window(bare, shown, process) for _ in range(WINDOWS)]
    memory_mb = process.memory_info().rss / 1e6
    ended.set()
    for one in browsers:
        one.join()
    without, with_page, itself = (list(column) for column in zip(*shares, strict=True))
    more = [b - a for a, b in zip(without, with_page, strict=True)]
    what = f"browsers at 10 Hz: {count}; the daemon (one without a page)"
    most = 0.05 if count == 1 else None
    yield Row(what, statistics.median(with_page), statistics.median(without), "core")
    yield Row(f"{what}: more, window by window", statistics.median(more), None, "core", most=0.01)
    yield Row("the same: its spread", _spread(more), None, "core")
    yield Row("the page's process: processor", statistics.median(itself), None, "core", most=most)
    yield Row("the page's process: resident memory", memory_mb, None, "MB", most=120.0)


def _window(bare: Path, shown: Path, page: psutil.Process) -> tuple[float, float, float]:
    """Shares of a core: the daemon without a page, the one with it, the page."""
    before, began_s = _used_s(bare, shown, page), time.monotonic()
    time.sleep(WINDOW_S)
    after, lasted_s = _used_s(bare, shown, page), time.monotonic() - began_s
    one, other, itself = ((b - a) / lasted_s for a, b in zip(before, after, strict=True))
    return one, other, itself


def _used_s(bare: Path, shown: Path, page: psutil.Process) -> tuple[float, float, float]:
    one, other = (ask(path, "GET", "/status")["health"]["cpu_s"] for path in (bare, shown))
    times = page.cpu_times()
    return one, other, times.user + times.system


def _spread(values: list[float]) -> float:
    low, _, high = statistics.quantiles(values, n=4)
    return 0.5 * (high - low)


def _page_process() -> psutil.Process:
    (found,) = (
        one
        for one in psutil.Process().children(recursive=True)
        if one.cmdline()[1:3] == ["-m", "groundstation.page"]
    )
    return found


def _browse(address: str, ended: threading.Event) -> None:
    """What the page's script asks for."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", PORT)
    connection.request("GET", f"{parts.path}?{parts.query}")
    answer = connection.getresponse()
    answer.read()
    cookie = str(answer.headers["set-cookie"]).split(";")[0]
    number = status = 0
    while not ended.wait(ASK_S):
        connection.request(
            "GET", f"/now?after={number}&status={status}", headers={"Cookie": cookie}
        )
        found = json.loads(connection.getresponse().read())
        number, status = found["number"], found["status_number"]
