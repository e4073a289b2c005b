"""What a recording holds: its topics, their message definitions, and batches as messages.

Everything a third-party tool needs to decode a recording is in the recording itself.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from groundstation.documents import decode_json
from groundstation.recording.cdr import Definition
from groundstation.recording.channels import UNUSUAL
from groundstation.recording.ros2_messages import (
    ROW_DEFINITION,
    ROW_TOPIC,
    STRING_DEFINITION,
    text_of,
)
from groundstation.recording.standard_messages import (
    BATTERY_DEFINITION,
    BATTERY_TOPIC,
    IMU_DEFINITION,
    IMU_TOPIC,
)
from groundstation.telemetry.samples import RawBatch, SampleBatch
from groundstation.text import encodable

RAW_TOPIC = "/telemetry/raw"
SAMPLES_TOPIC = "/telemetry/samples"
COMMAND_TOPIC = "/command"
EVENTS_TOPIC = "/link/events"
STATISTICS_TOPIC = "/link/statistics"
ENTRY_TOPICS = (COMMAND_TOPIC, EVENTS_TOPIC, STATISTICS_TOPIC)

RAW_DEFINITION = Definition.parse("""\
# Telemetry packets as received, n per message.
int64[] host_time_ns  # [n] Unix time at which the host saw each packet
uint8[] packets       # [n * 32] the packets, one after the other
""")

SAMPLES_DEFINITION = Definition.parse("""\
# Decoded samples without duplicates, n per message; matrices row by row.
# Body axes: x forward, y left, z up. A channel without data is NaN.
float64 tick_s                # length of a tick
int64[] ticks                 # [n] device time in ticks, unwrapped
int64[] host_time_ns          # [n] Unix time at which the earliest copy arrived
int32[] segment               # [n] counts restarts of the device
uint32[] debug                # [n] the packet's free field
float32[] battery_v           # [n]
float32[] duty                # [n * 4] motors 1..4, 0..1
float32[] gyro_rad_s          # [n * 3] about x, y, z
float32[] accelerometer_m_s2  # [n * 3] specific force along x, y, z
float32[] attitude_rad        # [n * 3] roll, pitch (nose down positive), yaw
float32[] rotor_rev_s         # [n * 4] measured rotor speeds, or empty
uint8[] copies                # [n] agreeing copies of the packet
float32[] duty_step           # [n * 4] second less first setting in a row's duty, or empty
""")

SAMPLE_FIELDS: dict[str, tuple[str, int]] = {
    "ticks": ("ticks", 1),
    "host_time_ns": ("host_time_ns", 1),
    "segment": ("segment", 1),
    "copies": ("copies", 1),
    "battery_v": ("battery_v", 1),
    "duty": ("duty", 4),
    "gyro": ("gyro_rad_s", 3),
    "accelerometer": ("accelerometer_m_s2", 3),
    "attitude": ("attitude_rad", 3),
    "rotor_rev_s": ("rotor_rev_s", 4),
    "debug": ("debug", 1),
    "duty_step": ("duty_step", 4),
}
"""Column of a ``SampleBatch`` -> field of the definition and numbers per row."""


@dataclass(frozen=True, slots=True)
class Topic:
    """How one topic is stored."""

    name: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


def _cdr(name: str, schema_name: str, text: str) -> Topic:
    return Topic(name, "cdr", schema_name, "ros2msg", text.encode())


def _json(name: str, title: str, text: str, fields: dict[str, dict[str, str]]) -> Topic:
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": text,
        "type": "object",
        "properties": {
            "time_ns": {"type": "integer", "description": "Unix time in nanoseconds"},
            **fields,
        },
        "required": ["time_ns"],
    }
    return Topic(name, "json", title, "jsonschema", msgspec.json.encode(schema))


TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        _cdr(RAW_TOPIC, "groundstation_msgs/msg/RawPackets", RAW_DEFINITION.text),
        _cdr(SAMPLES_TOPIC, "groundstation_msgs/msg/Samples", SAMPLES_DEFINITION.text),
        _json(
            COMMAND_TOPIC,
            "groundstation.Command",
            "A setpoint or parameter write, sent or received.",
            {"kind": {"type": "string"}},
        ),
        _json(
            EVENTS_TOPIC,
            "groundstation.LinkEvent",
            "A change of a link's state, or a fault.",
            {"kind": {"type": "string"}, "link": {"type": "string"}, "text": {"type": "string"}},
        ),
        _json(
            STATISTICS_TOPIC,
            "groundstation.LinkStatistics",
            "Counters of a link: loss, duplicates, bursts, latency, jitter.",
            {},
        ),
        _cdr(IMU_TOPIC, "sensor_msgs/msg/Imu", IMU_DEFINITION),
        _cdr(BATTERY_TOPIC, "sensor_msgs/msg/BatteryState", BATTERY_DEFINITION),
    )
}
"""Every topic of a recording, in the order of the channel ids 1, 2, ... it is given."""


ROS2_TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        *(
            topic
            if topic.message_encoding == "cdr"
            else _cdr(topic.name, "std_msgs/msg/String", STRING_DEFINITION)
            for topic in TOPICS.values()
        ),
        _cdr(ROW_TOPIC, "groundstation_msgs/msg/Row", ROW_DEFINITION),
    )
}
"""The same for the MCAP profile ``ros2``, which knows no JSON: its text is a string there."""


def usual_topic(channel_id: int, payload: bytes | memoryview) -> Topic | None:
    """The topic of one of our messages where the file does not say it any more, by its channel's id
    and its content; None where that is not surely one of ours."""
    name = dict(enumerate(TOPICS, start=1)).get(channel_id, "")
    try:
        if name in ENTRY_TOPICS:
            decode_entry(payload)
            return (TOPICS if bytes(payload[:1]) == b"{" else ROS2_TOPICS)[name]
        if name == RAW_TOPIC:
            RAW_DEFINITION.decode(payload)
            return TOPICS[name]
        if name == SAMPLES_TOPIC:
            SAMPLES_DEFINITION.decode(payload)
            return TOPICS[name]
    except ValueError:
        return None
    return None  # of the standard types, which are made of the samples


def encode_raw(batch: RawBatch) -> bytes:
    """A ``groundstation_msgs/msg/RawPackets`` message."""
    return RAW_DEFINITION.encode({"host_time_ns": batch.host_time_ns, "packets": batch.packets})


def encode_samples(batch: SampleBatch) -> bytes:
    """A ``groundstation_msgs/msg/Samples`` message."""
    values: dict[str, Any] = {
        field: getattr(batch, column) for column, (field, _) in SAMPLE_FIELDS.items()
    }
    values["tick_s"] = batch.tick_s
    values |= {name: () for name in UNUSUAL if np.isnan(getattr(batch, name)).all()}
    return SAMPLES_DEFINITION.encode(values)


def encode_entry(entry: dict[str, Any]) -> bytes:
    """JSON of a command, event or statistics entry. What JSON has no type for becomes text."""
    try:
        return msgspec.json.encode(entry, enc_hook=_plain)
    except UnicodeEncodeError:  # the name of a file that is not UTF-8
        return msgspec.json.encode(_printable(entry))


def decode_entry(payload: bytes | memoryview) -> dict[str, Any]:
    """Inverse of ``encode_entry``, also where its text is a ``std_msgs/String``. Raises ValueError
    where the payload is not a JSON object."""
    return decode_json(text_of(payload), dict[str, Any])


def metadata_checksum(name: str, items: Iterable[tuple[str, str]]) -> str:
    """Checksum stored with each metadata record, which MCAP itself leaves unprotected."""
    text = "\0".join([name, *(word for item in items for word in item)])
    return f"{zlib.crc32(text.encode()):08x}"


def _printable(value: Any) -> Any:
    if isinstance(value, dict):
        return {encodable(str(key)): _printable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_printable(item) for item in value]
    if value is None or isinstance(value, bool | int | float):
        return value
    return encodable(value) if isinstance(value, str) else _printable(_plain(value))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value)
