"""What a stand-in that runs alone writes: packets, samples as CSV, the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.packet import Packets
from groundstation.telemetry.samples import RawBatch, packet_counts

HEADER = (
    "Timestamp,Battery,Motor1,Motor2,Motor3,Motor4,GyroX,GyroY,GyroZ,AccX,AccY,AccZ,"
    "Roll,Pitch,Yaw,Debug"
)


def write_npz(
    path: Path, packets: Packets, arrival_s: NDArray[np.float64], vehicle: str | None = None
) -> None:
    """``packets`` (n, 32) as received, ``arrival_s`` (n,), seconds since power-on, and the name of
    the craft's profile, where it has one."""
    with path.open("xb") as file:
        named: dict[str, Any] = {} if vehicle is None else {"vehicle": vehicle}
        np.savez_compressed(file, packets=packets, arrival_s=arrival_s, **named)


def write_csv(path: Path, packets: Packets, arrival_s: NDArray[np.float64]) -> None:
    """Samples in the telemetry's CSV layout: the packet's integers, Timestamp unwrapped."""
    samples, _ = decode_all(RawBatch(packets, np.rint(arrival_s * 1e9).astype(np.int64)))
    counts = packet_counts(samples)
    order = ("timestamp", "battery", "motors", "gyro", "accelerometer", "angles", "debug")
    table = np.column_stack([counts[name] for name in order])
    with path.open("x") as file:
        np.savetxt(file, table, fmt="%d", delimiter=",", header=HEADER, comments="")


def write_truth(path: Path, truth: NDArray[np.void]) -> None:
    """``truth``: one TRUTH record (see ``layout``) per row of telemetry."""
    with path.open("xb") as file:
        np.savez_compressed(file, truth=truth)
