"""``python -m bench.live_view [--openings N]``: how soon the web viewer shows what is new.

In headless Chromium, drawn without a GPU: opened on a daemon that has flown before, and stopped for
a while. Each line says how old the newest row was when it was first asked for, after how many
seconds it was less than 5 s old, and the machine's load, which decides much here.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import time
from typing import Any

import psutil

from bench.daemon import at_line_rate
from groundstation.service.client import ask
from groundstation.viewer.viewer import free_port

FLOWN_S, FRESH_S, PATIENCE_S, WATCHED_S = 40.0, 5.0, 240.0, 20.0
PAUSES_S = 8.0, 25.0
LOOK_S = 0.3
HERE = "127.0.0.1"
_AGE = "window._handle ? window.age_s() : null"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.live_view")
    parser.add_argument("--openings", type=int, default=3)
    openings = parser.parse_args().openings
    keys = ("viewer.port", "viewer.web_port")
    ports = [word for key in keys for word in ("--set", f"{key}={free_port(HERE)}")]
    with at_line_rate("--viewer", "serve", "--no-page", *ports) as path:
        time.sleep(FLOWN_S)
        for _ in range(openings):
            _open(str(ask(path, "GET", "/status")["viewer"]["urls"][0]))


def _open(url: str) -> None:
    from playwright.sync_api import sync_playwright

    known = {one.pid for one in psutil.Process().children(recursive=True)}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox"] if os.getuid() == 0 else [],
        )
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        began_s = time.monotonic()
        page.goto(url, timeout=1e3 * PATIENCE_S)
        age_s = _until_younger(page, float("inf"))
        _say(f"opened: a row after {time.monotonic() - began_s:.1f} s", page, age_s)
        for pause_s in PAUSES_S:
            _watch(page)
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
            _say(f"stopped for {pause_s:g} s", page, _until_younger(page, float("inf")))
        browser.close()


def _say(what: str, page: Any, age_s: float) -> None:
    began_s = time.monotonic()
    left_s = _until_younger(page, FRESH_S)
    lasted_s = time.monotonic() - began_s
    load = os.getloadavg()[0]
    print(
        f"{what}, {age_s:.1f} s old; {left_s:.1f} s old {lasted_s:.1f} s later; load {load:.1f}",
        flush=True,
    )


def _until_younger(page: Any, limit_s: float) -> float:
    """The age of the newest row, once it is known and less than that."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        age_s = _age_s(page)
        if age_s is not None and age_s < limit_s:
            return age_s
        time.sleep(LOOK_S)
    return float("nan")


def _watch(page: Any) -> None:
    """How old the newest row is where nothing is to be caught up with."""
    ages, deadline = [], time.monotonic() + WATCHED_S
    while time.monotonic() < deadline:
        if (age_s := _age_s(page)) is not None:
            ages.append(age_s)
        time.sleep(LOOK_S)
    middle = sorted(ages)[len(ages) // 2]
    print(f"  then {middle:.1f} s old in the middle, {max(ages):.1f} s at most", flush=True)


def _age_s(page: Any) -> float | None:
    from playwright.sync_api import Error

    try:
        age_s = page.evaluate(_AGE)
    except Error:  # it loads itself anew
        return None
    return None if age_s is None else float(age_s)


if __name__ == "__main__":
    main()
