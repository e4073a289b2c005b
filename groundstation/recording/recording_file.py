"""A recording being written: an MCAP file with the project's topics."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import platform
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation import __version__
from groundstation.errors import RecordingError
from groundstation.recording.mcap_file import McapFile
from groundstation.recording.mcap_schemas import (
    COMMAND_TOPIC,
    EVENTS_TOPIC,
    RAW_TOPIC,
    ROS2_TOPICS,
    SAMPLES_TOPIC,
    STATISTICS_TOPIC,
    TOPICS,
    Topic,
    encode_entry,
    encode_raw,
    encode_samples,
)
from groundstation.recording.mcap_tables import TableTopic
from groundstation.recording.ros2_messages import (
    PROFILE,
    row_messages,
    string_message,
)
from groundstation.recording.session import Recording
from groundstation.recording.standard_messages import StandardMessages
from groundstation.telemetry.samples import RawBatch, SampleBatch
from groundstation.text import encodable

MESSAGE_S = 0.05
"""How long a message of packets or samples lasts, seconds."""
_MAX_ROWS = 1024
_STEP_ROWS = 1000

CHANNELS_METADATA = "channels"
"""Metadata record: channel id -> topic. The definitions live in the first chunk; should that
one be damaged in a torn file, this is how the rest is still understood."""


class RecordingFile:
    """Writes batches and entries as messages.

    ros2_hz: rows a second that are also written for ROS 2's tools, with the profile ``ros2``;
    0 for none, and JSON where that is smaller.

    Raises BadInputError where ``path`` exists and RecordingError where it cannot be created;
    every other method raises ``OSError`` where the disk fails.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, Mapping[str, str]], *, ros2_hz: float = 0.0
    ) -> None:
        self._is_ros2 = ros2_hz > 0
        self.file = McapFile(path, profile=PROFILE if self._is_ros2 else "")
        self._standard = (
            StandardMessages(ros2_hz, row_messages) if self._is_ros2 else StandardMessages()
        )
        topics = ROS2_TOPICS if self._is_ros2 else TOPICS
        self._channels: dict[str, int] = {}
        try:
            for name, items in metadata.items():
                texts = {key: encodable(str(value)) for key, value in items.items()}
                self.file.add_metadata(name, texts)
            names = {str(number): name for number, name in enumerate(topics, start=1)}
            self.file.add_metadata(CHANNELS_METADATA, names)
            for topic in topics.values():
                self.add_topic(topic)
            self.file.flush()
        except OSError as error:
            self.discard()
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error

    def add_topic(self, topic: Topic, metadata: Mapping[str, str] | None = None) -> None:
        """Make ``topic`` known to the file; ``TOPICS`` are known from the start."""
        schema = self.file.register_schema(topic.schema_name, topic.schema_encoding, topic.schema)
        self._channels[topic.name] = self.file.register_channel(
            topic.name, topic.message_encoding, schema, metadata or {}
        )

    def raw(self, batch: RawBatch, span_s: float = MESSAGE_S) -> None:
        """Write packets as messages that last up to ``span_s`` each."""
        for rows in _spans(batch.host_time_ns, span_s):
            message = RawBatch(batch.packets[rows], batch.host_time_ns[rows])
            self.add(RAW_TOPIC, int(message.host_time_ns.max()), encode_raw(message))

    def samples(self, batch: SampleBatch, span_s: float = MESSAGE_S) -> None:
        """Write samples as messages that last up to ``span_s`` each, and what they add to the
        topics of standard types."""
        for rows in _spans(batch.host_time_ns, span_s):
            message = batch[rows]
            self.add(SAMPLES_TOPIC, int(message.host_time_ns.max()), encode_samples(message))
        for topic, time_ns, payload in self._standard.messages(batch):
            self.add(topic, time_ns, payload)

    def entry(self, topic: str, entry: dict[str, Any]) -> None:
        """Write a command, event or statistics entry; it has a ``time_ns``."""
        self.encoded(topic, int(entry["time_ns"]), encode_entry(entry))

    def encoded(self, topic: str, time_ns: int, payload: bytes) -> None:
        """Write an entry that ``encode_entry`` made."""
        self.add(topic, time_ns, string_message(payload) if self._is_ros2 else payload)

    def add(self, topic: str, time_ns: int, payload: bytes) -> None:
        self.file.add_message(self._channels[topic], time_ns, payload)

    def finish(self) -> None:
        self.file.finish()

    def discard(self) -> None:
        """Close the file and remove it."""
        self.file.abandon()
        with contextlib.suppress(OSError):
            self.file.path.unlink()


