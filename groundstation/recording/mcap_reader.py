"""Recordings from MCAP files: the project's topics as arrays and dictionaries."""

from __future__ import annotations

import contextlib
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from groundstation.errors import RecordingError
from groundstation.recording.mcap_file import CHANNELS_METADATA
from groundstation.recording.mcap_scan import McapScan, is_held
from groundstation.recording.mcap_schemas import (
    COMMAND_TOPIC,
    ENTRY_TOPICS,
    EVENTS_TOPIC,
    RAW_DEFINITION,
    RAW_TOPIC,
    SAMPLE_FIELDS,
    SAMPLES_DEFINITION,
    SAMPLES_TOPIC,
    STATISTICS_TOPIC,
    TABLE_PREFIX,
    Definition,
    TableColumns,
    decode_entry,
)
from groundstation.recording.session import UNUSUAL, Recording
from groundstation.telemetry.packet import PACKET_BYTES, TICK_S
from groundstation.telemetry.samples import RawBatch, SampleBatch, empty_samples
from groundstation.text import some

_NAN = struct.pack("<f", float("nan"))
_DOUBLE = struct.Struct("<d")
_NAMED_TOPICS = 5

Sink = Callable[[memoryview], None]
"""Takes a message's payload. Raises ValueError where it does not decode."""


def read_mcap(path: Path, *, raw: bool = False) -> Recording:
    """Read a recording: decoded samples and entries, with ``raw`` the packets as received too.

    Every chunk is checked against its CRC. A torn or damaged file gives what is good, with a
    line in ``damage`` for each thing that is not; that one which is being written has no end yet is
    none. Device ticks of a different length than the
    file's first (another link took over) are rescaled to it and rounded, at most half a tick.

    Raises BadInputError where there is no such file; RecordingError where it cannot be read,
    is empty, is no MCAP file, or is one of another program.
    """
    being_written = False
    with contextlib.suppress(OSError):
        being_written = is_held(path)
    with McapScan(path) as scan:
        topics = _Topics(scan, raw)
        for channel_id, _, _, payload in scan.messages():
            topics.add(channel_id, payload)
        topics.require_ours()
        damage = [
            one.line(scan.start_ns)
            for one in scan.damage
            if not (being_written and scan.is_at_end(one))
        ]
    metadata: dict[str, dict[str, str]] = {}
    for name, items in scan.metadata:
        if name != CHANNELS_METADATA:
            metadata.setdefault(name, {}).update(items)
    return Recording(
        path=path,
        kind="mcap",
        samples=topics.samples.batch(),
        raw=topics.packets.batch() if raw else None,
        commands=topics.entries[COMMAND_TOPIC],
        events=topics.entries[EVENTS_TOPIC],
        statistics=topics.entries[STATISTICS_TOPIC],
        tables={name: columns.table() for name, columns in topics.tables.items()},
        metadata=metadata,
        damage=damage + topics.damage(),
        being_written=being_written,
    )


class ForeignMcapError(RecordingError):
    """An MCAP file of another program, which may be a ROS bag all the same."""


class RawStream:
    """The packets of a recording in order, in memory for a few thousand at a time.

    first_ticks: device time of the first sample, known once a batch has come.
    damage: complete when ``batches`` has ended.

    Raises as ``read_mcap``.
    """

    def __init__(self, path: Path, *, batch_packets: int = 4096) -> None:
        self._path = path
        self._batch_packets = batch_packets
        self.first_ticks: int | None = None
        self.damage: list[str] = []

    def batches(self) -> Iterator[RawBatch]:
        """Batches of about ``batch_packets``; nothing for a recording without packets."""
        with McapScan(self._path) as scan:
            topics = _Topics(scan, raw=True)
            for channel_id, _, _, payload in scan.messages():
                topic = scan.topic(channel_id)
                if topic == RAW_TOPIC:
                    topics.add(channel_id, payload)
                    if len(topics.packets) >= self._batch_packets:
                        yield topics.packets.take()
                elif topic == SAMPLES_TOPIC and self.first_ticks is None:
                    topics.add(channel_id, payload)
                    self.first_ticks = int(topics.samples.batch().ticks[0])
            topics.require_ours()
            self.damage = [*(damage.line(scan.start_ns) for damage in scan.damage)]
            self.damage += topics.damage()
            if len(topics.packets):
                yield topics.packets.take()


