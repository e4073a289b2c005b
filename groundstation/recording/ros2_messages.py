"""What the MCAP profile ``ros2`` adds: each row in messages that ROS 2 tools plot, events as a log.

Every topic of such a file is CDR with its definition in the file, so rosbags, Foxglove, PlotJuggler
and rerun read it without us. What is JSON elsewhere is the text of a ``std_msgs/String``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.cdr import HEADER
from groundstation.recording.standard_messages import (
    HEADER_DEFINITION,
    QUATERNION_DEFINITION,
    SEPARATOR,
    TIME_DEFINITION,
    layout,
    quaternion,
    stamped,
)
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import SampleBatch

PROFILE = "ros2"
POSE_TOPIC = "/pose"
ROW_TOPIC = "/row"
LOG_TOPIC = "/rosout"

POSE_DEFINITION = f"""\
std_msgs/Header header
geometry_msgs/Pose pose
{SEPARATOR}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{SEPARATOR}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{QUATERNION_DEFINITION}{HEADER_DEFINITION}{TIME_DEFINITION}"""
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
LOG_DEFINITION = f"""\
uint8 DEBUG=10
uint8 INFO=20
uint8 WARN=30
uint8 ERROR=40
uint8 FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{TIME_DEFINITION}"""
STRING_DEFINITION = "string data\n"

_INFO, _WARN, _ERROR = 20, 30, 40
_LEVELS = {
    "fault": _ERROR,
    **dict.fromkeys(
        ("lost", "loss", "silent", "waiting", "restart", "damage", "dead man", "stop", "gap"), _WARN
    ),
}
_WORLD = b"world\0"
_POSE = layout({"position": ("(3,)<f8", 28), "orientation": ("(4,)<f8", 52)}, 84)
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
    """Topic, log time (ns) and CDR payload of each row; a pose where the attitude is known, at the
    origin, for nothing tells where the craft is."""
    times = np.maximum(batch.host_time_ns, 0).tolist()
    known = np.asarray(np.isfinite(batch.attitude).all(axis=1))
    poses, rows = _poses(batch), _rows(batch)
    for time_ns, row, pose, is_known in zip(times, rows, poses, known.tolist(), strict=True):
        yield ROW_TOPIC, time_ns, row.tobytes()
        if is_known:
            yield POSE_TOPIC, time_ns, pose.tobytes()


def log_message(entry: dict[str, Any]) -> bytes:
    """An event as ``rcl_interfaces/Log``."""
    time_ns = max(int(entry["time_ns"]), 0)
    kind, link = str(entry.get("kind", "")), str(entry.get("link", ""))
    out = bytearray(struct.pack("<iI", time_ns // 1_000_000_000 % 2**31, time_ns % 1_000_000_000))
    out.append(_LEVELS.get(kind, _INFO))
    for text in (link, f"{kind}: {entry.get('text', '')}", "", ""):
        _put_text(out, text.encode(errors="replace"))
    out += b"\0" * (-len(out) & 3) + _LENGTH.pack(0)
    return HEADER + bytes(out)


def string_message(text: bytes) -> bytes:
    """UTF-8 text as ``std_msgs/String``."""
    out = bytearray()
    _put_text(out, text)
    return HEADER + bytes(out)


def text_of(payload: bytes | memoryview) -> bytes | memoryview:
    """The text of a ``std_msgs/String``, or the payload itself where it is none: JSON begins with
    another byte. Raises ValueError where it is cut off."""
    if bytes(payload[:4]) != HEADER:
        return payload
    if len(payload) < 9 or _LENGTH.unpack_from(payload, 4)[0] != len(payload) - 8:
        raise ValueError("a string that ends inside")
    return payload[8:-1]


def _put_text(out: bytearray, text: bytes) -> None:
    out += b"\0" * (-len(out) & 3) + _LENGTH.pack(len(text) + 1) + text + b"\0"


def _poses(batch: SampleBatch) -> NDArray[np.void]:
    out = stamped(_POSE, batch)
    out["frame"], out["frame_length"] = _WORLD, len(_WORLD)
    out["orientation"] = quaternion(np.nan_to_num(batch.attitude))
    return out


def _rows(batch: SampleBatch) -> NDArray[np.void]:
    out = stamped(_ROW, batch)
    out["device_s"] = batch.time_s
    for name in ("segment", "debug", "battery_v", "duty", "rotor_rev_s", "copies"):
        out[name] = getattr(batch, name)
    out["gyro_dps"] = np.degrees(batch.gyro)
    out["accelerometer_g"] = batch.accelerometer / STANDARD_GRAVITY
    out["attitude_deg"] = np.degrees(batch.attitude)
    return out
