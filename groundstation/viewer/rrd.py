"""Recordings as .rrd files: for rerun, with the pilot's layout inside, and back again exactly.

A .rrd holds the decoded samples, events, commands, statistics, tables and metadata. The raw
packets (every copy as received) stay in the MCAP recording.
"""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.samples import SampleBatch, empty_samples

SCHEMA_VERSION = 1
SESSION = "/session"
SESSION_ARCHETYPE = "groundstation.Session"
TABLE_ARCHETYPE = "groundstation.Table"
ROWS_PER_CHUNK = 4096

Columns = dict[str, NDArray[Any]]
"""Component or timeline name -> the values of all rows, one after the other."""


def write_rrd(recording: Recording, path: Path) -> None:
    """Write ``recording`` with the pilot's blueprint into a new file.

    Raises BadInputError when ``path`` exists or its folder does not, RecordingError when the
    file could not be written completely; nothing half-written is left behind.
    """
    if path.exists():
        raise BadInputError(f"{path} exists already: choose another name or remove it")
    if not path.parent.is_dir():
        raise BadInputError(f"{path.parent} is not a folder: create it first")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        _write(recording, part)
        os.link(part, path)  # unlike a rename, fails when the name was taken meanwhile
    except FileExistsError as error:
        raise BadInputError(f"{path} exists already: choose another name or remove it") from error
    except (OSError, RuntimeError) as error:
        raise RecordingError(f"{path} could not be written: {_first_line(error)}") from error
    finally:
        part.unlink(missing_ok=True)


def read_rrd(path: Path) -> Recording:
    """Read a file that ``write_rrd`` wrote, or a live view that was saved from the viewer.

    The samples are exact in every bit. Raises RecordingError for a damaged file, a file that is
    not .rrd and an .rrd of another program, BadInputError when there is no such file.
    """
    if not path.is_file():
        raise BadInputError(f"{path} is not a file: give the path of an .rrd recording")
    from groundstation.viewer import log

    entities = _read_entities(path)
    session = entities.get(SESSION, {}).get(f"{SESSION_ARCHETYPE}:json")
    if session is None and log.PACKET not in entities:
        raise RecordingError(
            f"{path} was not written by groundstation: open it in the rerun viewer instead"
        )
    head: dict[str, Any] = json.loads(session[0]) if session is not None else {}
    if head.get("schema_version", SCHEMA_VERSION) > SCHEMA_VERSION:
        raise RecordingError(
            f"{path} has format {head['schema_version']}, but this program reads up to "
            f"{SCHEMA_VERSION}: install a newer groundstation"
        )
    return Recording(
        path=path,
        kind="rrd",
        samples=_samples(path, entities),
        commands=_entries(entities, log.COMMANDS),
        events=_entries(entities, log.EVENTS),
        statistics=_entries(entities, log.LINK),
        tables={
            name: _table(entities[table["entity"]], table["types"])
            for name, table in head.get("tables", {}).items()
        },
        metadata=head.get("metadata", {}),
    )


