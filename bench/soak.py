"""Weeks in hours: telemetry through the real daemon as fast as it goes, every file verified.

``python -m bench.soak --hours 24``. The installed ``groundstation run`` receives from the
software craft at full speed, with the viewer on and files rotated by size. Each file that is
done is read back, checked and deleted. At the end every sample and packet that arrived must have
been found in the files.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.errors import GroundStationError
from groundstation.recording.mcap_reader import read_mcap
from groundstation.recording.mcap_scan import catalogue
from groundstation.service.client import ask
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

PATIENCE_S = 120.0
LOOK_S = 0.5
ROTATE_MB = 64.0
WARM_UP = 0.1
"""Share of the run after which memory may grow no more."""


@dataclass
class Found:
    """What the files held, in order."""

    files: int = 0
    samples: int = 0
    packets: int = 0
    bytes: int = 0
    gaps_s: list[float] = field(default_factory=list)
    segments: int = 0
    problems: list[str] = field(default_factory=list)
    last: tuple[int, int] | None = None
    """Segment and ticks of the newest sample so far."""


def verify(path: Path, found: Found) -> None:
    """Read one finished file and add it to what was found."""
    recording = read_mcap(path, raw=True)
    samples, raw = recording.samples, recording.raw
    assert raw is not None
    found.files += 1
    found.bytes += path.stat().st_size
    found.samples += len(samples)
    found.packets += len(raw)
    found.problems += [f"{path.name}: {line}" for line in recording.damage]
    totals = recording.metadata["totals"]
    if (totals["samples"], totals["raw_packets"]) != (str(len(samples)), str(len(raw))):
        found.problems.append(f"{path.name}: {totals} but {len(samples)} samples were read")
    ticks, segment = samples.ticks, samples.segment.astype(np.int64)
    if found.last is not None and len(samples):
        segment = np.concatenate([[found.last[0]], segment])
        ticks = np.concatenate([[found.last[1]], ticks])
    step = np.rint(np.diff(ticks) * samples.tick_s / SAMPLE_PERIOD_S)
    same = np.diff(segment) == 0
    found.gaps_s += (step[same & (step != 1)] * SAMPLE_PERIOD_S).tolist()
    found.segments += int(np.count_nonzero(~same))
    found.last = int(segment[-1]), int(ticks[-1])


def soak(hours: float, folder: Path) -> dict[str, Any]:
    """Run the daemon for so many hours of telemetry; the figures."""
    socket, sessions = folder / "control.sock", folder / "sessions"
    command = [str(Path(sys.executable).with_name("groundstation")), "run", "--speed", "max",
               "--recordings", str(sessions), "--viewer", "serve",
               "--set", f"recording.rotate_mb={ROTATE_MB}",
               "--set", "recording.rotate_minutes=0"]  # fmt: skip
    environment = {**os.environ, "GROUNDSTATION_SOCKET": str(socket)}
    wanted = round(hours * 3600 / SAMPLE_PERIOD_S)
    found, memory_mb = Found(), []
    with (folder / "log").open("wb") as log:
        daemon = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
    try:
        began_s, status = time.monotonic(), _first(socket, daemon)
        while (status["statistics"] or {}).get("samples", 0) < wanted:
            _take(sessions, status, found)
            if status["statistics"] and status["statistics"]["samples"] > WARM_UP * wanted:
                memory_mb.append(status["health"]["memory_mb"])
            time.sleep(LOOK_S)
            status = ask(socket, "GET", "/status")
        lasted_s = time.monotonic() - began_s
        daemon.send_signal(signal.SIGINT)
        code = daemon.wait(PATIENCE_S)
    finally:
        if daemon.poll() is None:
            daemon.kill()
            daemon.wait()
    last = [line for line in (folder / "log").read_text().splitlines() if line.startswith("recei")]
    words = last[0].split()
    for entry in catalogue(sessions):
        verify(sessions / entry.file, found)
    if code:
        found.problems.append(f"exit status {code}")
    tenth = max(1, len(memory_mb) // 10)
    return {
        "took_s": lasted_s,
        "times_real_time": int(words[1]) * SAMPLE_PERIOD_S / lasted_s,
        "packets_arrived": int(words[5]),
        "packets_recorded": found.packets,
        "samples_arrived": int(words[1]),
        "samples_recorded": found.samples,
        "gaps_in_device_time_s": found.gaps_s,
        "samples_reported_lost": status["statistics"]["lost"],
        "device_restarts": found.segments,
        "files": found.files,
        "gigabytes": found.bytes / 1e9,
        "memory_mb_after_warm_up": float(np.median(memory_mb[:tenth])),
        "memory_mb_at_end": float(np.median(memory_mb[-tenth:])),
        "recorder_dropped": status["recording"]["dropped"],
        "problems": found.problems,
    }


def passed(figures: dict[str, Any]) -> bool:
    """Whether the soak shows what it must."""
    return (
        not figures["problems"]
        and figures["packets_recorded"] == figures["packets_arrived"]
        and figures["samples_recorded"] == figures["samples_arrived"]
        and figures["memory_mb_at_end"] - figures["memory_mb_after_warm_up"] < 10.0
    )


def _first(socket: Path, daemon: subprocess.Popen[bytes]) -> dict[str, Any]:
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            answer: dict[str, Any] = ask(socket, "GET", "/status")
            return answer
        except GroundStationError:
            if daemon.poll() is not None or time.monotonic() > deadline_s:
                raise
            time.sleep(0.1)


def _take(sessions: Path, status: dict[str, Any], found: Found) -> None:
    """Verify and delete every file that is done, oldest first."""
    writing = status["recording"]["file"]
    for entry in catalogue(sessions, recording=Path(writing) if writing else None):
        if entry.state != "finished":
            return  # it, or the one before it, is still being finished
        verify(sessions / entry.file, found)
        (sessions / entry.file).unlink()


def main() -> None:
    """Run and print the figures as JSON; exit status 1 where something is missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="hours of telemetry")
    hours = parser.parse_args().hours
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        figures = soak(hours, Path(folder))
    print(json.dumps(figures, indent=2))
    sys.exit(not passed(figures))


if __name__ == "__main__":
    main()
