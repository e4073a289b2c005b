"""Messages in MCAP files: their encoding (CDR), their definitions, and our tables of them."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

import msgspec
import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from groundstation.documents import decode_json
from groundstation.dynamics.rotations import quaternion_of_attitude
from groundstation.errors import RecordingError
from groundstation.recording.session import UNUSUAL, Table
from groundstation.telemetry.packet import SAMPLE_PERIOD_S, STANDARD_GRAVITY
from groundstation.telemetry.samples import RawBatch, SampleBatch
from groundstation.text import encodable

# Message definitions in CDR: little-endian structures of numbers and number sequences.
#
# CDR (OMG Common Data Representation, version 1, as ROS 2 uses it) is a 4-byte header followed
# by the fields in order; each number is aligned to its own size, counted from the end of the
# header, and a sequence is a u32 count followed by its numbers. That is all a batch of columns
# needs, and every tool that knows ROS 2 reads it, given the definition text.


HEADER = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian."""

_TYPES = {
    **{"int8": "<i1", "uint8": "<u1", "int16": "<i2", "uint16": "<u2", "int32": "<i4"},
    **{"uint32": "<u4", "int64": "<i8", "uint64": "<u8", "float32": "<f4", "float64": "<f8"},
}
_LENGTH = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Field:
    """One line of a definition."""

    name: str
    dtype: np.dtype[Any]
    size: int
    """Bytes of one number."""
    sequence: bool


@dataclass(frozen=True, slots=True)
class Definition:
    """A flat message definition: numbers and sequences of numbers, nothing nested."""

    text: str
    fields: tuple[Field, ...]

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a ``ros2msg`` definition such as ``float32[] gyro_rad_s``.

        Raises ValueError on a line that is not a number or an unbounded number sequence.
        """
        fields = []
        for line in text.splitlines():
            words = line.split("#", 1)[0].split()
            if not words:
                continue
            kind, name = (words[0], words[1]) if len(words) == 2 else (line, "")
            base = kind.removesuffix("[]")
            if base not in _TYPES or not name:
                raise ValueError(f"definition line {line!r} is not a number or a number sequence")
            dtype = np.dtype(_TYPES[base])
            fields.append(Field(name, dtype, dtype.itemsize, kind.endswith("[]")))
        return cls(text, tuple(fields))

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """One message. ``values`` has a number or an array (any shape, row-major) per field."""
        out = bytearray()
        for field in self.fields:
            data = np.ascontiguousarray(values[field.name], field.dtype)
            size = field.size
            if field.sequence:
                out += b"\0" * (-len(out) & 3)
                out += _LENGTH.pack(data.size)
                if data.size:
                    out += b"\0" * (-len(out) & (size - 1))
            else:
                out += b"\0" * (-len(out) & (size - 1))
            out += data.tobytes()
        return HEADER + bytes(out)

    def slices(self, payload: bytes | memoryview) -> list[memoryview]:
        """The bytes of each field in order, without copying.

        Raises ValueError where the payload is not one whole message of this definition.
        """
        view = memoryview(payload)
        if view[:2] != HEADER[:2]:
            raise ValueError("message is not little-endian CDR")
        body = view[4:]
        total = len(body)
        offset = 0
        parts = []
        for field in self.fields:
            size = field.size
            count = 1
            if field.sequence:
                offset += -offset & 3
                if offset + 4 > total:
                    raise ValueError(f"message ends before {field.name}")
                count = _LENGTH.unpack_from(body, offset)[0]
                offset += 4
            if count:
                offset += -offset & (size - 1)
            end = offset + count * size
            if end > total:
                raise ValueError(f"message ends inside {field.name}")
            parts.append(body[offset:end])
            offset = end
        if total - offset > 3:  # some encoders round the length up to four bytes
            raise ValueError(f"message has {total - offset} bytes too many")
        return parts

    def decode(self, payload: bytes | memoryview) -> dict[str, NDArray[Any]]:
        """Field name -> array (of length 1 for a plain number), views into ``payload``.

        Raises ValueError where the payload is not one whole message of this definition.
        """
        return {
            field.name: np.frombuffer(part, field.dtype)
            for field, part in zip(self.fields, self.slices(payload), strict=True)
        }


# Telemetry as the message types that any viewer knows: Imu and BatteryState, at 50 Hz or more.
#
# Both have a fixed size here, so a batch is one structured array, laid out as CDR lays it out.


IMU_TOPIC = "/imu"
BATTERY_TOPIC = "/battery"
RATE_HZ = 50.0

SEPARATOR = "=" * 80
HEADER_DEFINITION = f"""\
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMU_DEFINITION = f"""\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{SEPARATOR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{HEADER_DEFINITION}"""
BATTERY_DEFINITION = f"""\
uint8 POWER_SUPPLY_STATUS_UNKNOWN=0
uint8 POWER_SUPPLY_HEALTH_UNKNOWN=0
uint8 POWER_SUPPLY_TECHNOLOGY_LIPO=3
std_msgs/Header header
float32 voltage
float32 temperature
float32 current
float32 charge
float32 capacity
float32 design_capacity
float32 percentage
uint8 power_supply_status
uint8 power_supply_health
uint8 power_supply_technology
bool present
float32[] cell_voltage
float32[] cell_temperature
string location
string serial_number
{HEADER_DEFINITION}"""

