"""ROS bags (.mcap, .db3 or the folder with metadata.yaml of ROS 2, .bag of ROS 1), read by rosbags
(extra ``logs``).

Every topic is a series: numbers by their path in the message (``angular_velocity.x``), arrays of
few numbers by place (``values[0]``), and ``time``, seconds since the bag's first stamp. A message
with a header came when its stamp says, any other when the bag got it. Crazyswarm2's log topics came
when the craft's own clock says, for one variable's radio is as late as another's.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, RecordingError, install
from groundstation.recording.column_map import TOPIC, read_mapped_series, under
from groundstation.recording.mcap_reader import ForeignMcapError, read_mcap
from groundstation.recording.mcap_scan import looks_like_mcap
from groundstation.recording.session import EVERY_ROW, Findings, Log, Recording, Rows, Series
from groundstation.text import NAMED_MOST

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

ROS1_MAGIC = b"#ROSBAG V2.0"
SQLITE_MAGIC = b"SQLite format 3\0"
_PROFILE = struct.pack("<I", 4) + b"ros2"
_PROFILE_AT = 17
"""Behind MCAP's magic, the header's opcode and its length."""
MOST_WORDS = 200
"""Letters of a library's complaint that are passed on."""
MOST_NUMBERS = 32
"""Longer arrays are pictures and scans."""
_IMU = ("sensor_msgs/msg/Imu", "sensor_msgs/Imu")
LOG_TYPE = "crazyflie_interfaces/msg/LogDataGeneric"
_LOG_DEFINITION = "std_msgs/Header header\nuint32 timestamp\nfloat32[] values\n"
"""Its fields; a .db3 of an older ROS does not hold them."""
MS_NS = 1_000_000


def is_bag(head: bytes) -> bool:
    """True for the first bytes of a bag's file that another program wrote."""
    library_at = _PROFILE_AT + len(_PROFILE)
    is_ros = head[_PROFILE_AT:library_at] == _PROFILE
    is_ours = head[library_at + 4 :].startswith(b"groundstation")
    is_other = looks_like_mcap(head) and is_ros and not is_ours
    return head.startswith((SQLITE_MAGIC, ROS1_MAGIC)) or is_other


def is_bag_folder(path: Path) -> bool:
    return (path / "metadata.yaml").is_file()


def read_bag(path: Path, source: str | Path | None = None, rows: Rows = EVERY_ROW) -> Recording:
    """Read a bag, a file of one or its folder, by a column map (None: the named one that knows it).
    rows: of one craft, ``topic`` and the name that its topics begin with.

    Raises BadInputError where no map fits or there is no such topic, and as ``series_of_bag``.
    """
    log = series_of_bag(path)
    if rows:
        column, topic = rows.only or ("", "")
        if column != TOPIC or rows.rate_hz:
            raise BadInputError(f"{path}: of a bag, --only {TOPIC}=/NAME takes the topics of one")
        chosen = under(log.series, topic)
        if len(chosen) == len(log.series):
            names = ", ".join(one.name for one in log.series[:NAMED_MOST])
            raise BadInputError(f"{path}: --only {TOPIC}={topic}: that chooses none of {names}")
        log = replace(log, series=chosen)
    return read_mapped_series(path, "rosbag", log, source)


def series_of_bag(path: Path) -> Log:
    """Every topic whose messages read, and the types of those that do not.

    Raises BadInputError where rosbags is not installed or an MCAP file is no bag, RecordingError
    where the bag does not read.
    """
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader
    except ImportError as error:
        raise BadInputError(f"{path}: a ROS bag, which rosbags reads: {install('logs')}") from error
    head = _head(path)
    if looks_like_mcap(head) and not head.endswith(_PROFILE):
        raise BadInputError(f"{path}: an MCAP file that is no ROS bag, so it takes no column map")
    reader = Reader1 if head.startswith(ROS1_MAGIC) else Reader
    try:
        with reader(path) as bag:
            return _series(bag, ros1=reader is Reader1)
    except Exception as error:  # whatever the library meets in a stranger's file
        raise RecordingError(f"{path}: a ROS bag that cannot be read: {_why(error)}") from error


def _why(error: Exception) -> str:
    """The library's own reason where it has one for people, or that the bag is damaged."""
    said = error.args[0] if error.args else ""
    if type(error).__name__ != "ReaderError" or not isinstance(said, str):
        return "it is damaged; 'ros2 bag reindex' or 'rosbag reindex' may repair it"
    if said.startswith("Unrecognized storage"):
        return "its name must end in .db3, .mcap or .bag"
    return said.partition(": (")[0].partition("\n")[0][:MOST_WORDS]


def read_recovered(path: Path, source: str | Path | None = None, *, raw: bool = False) -> Recording:
    """Read an MCAP file: a recording, or a bag of another program that was recovered here, as it
    is where a column map is given. Raises as ``read_mcap``, and as ``read_bag`` for a bag."""
    if source is not None:
        return read_bag(path, source)
    try:
        return read_mcap(path, raw=raw)
    except ForeignMcapError as foreign:
        if not _head(path).endswith(_PROFILE):
            raise
        try:
            return read_bag(path)
        except RecordingError as error:
            raise foreign from error


