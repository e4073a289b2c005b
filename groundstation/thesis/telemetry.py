"""Table 5.1 and Figure 5.7: the packet and the log."""

from __future__ import annotations

from typing import Any

import numpy as np

from groundstation.report.page import Cell, lines
from groundstation.telemetry.packet import PACKET_DTYPE
from groundstation.thesis.entry import Entry, Made, Table
from groundstation.thesis.printed import PACKET as PRINTED
from groundstation.thesis.workshop import Workshop


def _packet(workshop: Workshop) -> Made:
    rows: list[list[Cell]] = []
    fields: Any = PACKET_DTYPE.fields
    for (data, unit, size), name in zip(PRINTED, PACKET_DTYPE.names or (), strict=True):
        dtype, offset = fields[name][:2]
        rows.append([data, unit, size, name, offset, dtype.itemsize])
    return Made(
        "The same 32 bytes; units and signs of each field are in docs/hardware.md. The motors are"
        " 12 bits each, packed.",
        [
            Table(
                ["data", "printed unit", "printed bytes", "field here", "at byte", "bytes"],
                rows,
                f"{PACKET_DTYPE.itemsize} bytes in all.",
            )
        ],
    )


def _log(workshop: Workshop) -> Made:
    samples = workshop.samples("excerpt.csv")
    quality = workshop.said("excerpt.json")
    time = samples.time_s - samples.time_s[0]
    gyro = np.degrees(samples.gyro)
    accelerometer = samples.accelerometer / 9.80665
    return Made(
        f"The 25 printed rows, read as any recording is: {quality['samples']} samples at"
        f" {quality['rate_hz']:.1f} Hz, {quality['lost_samples']} lost,"
        f" {quality['gap_count']} gaps."
        " The accelerometer shows the rotors' imbalance, folded to nearly half the sample rate.",
        [
            Table(
                ["printed row 8517", "printed", "decoded"],
                [
                    ["Timestamp", "17114118", f"{samples.ticks[0]} ticks"],
                    ["Battery", "3242", f"{samples.battery_v[0]:.3f} V"],
                    ["Motor1", "3376", f"{100 * samples.duty[0, 0]:.1f} % duty"],
                    ["GyroX", "-445", f"{gyro[0, 0]:.2f} deg/s"],
                    ["AccZ", "7707", f"{accelerometer[0, 2]:.3f} g"],
                    ["Pitch", "-559", f"{np.degrees(samples.attitude[0, 1]):.2f} deg, nose down"],
                ],
            )
        ],
        [
            lines(time, dict(zip(("x", "y", "z"), gyro.T, strict=True)), "gyro, deg/s"),
            lines(
                time, dict(zip(("x", "y", "z"), accelerometer.T, strict=True)), "accelerometer, g"
            ),
        ],
    )


ENTRIES = (
    Entry("Table 5.1", "Telemetry data structure", _packet),
    Entry("Figure 5.7", "Data log example", _log),
)