def _write(recording: Recording, path: Path) -> None:
    import rerun as rr

    from groundstation.viewer import log
    from groundstation.viewer.blueprint import pilot_blueprint
    from groundstation.viewer.device_clock import RecordedClock

    stream = rr.RecordingStream(log.APPLICATION, recording_id=recording.path.name)
    stream.save(path, default_blueprint=pilot_blueprint(window_s=None))
    stream.send_recording_name(recording.path.name)
    head: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "metadata": recording.metadata,
        "tables": {},
    }
    target = log.ViewerLog(stream, RecordedClock(recording.samples))
    target.craft()
    for start in range(0, len(recording.samples), ROWS_PER_CHUNK):
        target.samples(recording.samples[start : start + ROWS_PER_CHUNK], start)
    target.entries(log.EVENTS, recording.events)
    target.entries(log.COMMANDS, recording.commands)
    target.statistics(recording.statistics)
    for name, table in recording.tables.items():
        entity = rr.new_entity_path(["tables", name])
        types = {column: values.dtype.str for column, values in table.columns.items()}
        head["tables"][name] = {"entity": entity, "types": types}
        times = np.rint(table.time_s * 1e9).astype("timedelta64[ns]")
        components = {f"value {column}": values for column, values in table.columns.items()}
        stream.send_columns(
            entity,
            indexes=[rr.TimeColumn(log.DEVICE_TIME, duration=times)],
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
    _check_complete(path)


def _check_complete(path: Path) -> None:
    """A full disk stops rerun's writer without an exception: look for the file's footer."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the missing footer is the error that is raised here
        try:
            RrdReader(path).store()
        except (OSError, RuntimeError, ValueError) as error:
            raise RecordingError(
                f"{path.parent}: the recording was cut short; is there space on the disk?"
            ) from error


def _read_entities(path: Path) -> dict[str, Columns]:
    """Every entity with its timelines, scalars and own components; all of the file is checked."""
    from rerun.chunk import RrdReader

    pieces: dict[str, dict[str, list[NDArray[Any]]]] = {}
    with warnings.catch_warnings():
        # a live view that was saved from the viewer has no footer, and needs none
        warnings.simplefilter("ignore")
        try:
            reader = RrdReader(path)
            for chunk in reader.stream() if reader.recordings() else ():
                batch = chunk.to_record_batch()
                columns = pieces.setdefault(chunk.entity_path, {})
                for name, values in zip(batch.schema.names, batch.columns, strict=True):
                    if name == "Scalars:scalars" or name.startswith("groundstation."):
                        values = values.flatten()
                    elif name not in ("seq", "host_time"):
                        continue
                    columns.setdefault(name, []).append(values.to_numpy(zero_copy_only=False))
        except (OSError, RuntimeError, ValueError) as error:
            raise RecordingError(f"{path} cannot be read: {_first_line(error)}") from error
    return {
        entity: {name: np.concatenate(parts) for name, parts in columns.items()}
        for entity, columns in pieces.items()
    }


def _samples(path: Path, entities: dict[str, Columns]) -> SampleBatch:
    from groundstation.viewer import log

    packet = entities.get(log.PACKET)
    if packet is None:
        return empty_samples(0)
    seq = packet[log.SEQUENCE]
    order = np.argsort(seq, kind="stable")
    prefix = f"{log.PACKET_ARCHETYPE}:"
    ticks_s = np.unique(packet[f"{prefix}tick_s"])
    if len(ticks_s) > 1:
        raise RecordingError(
            f"{path} mixes sources with different clocks: save one source at a time"
        )
    samples = empty_samples(len(seq), float(ticks_s[0]))
    samples.host_time_ns[:] = packet[log.HOST_TIME][order].astype(np.int64)
    for name in log.PACKET_COLUMNS:
        getattr(samples, name)[:] = packet[prefix + name][order]
    for group in log.GROUPS:
        shown = entities.get(group.entity, {})
        if "Scalars:scalars" in shown:
            rows = np.searchsorted(seq[order], shown[log.SEQUENCE])
            target = getattr(samples, group.column)
            values = shown["Scalars:scalars"].reshape(-1, *target.shape[1:])
            target[rows] = log.unscaled(group, values)
    return samples


def _entries(entities: dict[str, Columns], entity: str) -> list[dict[str, Any]]:
    from groundstation.viewer import log

    columns = entities.get(entity, {})
    texts = columns.get(f"{log.ENTRY_ARCHETYPE}:json")
    if texts is None:
        return []
    order = np.argsort(columns[log.HOST_TIME], kind="stable")
    return [json.loads(texts[row]) for row in order]


def _table(columns: Columns, types: dict[str, str]) -> Table:
    return Table(
        time_s=columns[f"{TABLE_ARCHETYPE}:time_s"],
        columns={
            name: columns[f"{TABLE_ARCHETYPE}:value {name}"].astype(dtype)
            for name, dtype in types.items()
        },
    )


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
