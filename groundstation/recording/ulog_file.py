"""PX4's ULog files: every topic of the log as a series, read by pyulog (extra ``logs``)."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.errors import BadInputError, RecordingError, install
from groundstation.recording.px4_motors import motors_of
from groundstation.recording.series import Series
from groundstation.recording.series_map import read_mapped_series
from groundstation.recording.session import Recording

MAGIC = b"ULog\x01\x12\x35"
US_NS = 1000
HEADER_BYTES = 3
"""Of a message."""


@dataclass(frozen=True, slots=True)
class ULogContent:
    """damage: in words. notes, unclear: what was settled of the motors, and left open by field."""

    series: Sequence[Series]
    damage: Sequence[str]
    notes: Sequence[str]
    unclear: Mapping[str, str]


class _OnlyForward(io.BufferedReader):
    """A file for pyulog, which steps back from the end of a message: where the file ends within it,
    to before its beginning, and again for ever."""

    _message_at = 0

    def read(self, size: int | None = -1, /) -> bytes:
        if size == HEADER_BYTES:
            self._message_at = self.tell()
        return super().read(size)

    def seek(self, offset: int, whence: int = 0, /) -> int:
        if whence == io.SEEK_CUR and self.tell() + offset < self._message_at:
            return super().seek(0, io.SEEK_END)
        return super().seek(offset, whence)


def read_ulog(path: Path, source: str | Path | None = None) -> Recording:
    """Read a ULog by a column map (None: the named one that knows it).

    A topic is a series of its name; of several instances, the first has the plain name and the
    others ``NAME.1``, ``NAME.2``. A quadrotor's motors are ``quadrotor_motors.m1`` to ``m4``.

    Raises BadInputError where no map fits, and as ``content_of``.
    """
    found = content_of(path)
    return read_mapped_series(
        path,
        "ulog",
        found.series,
        source,
        found.damage,
        notes=found.notes,
        unclear=found.unclear,
    )


@np.errstate(invalid="ignore")  # damage may leave a NaN that numpy signals when it is converted
def content_of(path: Path) -> ULogContent:
    """Every topic, and a quadrotor's motors.

    Raises BadInputError where pyulog is not installed, RecordingError where the file does not read.
    """
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    except ImportError as error:
        raise BadInputError(f"{path}: a ULog, which pyulog reads: {install('logs')}") from error
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),  # it prints what it thinks of a file
            _OnlyForward(io.FileIO(path)) as file,
        ):
            log = ULog(file)
    except (
        ULogException,
        OSError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        struct.error,
        AttributeError,
        MemoryError,
    ) as error:
        raise RecordingError(
            f"{path}: a damaged ULog, which cannot be read; copy it from the card again"
        ) from error
    series = []
    for one in log.data_list:
        if "timestamp" not in one.data:  # its definition is damaged
            continue
        time_ns = one.data["timestamp"].astype(np.int64) * US_NS
        order = np.argsort(time_ns, kind="stable")
        name = f"{one.name}.{one.multi_id}" if one.multi_id else one.name
        columns = {field: values[order] for field, values in one.data.items()}
        series.append(Series(name, time_ns[order], columns))
    damage = ["the log is damaged; what was in order was read"] if log.file_corruption else []
    damage += _dropped([int(one.duration) for one in log.dropouts])
    parameters = {
        name: float(value)
        for name, value in log.initial_parameters.items()
        if isinstance(value, (int, float))
    }
    motors = motors_of(series, parameters)
    series += [motors.series] if motors.series is not None else []
    unclear = {"duty": motors.open} if motors.open else {}
    return ULogContent(series, damage, motors.notes, unclear)


def _dropped(durations_ms: list[int]) -> list[str]:
    """A line for all that the logger could not write, none where it could."""
    if not durations_ms:
        return []
    places = f"in {len(durations_ms)} places, the longest {max(durations_ms)} ms"
    where = "in one place" if len(durations_ms) == 1 else places
    return [f"the logger dropped {sum(durations_ms)} ms {where}"]
