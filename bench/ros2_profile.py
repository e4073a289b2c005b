"""``python -m bench.ros2_profile``: what rows for ROS 2 tools cost a recording, CPU and size."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from groundstation.recording.mcap_writer import McapRecorder
from groundstation.recording.open_recording import open_recording
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import RawBatch

FLIGHT = Path(__file__).parents[1] / "recordings" / "stand_in_flight.mcap"
ROWS = 4
"""In a batch, as a link delivers them."""


def cost(ros2_hz: float) -> tuple[float, float]:
    """Per cent of a core and MB an hour of recording 500 rows a second and their packets."""
    flight = open_recording(FLIGHT, raw=True)
    samples, raw = flight.samples, flight.raw
    assert raw is not None
    seconds = len(samples) * SAMPLE_PERIOD_S
    ends = np.searchsorted(raw.host_time_ns, samples.host_time_ns[ROWS - 1 :: ROWS], "right")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        began_s, first = time.process_time(), 0
        with McapRecorder(path, {}, ros2_hz=ros2_hz) as recorder:
            for place, end in enumerate(ends):
                recorder.samples(samples[ROWS * place : ROWS * (place + 1)])
                recorder.raw(RawBatch(raw.packets[first:end], raw.host_time_ns[first:end]))
                first = end
                if place % 25 == 0:  # 0.2 s of flight: as often as the recorder writes
                    time.sleep(0.005)
        share = (time.process_time() - began_s) / seconds
        return 100 * share, path.stat().st_size / seconds * 3600 / 1e6


def main() -> None:
    print("ros2_hz   % of a core   MB an hour")
    for ros2_hz in (0.0, 100.0, 500.0):
        share, size = min(cost(ros2_hz) for _ in range(3))
        print(f"{ros2_hz:7.0f}{share:14.2f}{size:13.0f}")


if __name__ == "__main__":
    main()
