"""How soon the web viewer shows what is new, in headless Chromium drawn without a GPU.

Opened on a daemon that has flown before, and stopped for a while. The machine's load decides much
here.
"""

from __future__ import annotations

import signal
import statistics
import time
from collections.abc import Iterator
from typing import Any

import psutil

from bench.daemon import at_line_rate
from bench.page_view import in_chromium
from bench.table import Row
from groundstation.service.client import ask
from groundstation.viewer.child import free_port

FLOWN_S, FRESH_S, PATIENCE_S, WATCHED_S = 40.0, 5.0, 240.0, 20.0
PAUSES_S = 8.0, 25.0
LOOK_S = 0.3
_AGE = "window._handle ? window.age_s() : null"


def rows() -> Iterator[Row]:
    """What is new is a sample that is less than 5 s old."""
    keys = ("viewer.port", "viewer.web_port")
    ports = [word for key in keys for word in ("--set", f"{key}={free_port('127.0.0.1')}")]
    with at_line_rate("--viewer", "serve", "--no-page", *ports) as path:
        time.sleep(FLOWN_S)
        url = str(ask(path, "GET", "/status")["viewer"]["urls"][0])
        known = {one.pid for one in psutil.Process().children(recursive=True)}
        with in_chromium() as page:
            began_s = time.monotonic()
            page.goto(url, timeout=1e3 * PATIENCE_S)
            _until_younger(page, float("inf"))
            yield Row("viewer opened: a sample after", time.monotonic() - began_s, None, "s")
            yield Row("viewer opened: a new one after", _until_younger(page, FRESH_S), None, "s")
            for pause_s in PAUSES_S:
                yield Row("viewer watched: median age", _watched_s(page), None, "s", most=FRESH_S)
                _stop(known, pause_s)
                waited_s = _until_younger(page, FRESH_S)
                yield Row(f"viewer stopped {pause_s:g} s: a new one after", waited_s, None, "s")


def _stop(known: set[int], pause_s: float) -> None:
    """Hold up the browser's processes."""
    programs = [
        one
        for one in psutil.Process().children(recursive=True)
        if one.pid not in known and "chrom" in one.name()
    ]
    for one in programs:
        one.send_signal(signal.SIGSTOP)
    time.sleep(pause_s)
    for one in programs:
        one.send_signal(signal.SIGCONT)
    time.sleep(LOOK_S)


def _until_younger(page: Any, limit_s: float) -> float:
    """Seconds until the newest sample is known and younger than that."""
    began_s = time.monotonic()
    while time.monotonic() < began_s + PATIENCE_S:
        age_s = _age_s(page)
        if age_s is not None and age_s < limit_s:
            return time.monotonic() - began_s
        time.sleep(LOOK_S)
    return float("nan")


def _watched_s(page: Any) -> float:
    """How old the newest sample is where nothing is to be caught up with."""
    ages, end_s = [], time.monotonic() + WATCHED_S
    while time.monotonic() < end_s:
        if (age_s := _age_s(page)) is not None:
            ages.append(age_s)
        time.sleep(LOOK_S)
    return statistics.median(ages)


def _age_s(page: Any) -> float | None:
    from playwright.sync_api import Error

    try:
        age_s = page.evaluate(_AGE)
    except Error:  # it loads itself anew
        return None
    return None if age_s is None else float(age_s)
