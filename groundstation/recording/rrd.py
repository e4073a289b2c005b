"""Recordings as .rrd files: for rerun, with the pilot's layout inside.

A .rrd holds what people look at: samples, events, commands, statistics and the numbers of tables.
It is not read back: the MCAP recording has everything.
"""

from __future__ import annotations

from pathlib import Path

from groundstation.recording.session import Recording
from groundstation.rerun_log.channels import (
    APPLICATION,
    COMMANDS,
    EVENTS,
    TABLES,
    RecordedClock,
    fresh_rrd,
    send_series,
)

ROWS_PER_CHUNK = 4096


def write_rrd(recording: Recording, path: Path) -> None:
    """Write ``recording`` with the pilot's blueprint into a new file.

    Raises BadInputError when ``path`` exists or its folder does not, RecordingError when the
    file could not be written completely; nothing half-written is left behind.
    """
    with fresh_rrd(path) as part:
        _write(recording, part)


def _write(recording: Recording, path: Path) -> None:
    import rerun as rr

    from groundstation.rerun_log.log import ViewerLog, pilot_blueprint

    stream = rr.RecordingStream(APPLICATION, recording_id=recording.path.name)
    clock = RecordedClock(recording.samples)
    layout = pilot_blueprint(window_s=None, tables=bool(recording.tables))
    stream.save(path, default_blueprint=layout)
    stream.send_recording_name(recording.path.name)
    target = ViewerLog(stream, clock)
    target.craft()
    for start in range(0, len(recording.samples), ROWS_PER_CHUNK):
        target.samples(recording.samples[start : start + ROWS_PER_CHUNK])
    target.entries(EVENTS, recording.events)
    target.entries(COMMANDS, recording.commands)
    target.statistics(recording.statistics)
    for name, table in recording.tables.items():
        for column, values in table.columns.items():
            if values.ndim == 1 and values.dtype.kind in "fiub":
                entity = rr.new_entity_path([TABLES, name, column])
                send_series(stream, entity, table.time_s, values.astype(float))
    stream.flush()
    stream.disconnect()
