"""Recordings as .rrd files: for rerun, with the pilot's layout inside, and back again exactly.

A .rrd holds the decoded samples, events, commands, statistics, tables and metadata. The raw
packets (every copy as received) stay in the MCAP recording.
"""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.documents import require_shallow
from groundstation.errors import BadInputError, DamagedRecordingError, RecordingError
from groundstation.recording.rrd_columns import Columns, read_columns
from groundstation.recording.session import Recording, Table
from groundstation.rerun_log.channels import (
    APPLICATION,
    COMMANDS,
    DEVICE_TIME,
    ENTRY_ARCHETYPE,
    EVENTS,
    GROUPS,
    HOST_TIME,
    LINK,
    PACKET,
    PACKET_ARCHETYPE,
    PACKET_COLUMNS,
    SCALARS,
    SEQUENCE,
    unscaled,
)
from groundstation.rerun_log.device_clock import RecordedClock
from groundstation.rerun_log.new_rrd import fresh_rrd
from groundstation.telemetry.samples import COLUMNS, SampleBatch, empty_samples

SCHEMA_VERSION = 1
SESSION = "/session"
SESSION_ARCHETYPE = "groundstation.Session"
TABLE_ARCHETYPE = "groundstation.Table"
ROWS_PER_CHUNK = 4096


def write_rrd(recording: Recording, path: Path) -> None:
    """Write ``recording`` with the pilot's blueprint into a new file.

    Raises BadInputError when ``path`` exists or its folder does not, RecordingError when the
    file could not be written completely; nothing half-written is left behind.
    """
    with fresh_rrd(path) as part:
        _write(recording, part)


def read_rrd(path: Path) -> Recording:
    """Read a file that ``write_rrd`` wrote, or a live view that was saved from the viewer.

    The samples are exact in every bit. Raises RecordingError for a damaged file (a saved live
    view has no checksum), a file that is not .rrd and an .rrd of another program, BadInputError
    when there is no such file.
    """
    if not path.is_file():
        raise BadInputError(f"{path} is not a file: give the path of an .rrd recording")
    entities = read_columns(path)
    if SESSION not in entities and PACKET not in entities:
        raise RecordingError(
            f"{path} was not written by groundstation: open it in the rerun viewer instead"
        )
    try:
        return _recording(path, entities)
    except (LookupError, ValueError, TypeError) as error:
        raise DamagedRecordingError(
            f"{path} is damaged: its parts do not fit together; convert the original again"
        ) from error


def _recording(path: Path, entities: dict[str, Columns]) -> Recording:
    """Raises LookupError, ValueError or TypeError where parts are missing or do not fit."""
    session = entities.get(SESSION)
    head = _loads(session[f"{SESSION_ARCHETYPE}:json"][0]) if session else {}
    if head.get("schema_version", SCHEMA_VERSION) > SCHEMA_VERSION:
        raise RecordingError(
            f"{path} has format {head['schema_version']}, but this program reads up to "
            f"{SCHEMA_VERSION}: install a newer groundstation"
        )
    recording = Recording(
        path=path,
        kind="rrd",
        samples=_samples(path, entities),
        commands=_entries(entities, COMMANDS),
        events=_entries(entities, EVENTS),
        statistics=_entries(entities, LINK),
        tables={
            name: _table(entities[table["entity"]], table["types"])
            for name, table in head.get("tables", {}).items()
        },
        metadata=head.get("metadata", {}),
    )
    if head and head["checksum"] != _checksum(recording):
        raise DamagedRecordingError(
            f"{path} is damaged: its checksum does not fit; convert the original again"
        )
    return recording


