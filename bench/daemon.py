"""What the daemon costs at line rate, with everything on: a minute.

The software craft in a process of its own on a pseudo-terminal, 2000 packets a second; the
installed daemon records, feeds the viewer, serves one stream client, and is scraped every second.
"""

from __future__ import annotations

import contextlib
import http.client
import multiprocessing
import os
import socket as sockets
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench.table import Row
from groundstation.errors import GroundStationError
from groundstation.service.client import Client, ask, live

SETTLE_S, MEASURED_S = 15.0, 30.0
PORTS = ("--set", "viewer.port=19876", "--set", "viewer.web_port=19090")
STARTS_WITHIN_S = 180.0


def rows() -> Iterator[Row]:
    """Processor share and memory of the daemon's own process; references are the limits."""
    with at_line_rate("--viewer", "serve", *PORTS) as path:
        share, memory_mb, packets_hz, dropped = _measure(path)
    what = "daemon with recorder, viewer, metrics and a stream client"
    yield Row(f"{what}: packets a second (sent)", packets_hz, 2000.0, "packets/s")
    yield Row(f"{what}: processor (a core)", share, 1.0, "core", most=0.15)
    yield Row(f"{what}: resident memory", memory_mb, None, "MB", most=200.0)
    yield Row(f"{what}: dropped", dropped, None, "items", most=0.0)


@contextlib.contextmanager
def at_line_rate(*arguments: str) -> Iterator[Path]:
    """The control socket of an installed daemon that records from a serial line."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        craft = subprocess.Popen(
            [sys.executable, "-m", "firmware_sim", "--serial", f"pty:{folder / 'craft'}"],
            stdout=subprocess.DEVNULL,
        )
        line = f"serial:{folder / 'craft'}"
        try:
            with run_daemon(folder, "--link", line, *arguments) as control:
                until_status(
                    control, lambda status: (status.get("statistics") or {}).get("packets")
                )
                yield control
        finally:
            craft.terminate()
            craft.wait(30)


@contextlib.contextmanager
def run_daemon(folder: Path, *arguments: str) -> Iterator[Path]:
    """The control socket of an installed daemon that records to ``folder``, as soon as it has been
    started."""
    control = folder / "control.sock"
    daemon = subprocess.Popen(
        [Path(sys.executable).with_name("groundstation"), "run",
         "--recordings", folder / "sessions", *arguments],
        env={**os.environ, "GROUNDSTATION_SOCKET": str(control)},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield control
    finally:
        daemon.terminate()
        daemon.wait(30)


def until_status(control: Path, holds: Callable[[dict[str, Any]], Any]) -> None:
    """Until the daemon's status is so: on a machine's first start kernels are compiled before it
    receives."""
    end_s = time.monotonic() + STARTS_WITHIN_S
    while time.monotonic() < end_s:
        with contextlib.suppress(GroundStationError):
            if holds(ask(control, "GET", "/status")):
                return
        time.sleep(0.1)
    raise TimeoutError(f"the daemon was not ready within {STARTS_WITHIN_S:g} s")


def page_address(control: Path) -> str:
    """Of the page, once it is served."""
    until_status(control, lambda status: status["page"]["state"] == "serving")
    return str(ask(control, "POST", "/page/address")["url"])


@contextlib.contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that spin meanwhile."""
    spinning = [multiprocessing.Process(target=_spin, daemon=True) for _ in range(processes)]
    for one in spinning:
        one.start()
    try:
        yield
    finally:
        for one in spinning:
            one.terminate()


def _spin() -> None:
    while True:
        pass


def _measure(socket: Path) -> tuple[float, float, float, float]:
    """Processor share, memory in MB, packets a second, items dropped."""
    listener = threading.Thread(target=_listen, args=(socket,), daemon=True)
    time.sleep(SETTLE_S / 3)
    listener.start()
    time.sleep(SETTLE_S * 2 / 3)
    with Client(socket) as client:
        before, began_s = client.ask("GET", "/status"), time.monotonic()
        while time.monotonic() - began_s < MEASURED_S:
            _scrape(socket)
            time.sleep(1.0)
        lasted_s = time.monotonic() - began_s
        after = client.ask("GET", "/status")
    share = (after["health"]["cpu_s"] - before["health"]["cpu_s"]) / lasted_s
    packets = after["statistics"]["packets"] - before["statistics"]["packets"]
    dropped = sum(after[part]["dropped"] for part in ("recording", "stream", "viewer"))
    return share, after["health"]["memory_mb"], packets / lasted_s, float(dropped)


def _listen(socket: Path) -> None:
    while True:
        try:
            for _ in live(socket):
                pass
        except GroundStationError:
            time.sleep(0.2)


def _scrape(socket: Path) -> None:
    connection = http.client.HTTPConnection("localhost")
    connection.sock = sockets.socket(sockets.AF_UNIX)
    connection.sock.connect(str(socket))
    connection.request("GET", "/metrics")
    connection.getresponse().read()
    connection.close()