_FRAME = b"base_link\0"
_LIPO = 3
_STAMP = {
    "cdr": ("S4", 0),
    "sec": ("<i4", 4),
    "nanosec": ("<u4", 8),
    "frame_length": ("<u4", 12),
    "frame": (f"S{len(_FRAME)}", 16),
}


def layout(fields: dict[str, tuple[str, int]], size: int) -> np.dtype[np.void]:
    everything = {**_STAMP, **fields}
    return np.dtype(
        {
            "names": list(everything),
            "formats": [kind for kind, _ in everything.values()],
            "offsets": [offset for _, offset in everything.values()],
            "itemsize": size,
        }
    )


_IMU = layout(
    {
        "orientation": ("(4,)<f8", 28),
        "orientation_covariance": ("(9,)<f8", 60),
        "angular_velocity": ("(3,)<f8", 132),
        "angular_velocity_covariance": ("(9,)<f8", 156),
        "linear_acceleration": ("(3,)<f8", 228),
        "linear_acceleration_covariance": ("(9,)<f8", 252),
    },
    324,
)
_BATTERY = layout(
    {
        "voltage": ("<f4", 28),
        "unmeasured": ("(6,)<f4", 32),  # temperature ... percentage
        "technology": ("u1", 58),
        "present": ("u1", 59),
        "location_length": ("<u4", 68),  # two empty sequences before it
        "serial_length": ("<u4", 76),  # an empty string is its terminator alone
    },
    81,
)


Maker = Callable[[SampleBatch], Iterator[tuple[str, int, bytes]]]
"""Topic, log time (ns) and CDR payload of what rows come to."""


