"""What the MCAP profile ``ros2`` adds: each row in a message that ROS 2 tools plot.

Every topic of such a file is CDR with its definition in the file, so rosbags, Foxglove, PlotJuggler
and rerun read it without us. What is JSON elsewhere is the text of a ``std_msgs/String``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.cdr import HEADER
from groundstation.recording.standard_messages import (
    HEADER_DEFINITION,
    TIME_DEFINITION,
    layout,
    stamped,
)
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch

PROFILE = "ros2"
ROW_TOPIC = "/row"

ROW_DEFINITION = f"""\
# One row of telemetry; NaN: not measured. Body axes: x forward, y left, z up.
std_msgs/Header header
float64 device_s         # time of the craft's own clock
int32 segment            # counts restarts of the craft
uint32 debug
float32 battery_v
float32 duty_1           # of motors M1..M4, 0..1
float32 duty_2
float32 duty_3
float32 duty_4
float32 rotor_1_rev_s
float32 rotor_2_rev_s
float32 rotor_3_rev_s
float32 rotor_4_rev_s
float32 gyro_x_dps
float32 gyro_y_dps
float32 gyro_z_dps
float32 accelerometer_x_g
float32 accelerometer_y_g
float32 accelerometer_z_g
float32 roll_deg         # left side up positive
float32 pitch_deg        # nose down positive
float32 yaw_deg          # counter-clockwise positive
uint8 copies             # agreeing copies of the packet
{HEADER_DEFINITION}{TIME_DEFINITION}"""
STRING_DEFINITION = "string data\n"

_ROW = layout(
    {
        "device_s": ("<f8", 28),
        "segment": ("<i4", 36),
        "debug": ("<u4", 40),
        "battery_v": ("<f4", 44),
        "duty": ("(4,)<f4", 48),
        "rotor_rev_s": ("(4,)<f4", 64),
        "gyro_dps": ("(3,)<f4", 80),
        "accelerometer_g": ("(3,)<f4", 92),
        "attitude_deg": ("(3,)<f4", 104),
        "copies": ("u1", 116),
    },
    117,
)
_LENGTH = struct.Struct("<I")


def row_messages(batch: SampleBatch) -> Iterator[tuple[str, int, bytes]]:
    """Topic, log time (ns) and CDR payload of each row."""
    times = np.maximum(batch.host_time_ns, 0).tolist()
    for time_ns, row in zip(times, _rows(batch), strict=True):
        yield ROW_TOPIC, time_ns, row.tobytes()


def string_message(text: bytes) -> bytes:
    """UTF-8 text as ``std_msgs/String``."""
    return HEADER + _LENGTH.pack(len(text) + 1) + text + b"\0"


def text_of(payload: bytes | memoryview) -> bytes | memoryview:
    """The text of a ``std_msgs/String``, or the payload itself where it is none: JSON begins with
    another byte. Raises ValueError where it is cut off."""
    if bytes(payload[:4]) != HEADER:
        return payload
    if len(payload) < 9 or _LENGTH.unpack_from(payload, 4)[0] != len(payload) - 8:
        raise ValueError("a string that ends inside")
    return payload[8:-1]


def _rows(batch: SampleBatch) -> NDArray[np.void]:
    out = stamped(_ROW, batch)
    out["device_s"] = batch.time_s
    for name in ("segment", "debug", "battery_v", "duty", "rotor_rev_s", "copies"):
        out[name] = getattr(batch, name)
    out["gyro_dps"] = np.degrees(batch.gyro)
    out["accelerometer_g"] = batch.accelerometer / STANDARD_GRAVITY
    out["attitude_deg"] = np.degrees(batch.attitude)
    return out