class _Topics:
    """Sends each message to where its topic is collected."""

    def __init__(self, scan: McapScan, raw: bool) -> None:
        self.samples = _SampleColumns()
        self.packets = _RawColumns()
        self.entries: dict[str, list[dict[str, Any]]] = {topic: [] for topic in ENTRY_TOPICS}
        self.tables: dict[str, TableColumns] = {}
        self._scan = scan
        self._raw = raw
        self._sinks: dict[int, Sink | None] = {}
        self._faults: Counter[tuple[str, str]] = Counter()
        if scan.channels:
            self.require_ours()  # at once where the index tells, before reading it all

    def add(self, channel_id: int, payload: memoryview) -> None:
        if channel_id not in self._sinks:
            self._sinks[channel_id] = self._sink(self._scan.channels[channel_id])
        sink = self._sinks[channel_id]
        if sink is not None:
            try:
                sink(payload)
            except ValueError as error:
                self._faults[self._scan.topic(channel_id), str(error)] += 1

    def require_ours(self) -> None:
        """Raises RecordingError where none of the project's topics is in the file."""
        topics = sorted(channel.topic for channel in self._scan.channels.values())
        ours = {RAW_TOPIC, SAMPLES_TOPIC}
        if self._scan.is_ours:  # a recovery of another program's file is not ours to read
            ours.update(ENTRY_TOPICS)
            if not topics:
                return
        if not ours.isdisjoint(topics):
            return
        raise ForeignMcapError(
            f"{self._scan.path}: an MCAP file of another program, without {SAMPLES_TOPIC} and "
            f"{RAW_TOPIC} (its topics: {some(topics, _NAMED_TOPICS) or 'none'}); ROS bags are"
            " read, other messages as CSV with a column map"
        )

    def damage(self) -> list[str]:
        return [
            f"{topic}: {count} messages could not be decoded: {reason}"
            for (topic, reason), count in self._faults.items()
        ]

    def _sink(self, channel: Channel) -> Sink | None:
        """What takes the messages of ``channel``; None where nobody wants them."""
        topic = channel.topic
        if topic in self.entries:
            self._require(channel, channel.message_encoding in ("json", "cdr"))
            entries = self.entries[topic]
            return lambda payload: entries.append(decode_entry(payload))
        schema = self._scan.schemas.get(channel.schema_id)
        try:
            if topic == SAMPLES_TOPIC:
                return self.samples.sink(self._definition(channel, schema, SAMPLES_DEFINITION))
            if topic == RAW_TOPIC:
                sink = self.packets.sink(self._definition(channel, schema, RAW_DEFINITION))
                return sink if self._raw else None
            if topic.startswith(TABLE_PREFIX) and schema is not None:
                name = topic.removeprefix(TABLE_PREFIX)
                return self.tables.setdefault(name, TableColumns(channel, schema)).add
        except ValueError as error:
            raise RecordingError(f"{self._scan.path}: {topic}: {error}") from error
        return None

    def _definition(self, channel: Channel, schema: Schema | None, ours: Definition) -> Definition:
        """The definition in the file, which must have every field of ours."""
        self._require(
            channel,
            schema is not None
            and (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg"),
        )
        assert schema is not None
        definition = Definition.parse(schema.data.decode())
        for field in ours.fields:
            if field not in definition.fields and field.name not in UNUSUAL:
                raise ValueError(f"has no {field.name} of type {field.dtype}; not ours to read")
        return definition

    def _require(self, channel: Channel, good: bool) -> None:
        if not good:
            raise RecordingError(
                f"{self._scan.path}: {channel.topic} is not in the layout of a recording "
                f"(message encoding {channel.message_encoding!r})"
            )


class _SampleColumns:
    """Columns of the decoded samples, growing in place."""

    def __init__(self) -> None:
        self._tick_s: float | None = None
        self._columns = {column: bytearray() for column in SAMPLE_FIELDS}
        self._types = {field.name: field.dtype for field in SAMPLES_DEFINITION.fields}

    def sink(self, definition: Definition) -> Sink:
        """What takes messages of ``definition``."""
        places = {field.name: place for place, field in enumerate(definition.fields)}
        plan = [
            (places[name], width * self._types[name].itemsize, self._columns[column])
            for column, (name, width) in SAMPLE_FIELDS.items()
            if name in places
        ]
        none_of = [(self._columns[n], SAMPLE_FIELDS[n][1]) for n in UNUSUAL if n not in places]
        tick, ticks = places["tick_s"], places["ticks"]
        empty = [(places[n], SAMPLE_FIELDS[n][1]) for n in UNUSUAL if n in places]

        def add(payload: memoryview) -> None:
            parts = definition.slices(payload)
            rows = len(parts[ticks]) // 8
            for place, width in empty:
                if not len(parts[place]):
                    parts[place] = memoryview(_NAN * (width * rows))
            for place, row_bytes, _ in plan:
                if len(parts[place]) != rows * row_bytes:
                    raise ValueError(
                        f"{definition.fields[place].name} does not have one row per sample"
                    )
            parts[ticks] = self._rescaled(parts[ticks], parts[tick])
            for place, _, column in plan:
                column += parts[place]
            for column, width in none_of:
                column += _NAN * (width * rows)

        return add

    def _rescaled(self, ticks: memoryview, tick_s: memoryview) -> memoryview:
        """``ticks`` in units of the file's first tick length."""
        length_s: float = _DOUBLE.unpack(tick_s)[0]
        if self._tick_s is None:
            self._tick_s = length_s
        if length_s == self._tick_s:
            return ticks
        counts = np.frombuffer(ticks, "<i8")
        return memoryview(np.rint(counts * (length_s / self._tick_s)).astype("<i8").tobytes())

    def batch(self) -> SampleBatch:
        if self._tick_s is None:
            return empty_samples(0, TICK_S)
        arrays: dict[str, Any] = {}
        for column, (name, width) in SAMPLE_FIELDS.items():
            values = np.frombuffer(self._columns[column], self._types[name])
            arrays[column] = values if width == 1 else values.reshape(-1, width)
        return SampleBatch(**arrays, tick_s=self._tick_s)


class _RawColumns:
    """Packets as received, growing in place."""

    def __init__(self) -> None:
        self._times, self._packets = bytearray(), bytearray()

    def __len__(self) -> int:
        return len(self._times) // 8

    def take(self) -> RawBatch:
        """What has come so far, and start anew."""
        batch = self.batch()
        self._times, self._packets = bytearray(), bytearray()
        return batch

    def sink(self, definition: Definition) -> Sink:
        """What takes messages of ``definition``."""
        names = [field.name for field in definition.fields]
        times, packets = names.index("host_time_ns"), names.index("packets")

        def add(payload: memoryview) -> None:
            parts = definition.slices(payload)
            if len(parts[packets]) * 8 != len(parts[times]) * PACKET_BYTES:
                raise ValueError("packets and host times differ in number")
            self._times += parts[times]
            self._packets += parts[packets]

        return add

    def batch(self) -> RawBatch:
        return RawBatch(
            np.frombuffer(self._packets, np.uint8).reshape(-1, PACKET_BYTES),
            np.frombuffer(self._times, "<i8"),
        )