class StandardMessages:
    """Thins sample batches to one message per topic in each period of device time.

    Remembers which period it has served, so that consecutive batches join without a seam.
    rate_hz: periods a second. more: what else is made of the rows that are chosen.
    """

    def __init__(self, rate_hz: float = RATE_HZ, more: Maker | None = None) -> None:
        self._rate_hz, self._more = rate_hz, more
        self._segment: int | None = None
        self._origin_s = 0.0
        self._slot = -1

    def messages(self, batch: SampleBatch) -> Iterator[tuple[str, int, bytes]]:
        """Topic, log time (ns) and CDR payload for what ``batch`` adds."""
        if not len(batch):
            return
        restarts = np.flatnonzero(np.diff(batch.segment)) + 1
        runs = zip(np.split(batch.segment, restarts), np.split(batch.time_s, restarts), strict=True)
        chosen = batch[np.concatenate([self._new(int(run[0]), times) for run, times in runs])]
        if not len(chosen):
            return
        times = np.maximum(chosen.host_time_ns, 0)
        if not _nothing_known(chosen):
            for time_ns, message in zip(times.tolist(), _imu(chosen), strict=True):
                yield IMU_TOPIC, time_ns, message.tobytes()
        for time_ns, message, volt in zip(
            times.tolist(), _battery(chosen), chosen.battery_v, strict=True
        ):
            if np.isfinite(volt):
                yield BATTERY_TOPIC, time_ns, message.tobytes()
        if self._more is not None:
            yield from self._more(chosen)

    def _new(self, segment: int, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which samples of one segment are the first of their period."""
        if segment != self._segment:
            self._segment, self._origin_s, self._slot = segment, float(time_s[0]), -1
        since_s = time_s - self._origin_s
        # half a sample early, or the rounding of ticks decides which sample is first
        slots = np.floor((since_s + SAMPLE_PERIOD_S / 2) * self._rate_hz).astype(np.int64)
        new = np.diff(slots, prepend=self._slot) != 0
        self._slot = int(slots[-1])
        return new


def quaternion(attitude_rad: NDArray[np.floating]) -> NDArray[np.float64]:
    """Body-to-inertial unit quaternions in ROS's order x y z w, shape (n, 4), of angles (n, 3)."""
    return np.roll(quaternion_of_attitude(attitude_rad), -1, axis=-1)


def _nothing_known(batch: SampleBatch) -> bool:
    channels = (batch.attitude, batch.gyro, batch.accelerometer)
    return not any(bool(np.isfinite(channel).any()) for channel in channels)


def stamped(layout: np.dtype[np.void], batch: SampleBatch) -> NDArray[np.void]:
    out = np.zeros(len(batch), layout)
    out["cdr"] = HEADER
    times = np.maximum(batch.host_time_ns, 0)
    out["sec"] = np.minimum(times // 1_000_000_000, np.iinfo(np.int32).max)
    out["nanosec"] = times % 1_000_000_000
    out["frame_length"] = len(_FRAME)
    out["frame"] = _FRAME
    return out


def _imu(batch: SampleBatch) -> NDArray[np.void]:
    out = stamped(_IMU, batch)
    channels = (
        ("orientation", batch.attitude, quaternion),
        ("angular_velocity", batch.gyro, np.asarray),
        ("linear_acceleration", batch.accelerometer, np.asarray),
    )
    for name, values, convert in channels:
        known = np.atleast_2d(np.isfinite(values).all(axis=1, keepdims=True))
        out[name] = convert(np.where(known, values, 0))
        # a first covariance of -1 is the message's own mark for "no such estimate"
        out[f"{name}_covariance"][:, 0] = np.where(known[:, 0], 0.0, -1.0)
    return out


def _battery(batch: SampleBatch) -> NDArray[np.void]:
    out = stamped(_BATTERY, batch)
    out["voltage"] = batch.battery_v
    out["unmeasured"] = np.nan
    out["technology"] = _LIPO
    out["present"] = 1
    out["location_length"] = 1
    out["serial_length"] = 1
    return out


# What the MCAP profile ``ros2`` adds: each row in a message that ROS 2 tools plot.
#
# Every topic of such a file is CDR with its definition in the file, so rosbags, Foxglove,
# PlotJuggler and rerun read it without us. What is JSON elsewhere is the text of a
# ``std_msgs/String``.


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
{HEADER_DEFINITION}"""
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


# What a recording holds: its topics, their message definitions, and batches as messages.
#
# Everything a third-party tool needs to decode a recording is in the recording itself.


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
    **{name: (name, 1) for name in ("ticks", "host_time_ns", "segment", "copies", "battery_v")},
    **{"duty": ("duty", 4), "gyro": ("gyro_rad_s", 3), "accelerometer": ("accelerometer_m_s2", 3)},
    **{"attitude": ("attitude_rad", 3), "rotor_rev_s": ("rotor_rev_s", 4), "debug": ("debug", 1)},
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
        {RAW_TOPIC: RAW_DEFINITION, SAMPLES_TOPIC: SAMPLES_DEFINITION}[name].decode(payload)
    except (ValueError, KeyError):  # or of the standard types, which are made of the samples
        return None
    return TOPICS[name]


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


# Tables in a recording: any further series (motion capture, say) as a topic of its own.
#
# ROS field names are lower-case words, so each column gets such a name; what the file it came
# from called it is kept in the channel's metadata.


TABLE_PREFIX = "/tables/"
_TIME = "time_s"
_ROWS = 1000


class TableTopic:
    """How one table is written. Raises RecordingError where a column does not hold numbers."""

    def __init__(self, name: str, number: int, table: Table) -> None:
        self._table = table
        self._fields = _field_names(list(table.columns))
        lines = [f"float64[] {_TIME}"]
        for column, field in self._fields.items():
            kind = table.columns[column].dtype
            if kind.kind not in "iufb" or kind.itemsize > 8 or kind == np.float16:
                raise RecordingError(
                    f"table {name}: column {column} is {kind}; MCAP takes numbers only"
                )
            lines.append(f"{'uint8' if kind == np.bool_ else kind.name}[] {field}")
        self._definition = Definition.parse("\n".join(lines) + "\n")
        self.topic = Topic(
            name=TABLE_PREFIX + name,
            message_encoding="cdr",
            schema_name=f"groundstation_msgs/msg/Table{number}",
            schema_encoding="ros2msg",
            schema=self._definition.text.encode(),
        )
        names = {field: column for column, field in self._fields.items()}
        self.metadata = {"columns": msgspec.json.encode(names).decode()}

    def messages(self, origin_ns: int) -> Iterator[tuple[int, bytes]]:
        """Log time and payload of each message; ``origin_ns`` is the Unix time of time 0."""
        times = self._table.time_s
        for start in range(0, len(times), _ROWS):
            rows = slice(start, start + _ROWS)
            columns = {name: values[rows] for name, values in self._table.columns.items()}
            newest_ns = origin_ns + int(np.nanmax(times[rows], initial=0.0) * 1e9)
            yield newest_ns, self.encode(Table(times[rows], columns))

    def encode(self, rows: Table) -> bytes:
        """The payload of a message of some rows, whose columns are this table's."""
        values = {field: rows.columns[column] for column, field in self._fields.items()}
        return self._definition.encode({_TIME: rows.time_s, **values})


class TableColumns:
    """Collects the messages of one table. Raises ValueError where they are not a table's."""

    def __init__(self, channel: Channel, schema: Schema) -> None:
        self._definition = Definition.parse(schema.data.decode())
        names = decode_json(channel.metadata.get("columns", "{}"), dict[str, str])
        self._names = [names.get(field.name, field.name) for field in self._definition.fields]
        if self._names[:1] != [_TIME]:
            raise ValueError(f"{channel.topic} has no {_TIME}")
        self._columns = [bytearray() for _ in self._names]

    def add(self, payload: memoryview) -> None:
        parts = self._definition.slices(payload)
        rows = len(parts[0]) // 8
        sizes = [rows * field.size for field in self._definition.fields]
        if sizes != [len(part) for part in parts]:
            raise ValueError("a table's columns differ in length")
        for column, part in zip(self._columns, parts, strict=True):
            column += part

    def table(self) -> Table:
        fields = self._definition.fields
        arrays = [
            np.frombuffer(column, field.dtype)
            for column, field in zip(self._columns, fields, strict=True)
        ]
        return Table(arrays[0], dict(zip(self._names[1:], arrays[1:], strict=True)))


def _field_names(columns: list[str]) -> dict[str, str]:
    """Column -> a ROS field name, all different."""
    names: dict[str, str] = {}
    taken = {_TIME}
    for column in columns:
        words = re.findall("[a-z0-9]+", column.lower()) or ["column"]
        base = "_".join(words if words[0][0].isalpha() else ["n", *words])
        name, number = base, 2
        while name in taken:
            name, number = f"{base}_{number}", number + 1
        taken.add(name)
        names[column] = name
    return names
