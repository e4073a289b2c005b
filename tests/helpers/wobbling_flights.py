"""A made flight with all that a recording may hold: samples, restart, events, commands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.recording.session import Recording
from groundstation.telemetry.packet import ACCELEROMETER_M_S2, ANGLE_RAD, GYRO_RAD_S
from groundstation.telemetry.samples import SampleBatch, empty_samples

START_NS = 1_760_000_000_000_000_000


def _wobble(rows: int, first: int = 0) -> SampleBatch:
    """A craft that rolls, pitches and yaws, in whole counts of the packet, four copies each."""
    number = np.arange(first, first + rows)
    time_s = number * 0.002
    samples = empty_samples(rows)
    samples.ticks[:] = np.rint(number * 1972.603) + 700
    samples.host_time_ns[:] = START_NS + number * 2_000_000
    samples.copies[:] = 4
    samples.debug[:] = number * 7919
    angles = np.stack([20 * np.sin(2 * time_s), 12 * np.cos(1.3 * time_s), 60 * np.sin(time_s)], 1)
    samples.attitude[:] = np.rint(angles * 100) * np.float32(ANGLE_RAD)
    rates = np.gradient(angles, 0.002, axis=0) if rows > 1 else np.zeros((rows, 3))
    samples.gyro[:] = np.rint(rates * 16.384) * np.float32(GYRO_RAD_S)
    pulls = np.stack([0.1 * np.sin(time_s), 0.1 * np.cos(time_s), 1 + 0.1 * np.sin(3 * time_s)], 1)
    samples.accelerometer[:] = np.rint(pulls * 4096) * np.float32(ACCELEROMETER_M_S2)
    samples.duty[:] = np.rint(512 * (0.6 + 0.1 * np.sin(time_s[:, None] + np.arange(4)))) / 512
    samples.battery_v[:] = np.float32(3.9) - np.rint(10 * time_s).astype(np.float32) / 1000
    return samples


@pytest.fixture
def wobble() -> Callable[..., SampleBatch]:
    """wobble(rows, first=0): that part of an endless flight at 500 Hz."""
    return _wobble


@pytest.fixture
def flight() -> Recording:
    """Eight seconds with two segments, events, statistics, a command and a table."""
    samples = _wobble(4000)
    samples.segment[2500:] = 1
    samples.ticks[2500:] -= samples.ticks[2500] - 40  # the craft restarted: its clock did too
    samples.host_time_ns[2500:] += 1_500_000_000
    return Recording(
        path=Path("flight.mcap"),
        kind="mcap",
        samples=samples,
        events=[
            {"time_ns": START_NS - 10**8, "link": "usb", "kind": "opening", "text": "opening"},
            {"time_ns": START_NS + 10**9, "link": "usb", "kind": "lost", "text": "unplugged"},
        ],
        statistics=[
            {
                "time_ns": START_NS + second * 10**9,
                "loss_pct": 0.5 * second,
                "latency_ms": 8.25 - second,
                "rate_hz": 500.0 - second % 3,
            }
            for second in range(9)
        ]
        + [{"time_ns": START_NS + 9 * 10**9, "loss_pct": 0.0, "bursts": [1, 4]}],
        commands=[{"time_ns": START_NS + 10**9, "roll_deg": 2.5, "direction": "out"}],
        metadata={"session": {"link": "usb"}, "vehicle": {"name": "crazyflie1"}},
    )
