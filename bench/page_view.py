"""What the operator's page costs a browser without a GPU, and how soon the craft moves on it.

A daemon whose stand-in flies, and headless Chromium, opened while the simulator is still being
prepared, as ``make run`` opens it. Frames are counted at the canvas, not by the page's own count.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil

from bench.daemon import page_address, run_daemon
from bench.table import Row
from groundstation.service.client import ask
from groundstation.viewer.child import free_port

WIDTH, HEIGHT = 1280, 720
PATIENCE_S = 180.0
SETTLE_S, WINDOW_S, WINDOWS = 10.0, 10.0, 4
PROCESSES = {"page": 0.05, "renderer": None, "gpu-process": None, "browser": None}
"""The page's own and Chromium's by type -> the most that it may take, of a core."""
_COUNT = """
window.frames_seen = 0;
window.moved_ms = null;
const pen = CanvasRenderingContext2D.prototype;
const clear = pen.clearRect, lines = pen.lineTo, text = pen.fillText;
let shape = "", before = "", craft = false;
pen.clearRect = function (...where) {
    if (this.canvas.id === "craft-view") {
        window.frames_seen += 1;
        if (window.moved_ms === null) {
            if (craft && before && shape !== before) {
                window.moved_ms = performance.timeOrigin + performance.now();
                pen.lineTo = lines;
                pen.fillText = text;
            }
            before = craft ? shape : "";
            shape = "";
            craft = false;
        }
    }
    return clear.apply(this, where);
};
pen.lineTo = function (x, y) {
    if (this.canvas.id === "craft-view") shape += `${x},${y};`;
    return lines.call(this, x, y);
};
pen.fillText = function (what, ...where) {
    if (this.canvas.id === "craft-view" && /^M1 /.test(what)) craft = true;
    return text.call(this, what, ...where);
};
"""


@contextlib.contextmanager
def in_chromium() -> Iterator[Any]:
    """A page of headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox"] if os.getuid() == 0 else [],
        )
        yield browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        browser.close()


def rows() -> Iterator[Row]:
    """Medians over the windows."""
    port = f"page.port={free_port('127.0.0.1')}"
    with (
        in_chromium() as page,
        tempfile.TemporaryDirectory(prefix="bench-") as name,
        run_daemon(Path(name), "--page", "--set", port) as control,
    ):
        page.add_init_script(_COUNT)
        page.goto(page_address(control))
        waited_s = _until_moving(page) - _received_s(control)
        yield Row("'receiving' to the first moving craft", waited_s, None, "s", most=3.0)
        page.goto(page.url)
        opened_s = page.evaluate("performance.timeOrigin") / 1e3
        waited_s = _until_moving(page) - opened_s
        yield Row("the page opened to the first moving craft", waited_s, None, "s", most=3.0)
        yield from _costs(page)


def _costs(page: Any) -> Iterator[Row]:
    """Frames a second and shares of a core while a craft flies."""
    time.sleep(SETTLE_S)
    frames, shares = [], []
    for _ in range(WINDOWS):
        before, drawn, began_s = _used_s(), page.evaluate("window.frames_seen"), time.monotonic()
        page.wait_for_timeout(1e3 * WINDOW_S)
        after, lasted_s = _used_s(), time.monotonic() - began_s
        frames.append((page.evaluate("window.frames_seen") - drawn) / lasted_s)
        shares.append({name: (after[name] - before[name]) / lasted_s for name in before})
    yield Row("frames of the craft", statistics.median(frames), None, "1/s", least=29.0)
    for name, most in PROCESSES.items():
        what = "the page's process" if name == "page" else f"Chromium's {name}"
        share = statistics.median([one[name] for one in shares])
        yield Row(f"{what}: processor", share, None, "core", most=most)


def _until_moving(page: Any) -> float:
    """Unix time of the first frame in which a craft stands otherwise than in the one before."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        moved_ms = page.evaluate("window.moved_ms")
        if moved_ms is not None:
            return float(moved_ms) / 1e3
        page.wait_for_timeout(50)
    raise TimeoutError(f"no craft moves on the page within {PATIENCE_S:g} s")


def _received_s(control: Path) -> float:
    """Unix time of the daemon's first word that it receives."""
    events = ask(control, "GET", "/events")
    return min(one["time_ns"] for one in events if one["text"].startswith("receiving")) * 1e-9


def _used_s() -> dict[str, float]:
    """Processor seconds so far, of the page's process and of Chromium's by their type."""
    used = dict.fromkeys(PROCESSES, 0.0)
    for one in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            words, times = one.cmdline(), one.cpu_times()
            if words[1:3] == ["-m", "groundstation.page"]:
                kind = "page"
            elif "chrom" not in one.name():
                continue
            else:
                kind = next((w[7:] for w in words if w.startswith("--type=")), "browser")
            if kind in used:
                used[kind] += times.user + times.system
    return used
