"""What the daemon and the feeder say to each other, one message per packet of the socket."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from groundstation.links.command import LinkEvent
from groundstation.telemetry.decoder import LinkStatistics
from groundstation.telemetry.samples import COLUMNS, LogTable, SampleBatch

if TYPE_CHECKING:
    from groundstation.twin.twin import Shown

MAX_ROWS = 1000
"""Samples per message: about 100 kB, well below the smallest usual socket buffer."""
MAX_BYTES = 1 << 18

Message = tuple[Literal["samples", "event", "statistics", "table", "twin"], dict[str, Any]]
"""Kind and content. Arrays have native byte order: both ends are on this machine."""
_PREDICTIONS = ("time_s", "measured", "predicted", "gap")


class Acknowledgement(msgspec.Struct, array_like=True):
    """Feeder to daemon: when the server has taken the first data, then after each message, and
    twice a second without one. taken: samples and notes that this feeder has logged so far."""

    taken: int


def message_of(content: SampleBatch | LinkEvent | LinkStatistics | LogTable | Shown) -> Message:
    """What the feeder is told of samples or of a note."""
    match content:
        case SampleBatch():
            columns = {name: _packed(getattr(content, name)) for name in COLUMNS}
            return "samples", {"tick_s": content.tick_s, **columns}
        case LinkEvent():
            return "event", asdict(content)
        case LinkStatistics():
            return "statistics", {"time_ns": content.time_ns, **content.gauges()}
        case LogTable(name=name):
            columns = {key: _packed(one, np.float64) for key, one in content.columns.items()}
            times_ns = _packed(content.host_time_ns)
            return "table", {"name": name, "times_ns": times_ns, "columns": columns}
    arrays = {name: _packed(getattr(content, name), np.float64) for name in _PREDICTIONS}
    return "twin", {"segment": content.segment, **arrays}


def samples_in(content: dict[str, Any]) -> SampleBatch:
    """The samples of a message, without copying."""
    columns = {name: unpacked(content[name]) for name in COLUMNS}
    return SampleBatch(**columns, tick_s=content["tick_s"])


def predictions_in(content: dict[str, Any]) -> list[Any]:
    """Device times (m,), measured and predicted (m, 9) SI, and the gap (9,)."""
    return [unpacked(content[name]) for name in _PREDICTIONS]


def _packed(array: Any, kind: Any = None) -> Any:
    array = np.asarray(array, kind)
    return array.dtype.str, array.shape, array.tobytes()


def unpacked(said: Any) -> Any:
    """An array of a message."""
    kind, shape, data = said
    return np.frombuffer(data, kind).reshape(shape)


_encoder = msgspec.msgpack.Encoder(enc_hook=str)
_decoder = msgspec.msgpack.Decoder(Message)
_acknowledgement_decoder = msgspec.msgpack.Decoder(Acknowledgement)


def encode_message(message: Message | Acknowledgement) -> bytes:
    return _encoder.encode(message)


def decode_message(data: bytes) -> Message:
    """Raises ValueError for anything else."""
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"not a message of the viewer: {error}") from error


def decode_acknowledgement(data: bytes) -> Acknowledgement:
    return _acknowledgement_decoder.decode(data)