def _head(path: Path) -> bytes:
    """A file's first bytes, to the end of MCAP's profile of ROS 2; of a folder none."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(_PROFILE_AT + len(_PROFILE))


@dataclass(slots=True)
class _Topic:
    type: str
    came_ns: list[int] = dataclass_field(default_factory=list)
    rows: list[dict[str, float]] = dataclass_field(default_factory=list)

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """Each number that any message has; NaN where one has it not."""
        names = dict.fromkeys(name for row in self.rows for name in row)
        return {name: np.array([row.get(name, np.nan) for row in self.rows]) for name in names}


def _series(bag: Any, ros1: bool) -> Log:
    """Every topic whose messages read, and the types of those that do not."""
    types, unread = _types(bag, ros1)
    read = types.deserialize_ros1 if ros1 else types.deserialize_cdr
    topics = {one.topic: _Topic(one.msgtype) for one in bag.connections}
    for connection, bag_ns, data in bag.messages():
        if connection.msgtype not in types.fielddefs or connection.msgtype in unread:
            continue
        try:
            message = read(data, connection.msgtype)
        except Exception:  # a type that misses a part, or is not the one that was written
            unread.append(connection.msgtype)
            continue
        topic = topics[connection.topic]
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        stamp_ns = 0 if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec
        topic.came_ns.append(stamp_ns or bag_ns)
        numbers = dict(_numbers(message, ""))
        topic.rows.append(numbers if connection.msgtype not in _IMU else _measured(numbers))
    clocks = {name: np.array(topic.came_ns, np.int64) for name, topic in topics.items()}
    columns = {name: topic.columns() for name, topic in topics.items()}
    _set_by_craft(clocks, {n: columns[n] for n, topic in topics.items() if topic.type == LOG_TYPE})
    first_ns = min((int(clock.min()) for clock in clocks.values() if len(clock)), default=0)
    series = []
    for name, topic in topics.items():
        clock = clocks[name]
        order = np.argsort(clock, kind="stable")
        given = {key: values[order] for key, values in columns[name].items()}
        given["time"] = ((clock[order] - first_ns) * 1e-9).astype(np.float64)
        series.append(Series(name, clock[order], given, topic.type))
    return Log(series, Findings(), unread)


def _set_by_craft(
    clocks: dict[str, NDArray[np.int64]], logs: Mapping[str, Mapping[str, NDArray[np.float64]]]
) -> None:
    """Give log topics their craft's own time, put where the least late message came."""
    by_craft: dict[str, list[str]] = {}
    for name, columns in logs.items():
        if "timestamp" in columns:
            by_craft.setdefault(name.rpartition("/")[0], []).append(name)
    for names in by_craft.values():
        own = {name: (logs[name]["timestamp"] * MS_NS).astype(np.int64) for name in names}
        if any((np.diff(stamps) < 0).any() for stamps in own.values()):
            continue  # it restarted: only the bag's clock goes on
        offset_ns = min(int((clocks[name] - own[name]).min()) for name in names)
        for name in names:
            clocks[name] = own[name] + offset_ns


def _numbers(message: Any, prefix: str) -> Iterator[tuple[str, float]]:
    """Every number of a message by its path."""
    for item in fields(message):
        value = getattr(message, item.name)
        name = prefix + item.name
        if is_dataclass(value):
            yield from _numbers(value, f"{name}.")
        elif isinstance(value, (bool, int, float)):
            if not item.name.isupper():  # a constant
                yield name, float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            numbers = value.ravel() if value.size <= MOST_NUMBERS else ()
            yield from ((f"{name}[{place}]", float(one)) for place, one in enumerate(numbers))


def _measured(numbers: dict[str, float]) -> dict[str, float]:
    """An Imu's numbers, NaN where its covariance begins with -1: the sensor does not measure it
    (sensor_msgs/Imu)."""
    for name in ("orientation", "angular_velocity", "linear_acceleration"):
        if numbers.get(f"{name}_covariance[0]") == -1.0:
            missing = [key for key in numbers if key.startswith(f"{name}.")]
            numbers |= dict.fromkeys(missing, math.nan)
    return numbers


def _types(bag: Any, ros1: bool) -> tuple[Typestore, list[str]]:
    """ROS's own types, those that the bag defines, and crazyswarm2's log; and those that do not
    parse."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    found = [get_types_from_msg(_LOG_DEFINITION, LOG_TYPE)]
    unread = []
    for one in bag.connections:
        if one.msgdef.format == MessageDefinitionFormat.MSG:
            try:
                found.append(get_types_from_msg(one.msgdef.data, one.msgtype))
            except Exception:  # what the library's grammar does not know
                unread.append(one.msgtype)
    for defined in found:
        new = {name: one for name, one in defined.items() if name not in types.fielddefs}
        try:
            types.register(new)
        except Exception:  # refers to a type that nobody defines
            unread += new
    return types, unread
