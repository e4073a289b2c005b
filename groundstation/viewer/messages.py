"""What the daemon and the feeder say to each other, one message per packet of the socket."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Self

import msgspec
import numpy as np

from groundstation.links.command import LinkEvent
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import COLUMNS, LogTable, SampleBatch, empty_samples

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown


MAX_ROWS = 1000
"""Samples per message: about 100 kB, well below the smallest usual socket buffer."""
MAX_BYTES = 1 << 18


class SamplesMessage(msgspec.Struct, tag="samples", array_like=True):
    tick_s: float
    rows: int
    columns: list[bytes]
    """In the order of ``COLUMNS``, native byte order: both ends are on this machine."""

    @classmethod
    def of(cls, batch: SampleBatch) -> SamplesMessage:
        columns = [np.ascontiguousarray(getattr(batch, name)).tobytes() for name in COLUMNS]
        return cls(batch.tick_s, len(batch), columns)

    def batch(self) -> SampleBatch:
        """The samples, without copying."""
        shapes = empty_samples(0)
        arrays = {}
        for name, data in zip(COLUMNS, self.columns, strict=True):
            like = getattr(shapes, name)
            arrays[name] = np.frombuffer(data, like.dtype).reshape(self.rows, *like.shape[1:])
        return SampleBatch(**arrays, tick_s=self.tick_s)


class EventMessage(msgspec.Struct, tag="event", array_like=True):
    entry: dict[str, Any]


class StatisticsMessage(msgspec.Struct, tag="statistics", array_like=True):
    entry: dict[str, Any]


class TableMessage(msgspec.Struct, tag="table", array_like=True):
    """Rows of a further table: times (n,) int64, Unix ns, and columns (n,) float64, native byte
    order."""

    name: str
    times_ns: bytes
    columns: dict[str, bytes]

    @classmethod
    def of(cls, rows: LogTable) -> Self:
        columns = {
            name: np.ascontiguousarray(values, np.float64).tobytes()
            for name, values in rows.columns.items()
        }
        return cls(rows.name, np.ascontiguousarray(rows.host_time_ns).tobytes(), columns)


class TwinMessage(msgspec.Struct, tag="twin", array_like=True):
    """Measured and predicted (m, 9) SI at device times (m,), and the gap (9,): float64, native
    byte order."""

    segment: int
    rows: int
    time_s: bytes
    measured: bytes
    predicted: bytes
    gap: bytes

    @classmethod
    def of(cls, segment: int, time_s: Array, measured: Array, predicted: Array, gap: Array) -> Self:
        parts = (
            np.ascontiguousarray(each, np.float64).tobytes()
            for each in (time_s, measured, predicted, gap)
        )
        return cls(segment, len(time_s), *parts)

    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """Times, measured, predicted and gap, without copying."""
        return (
            np.frombuffer(self.time_s),
            np.frombuffer(self.measured).reshape(self.rows, -1),
            np.frombuffer(self.predicted).reshape(self.rows, -1),
            np.frombuffer(self.gap),
        )


Note = EventMessage | StatisticsMessage | TableMessage | TwinMessage
Message = SamplesMessage | Note


class Acknowledgement(msgspec.Struct, array_like=True):
    """Feeder to daemon: when the server has taken the first data, then after each message, and
    twice a second without one."""

    taken: int
    """Samples, events and statistics that this feeder has logged so far."""


_encoder = msgspec.msgpack.Encoder(enc_hook=str)
_decoder = msgspec.msgpack.Decoder(Message)
_acknowledgement_decoder = msgspec.msgpack.Decoder(Acknowledgement)


def encode_message(message: Message | Acknowledgement) -> bytes:
    return _encoder.encode(message)


def decode_message(data: bytes) -> Message:
    """Raises ValueError for anything else."""
    try:
        message: Message = _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"not a message of the viewer: {error}") from error
    return message


def decode_acknowledgement(data: bytes) -> Acknowledgement:
    acknowledgement: Acknowledgement = _acknowledgement_decoder.decode(data)
    return acknowledgement


def message_of(
    note: LinkEvent | LinkStatistics | LogTable | Shown,
) -> EventMessage | StatisticsMessage | TableMessage | TwinMessage:
    """What the feeder is told of a note."""
    match note:
        case LinkEvent():
            return EventMessage(asdict(note))
        case LinkStatistics():
            return StatisticsMessage({"time_ns": note.time_ns, **note.gauges()})
        case LogTable():
            return TableMessage.of(note)
    return TwinMessage.of(note.segment, note.time_s, note.measured, note.predicted, note.gap)
