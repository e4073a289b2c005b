"""kill -9 at any moment: what was received is in the file, up to the last half second."""

import random
import signal
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_scan import recover
from groundstation.recording.quality import inspect_recording
from groundstation.telemetry.samples import COLUMNS
from support import RECORDINGS
from support.daemons import Daemon
from support.packets import assert_same_packets, assert_same_samples

KILLS, GROUPS = 10, 2
TOGETHER = 2
MISSING_MOST_S = 0.5
"""Of the daemon's own time: a busy machine holds it and its recorder up alike."""
SOURCE = RECORDINGS / "stand_in_flight.mcap"


def kill_at(folder, delay_s, *arguments):
    """Kill a recording daemon after ``delay_s`` and what may be missing: the file, and how many
    samples had come when so much was left."""
    with Daemon(folder, *arguments) as daemon:
        told = [daemon.recording()]
        ends_s = told[0]["uptime_s"] + MISSING_MOST_S + delay_s
        while told[-1]["uptime_s"] < ends_s:
            time.sleep(0.04)
            told.append(daemon.status())
        assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
    due_s = told[-1]["uptime_s"] - MISSING_MOST_S
    counted = [one["recording"]["samples"] for one in told if one["uptime_s"] <= due_s]
    return daemon.only_file(), counted[-1]


def require_all_but_the_end(path, least):
    """Nothing is missing but the last half second, before the repair and after it."""
    killed = open_recording(path, raw=True)
    report = inspect_recording(killed)
    assert (report["lost_samples"], report["gap_count"], report["segments"]) == (0, 0, 1)
    assert len(killed.samples) >= least > 0
    assert len(killed.raw) >= least
    repair = recover(path)
    if not repair.sound:
        assert repair.output != path
        repaired = open_recording(repair.output, raw=True)
        assert repaired.damage == []
        assert_same_samples(repaired.samples, killed.samples)
        assert_same_packets(repaired.raw, killed.raw)
    return killed


@pytest.mark.parametrize("group", range(GROUPS))
def test_a_kill_at_a_random_moment_costs_at_most_the_last_half_second(tmp_path, group):
    chance = random.Random(group)
    delays = [chance.uniform(0, 1.2) for _ in range(KILLS // GROUPS)]
    folders = [tmp_path / str(number) for number in range(len(delays))]
    with ThreadPoolExecutor(TOGETHER) as pool:
        killed = list(
            pool.map(
                lambda folder, delay_s: kill_at(folder, delay_s, "--link", f"replay:{SOURCE}"),
                folders,
                delays,
            )
        )
    source = open_recording(SOURCE, raw=True)
    for path, least in killed:
        copy = require_all_but_the_end(path, least)
        rows = len(copy.raw)
        np.testing.assert_array_equal(copy.raw.packets, source.raw.packets[:rows])
        rows = len(copy.samples)
        for name in COLUMNS:
            if name != "host_time_ns":
                got, expected = getattr(copy.samples, name), getattr(source.samples, name)
                np.testing.assert_array_equal(got, expected[:rows], err_msg=name)


def test_a_killed_flight_of_the_stand_in_is_kept_too(tmp_path):
    path, least = kill_at(tmp_path, 0.7)
    assert require_all_but_the_end(path, least).link == "stand-in"