def write_mcap(recording: Recording, path: str | Path, *, ros2_hz: float = 0.0) -> None:
    """Write a recording, from whatever file it came, as a new MCAP file.

    ros2_hz: as ``RecordingFile`` takes it. Messages are in the order of their host times, so
    viewers can play the file. Leaves no output behind where it fails. Raises BadInputError where
    ``path`` exists, RecordingError where it cannot be written or a table does not hold numbers.
    """
    path = Path(path)
    tables = [
        TableTopic(name, number, table)
        for number, (name, table) in enumerate(recording.tables.items(), start=1)
    ]
    out = RecordingFile(path, recording.metadata, ros2_hz=ros2_hz)
    try:
        for table in tables:
            out.add_topic(table.topic, table.metadata)
        streams = [_raw(out, recording), _samples(out, recording), *_entries(out, recording)]
        streams += [_table(out, table, _origin_ns(recording.samples)) for table in tables]
        for _, write in heapq.merge(*streams, key=lambda step: step[0]):
            write()
        out.finish()
    except BaseException as error:
        out.discard()
        if isinstance(error, OSError):
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
        raise


def session_metadata(link: str) -> dict[str, str]:
    """The ``session`` metadata of a recording that ``link`` makes from now on."""
    return {
        "link": link,
        "created": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "groundstation": __version__,
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
    }


_Step = tuple[int, Callable[[], None]]
"""Host time (ns) of a message, and what writes it."""


def _raw(out: RecordingFile, recording: Recording) -> Iterator[_Step]:
    raw = recording.raw
    if raw is not None:
        for rows in _pieces(len(raw)):
            batch = RawBatch(raw.packets[rows], raw.host_time_ns[rows])
            yield int(batch.host_time_ns[0]), partial(out.raw, batch)


def _samples(out: RecordingFile, recording: Recording) -> Iterator[_Step]:
    for rows in _pieces(len(recording.samples)):
        batch = recording.samples[rows]
        yield int(batch.host_time_ns[0]), partial(out.samples, batch)


def _entries(out: RecordingFile, recording: Recording) -> Iterator[Iterator[_Step]]:
    def steps(topic: str, entries: list[dict[str, Any]]) -> Iterator[_Step]:
        for entry in entries:
            yield int(entry["time_ns"]), partial(out.entry, topic, entry)

    yield steps(COMMAND_TOPIC, recording.commands)
    yield steps(EVENTS_TOPIC, recording.events)
    yield steps(STATISTICS_TOPIC, recording.statistics)


def _table(out: RecordingFile, table: TableTopic, origin_ns: int) -> Iterator[_Step]:
    for time_ns, payload in table.messages(origin_ns):
        yield time_ns, partial(out.add, table.topic.name, time_ns, payload)


def _origin_ns(samples: SampleBatch) -> int:
    """Unix time at which the device's clock was at 0, as far as the first sample tells."""
    if not len(samples):
        return 0
    return int(samples.host_time_ns[0] - round(float(samples.time_s[0]) * 1e9))


def _pieces(length: int) -> Iterator[slice]:
    """Slices that cover ``length`` rows, small enough to interleave topics by time."""
    return (slice(start, start + _STEP_ROWS) for start in range(0, length, _STEP_ROWS))


def _spans(host_time_ns: NDArray[np.int64], span_s: float) -> Iterator[slice]:
    """Slices that cover all rows, each at most ``span_s`` and ``_MAX_ROWS`` long."""
    if not len(host_time_ns):
        return
    turn = (host_time_ns - host_time_ns[0]) // int(span_s * 1e9)
    edges = [0, *(np.flatnonzero(np.diff(turn)) + 1).tolist(), len(host_time_ns)]
    for first, last in itertools.pairwise(edges):
        for start in range(first, last, _MAX_ROWS):
            yield slice(start, min(start + _MAX_ROWS, last))
