"""A craft whose console never ends a line, at all that a radio carries: the daemon is there."""

import time

import psutil

from groundstation.service.client import Pilot
from support.crafts import narrow, served
from support.daemons import Daemon
from support.waiting import until

RATE_HZ, PIECES = 100, 60
PIECE = b"\0" + b"x" * 30
"""Console text, 180 kB a second with a log packet each 10 ms."""
PART_S = 3.0
"""Of the craft's time."""


def cost_of(daemon, craft):
    """Processor time of the daemon for a part of the flood, and how long each status took, s."""
    process = psutil.Process(daemon.process.pid)
    begun_s, took_s = sum(process.cpu_times()[:2]), []
    until_s = craft.craft.time_s + PART_S
    while craft.craft.time_s < until_s:
        asked_s = time.monotonic()
        daemon.ask("GET", "/status")
        took_s.append(time.monotonic() - asked_s)
        time.sleep(0.05)
    return sum(process.cpu_times()[:2]) - begun_s, took_s


def test_text_without_a_line_end_costs_no_more_the_longer_it_lasts(tmp_path):
    """Put together anew with each piece it kept the daemon from everything else within seconds."""
    with (
        served(craft="crazyflie21") as craft,
        narrow(craft.server.port) as radio,
        Daemon(tmp_path, "--link", radio.uri, "--set", f"radio.rate_hz={RATE_HZ}") as daemon,
    ):
        daemon.recording(samples=50)
        radio.adds = [PIECE] * PIECES
        costs, took_s = zip(*(cost_of(daemon, craft) for _ in range(3)), strict=True)
        print(f"status after {max(map(max, took_s)):.3f} s at most, processor time {costs} s")
        assert costs[-1] < 1.5 * costs[0] + 0.5
        told = [event["text"] for event in daemon.ask("GET", "/events")]
        assert any("lines left out" in text for text in told), "the flood has not come"
        before = daemon.status()["recording"]["samples"]
        daemon.recording(samples=before + 50)
        with Pilot(daemon.socket, "vanishes") as pilot:
            pilot.setpoint(0.0, 0.0, 0.0, 0)
            pilot.setpoint(0.0, 0.0, 0.0, 10000)
            until(
                lambda: any("has vanished" in e["text"] for e in daemon.ask("GET", "/events")),
                "the failsafe acts",
            )
        assert daemon.stop() == 0
