"""PX4's ULog files: every topic of the log as a series, read by pyulog (extra ``logs``)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from groundstation.errors import BadInputError, RecordingError, install
from groundstation.recording.series_map import Series, read_mapped_series
from groundstation.recording.session import Recording

MAGIC = b"ULog\x01\x12\x35"
US_NS = 1000


def read_ulog(path: Path, source: str | Path | None = None) -> Recording:
    """Read a ULog by a column map (None: the named one that knows it).

    A topic is a series of its name; of several instances, the first has the plain name and the
    others ``NAME.1``, ``NAME.2``.

    Raises BadInputError where pyulog is not installed or no map fits, RecordingError where the file
    does not read.
    """
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    except ImportError as error:
        raise BadInputError(f"{path}: a ULog, which pyulog reads: {install('logs')}") from error
    try:
        log = ULog(str(path))
    except (
        *(ULogException, OSError, ValueError, TypeError, KeyError, IndexError, struct.error),
        *(AttributeError, MemoryError),
    ) as error:
        raise RecordingError(f"{path}: a ULog that does not read: {error}") from error
    series = []
    for one in log.data_list:
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
    return read_mapped_series(path, "ulog", series, source, damage, parameters=parameters)


def _dropped(durations_ms: list[int]) -> list[str]:
    """A line for all that the logger could not write, none where it could."""
    if not durations_ms:
        return []
    places = f"in {len(durations_ms)} places, the longest {max(durations_ms)} ms"
    where = "in one place" if len(durations_ms) == 1 else places
    return [f"the logger dropped {sum(durations_ms)} ms {where}"]