def _write(recording: Recording, path: Path) -> None:
    import rerun as rr

    from groundstation.rerun_log.blueprint import pilot_blueprint
    from groundstation.rerun_log.log import ViewerLog

    stream = rr.RecordingStream(APPLICATION, recording_id=recording.path.name)
    clock = RecordedClock(recording.samples)
    take_off_ns = clock.take_off_ns()
    layout = pilot_blueprint(window_s=None, from_take_off=take_off_ns is not None)
    stream.save(path, default_blueprint=layout)
    stream.send_recording_name(recording.path.name)
    head: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "checksum": _checksum(recording),
        "metadata": recording.metadata,
        "tables": {},
    }
    target = ViewerLog(stream, clock, take_off_ns)
    target.craft()
    for start in range(0, len(recording.samples), ROWS_PER_CHUNK):
        target.samples(recording.samples[start : start + ROWS_PER_CHUNK], start)
    target.entries(EVENTS, recording.events)
    target.entries(COMMANDS, recording.commands)
    target.statistics(recording.statistics)
    for name, table in recording.tables.items():
        entity = rr.new_entity_path(["tables", name])
        types = {column: values.dtype.str for column, values in table.columns.items()}
        head["tables"][name] = {"entity": entity, "types": types}
        times = np.rint(table.time_s * 1e9).astype("timedelta64[ns]")
        components = {f"value {column}": values for column, values in table.columns.items()}
        stream.send_columns(
            entity,
            indexes=[rr.TimeColumn(DEVICE_TIME, duration=times)],
            columns=rr.DynamicArchetype.columns(
                TABLE_ARCHETYPE, components={"time_s": table.time_s, **components}
            ),
            strict=True,
        )
    text = json.dumps(head, default=str)
    stream.log(
        SESSION,
        rr.DynamicArchetype(SESSION_ARCHETYPE, components={"json": text}),
        static=True,
        strict=True,
    )
    stream.flush()
    stream.disconnect()


def _checksum(recording: Recording) -> int:
    """CRC-32 of all that is read back: rerun has none over the data and returns flipped bits."""
    crc = 0
    samples = recording.samples
    arrays = [getattr(samples, name) for name in COLUMNS]
    for table in recording.tables.values():
        arrays += [table.time_s, *table.columns.values()]
    for array in arrays:
        if array.dtype.kind == "f":  # all NaN are the same
            array = np.where(np.isnan(array), np.array(np.nan, array.dtype), array)
        crc = zlib.crc32(np.ascontiguousarray(array).tobytes(), crc)
    text = [
        *[
            sorted(entries, key=_entry_time)
            for entries in (recording.events, recording.commands, recording.statistics)
        ],
        recording.metadata,
        {name: list(table.columns) for name, table in recording.tables.items()},
    ]
    return zlib.crc32(json.dumps(text, default=str).encode(), crc)


def _entry_time(entry: dict[str, Any]) -> int:
    return int(entry["time_ns"])


def _samples(path: Path, entities: dict[str, Columns]) -> SampleBatch:
    packet = entities.get(PACKET)
    if packet is None:
        return empty_samples(0)
    seq = packet[SEQUENCE]
    order = np.argsort(seq, kind="stable")
    prefix = f"{PACKET_ARCHETYPE}:"
    ticks_s = np.unique(packet[f"{prefix}tick_s"])
    if len(ticks_s) > 1:
        raise RecordingError(
            f"{path} mixes sources with different clocks: save one source at a time"
        )
    samples = empty_samples(len(seq), float(ticks_s[0]))
    samples.host_time_ns[:] = packet[HOST_TIME][order].astype(np.int64)
    for name in PACKET_COLUMNS:
        getattr(samples, name)[:] = packet[prefix + name][order]
    for group in GROUPS:
        shown = entities.get(group.entity, {})
        if SCALARS in shown:
            rows = np.searchsorted(seq[order], shown[SEQUENCE])
            target = getattr(samples, group.column)
            values = shown[SCALARS].reshape(-1, *target.shape[1:])
            target[rows] = unscaled(group, values)
    return samples


def _entries(entities: dict[str, Columns], entity: str) -> list[dict[str, Any]]:
    columns = entities.get(entity, {})
    texts = columns.get(f"{ENTRY_ARCHETYPE}:json")
    if texts is None:
        return []
    order = np.argsort(columns[HOST_TIME], kind="stable")
    return [_loads(texts[row]) for row in order]


def _loads(text: str) -> Any:
    """JSON as ``rerun_log.log`` writes it: with NaN, and file names that are not UTF-8."""
    require_shallow(text.encode("utf-8", "surrogatepass"))
    return json.loads(text)


def _table(columns: Columns, types: dict[str, str]) -> Table:
    return Table(
        time_s=columns[f"{TABLE_ARCHETYPE}:time_s"],
        columns={
            name: columns[f"{TABLE_ARCHETYPE}:value {name}"].astype(dtype)
            for name, dtype in types.items()
        },
    )
