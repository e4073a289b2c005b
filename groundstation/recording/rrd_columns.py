"""The columns of an .rrd file, read in a process of its own.

rerun neither checks its data nor survives all damage: one flipped byte in a file can abort the
process that reads it (rerun 0.41). ``python -m groundstation.recording.rrd_columns FILE FD`` reads
for ``read_columns`` and writes an .npz to the open file FD.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import RecordingError
from groundstation.rerun_log.channels import HOST_TIME, OWN_PREFIX, SCALARS, SEQUENCE
from groundstation.rerun_log.installed import require_rerun

Columns = dict[str, NDArray[Any]]
"""Component or timeline name -> the values of all rows, one after the other."""

_TEXT = "text "
_DATA = "data "


def read_columns(path: Path) -> dict[str, Columns]:
    """Entity -> its timelines, scalars and own components; text as arrays of objects.

    Raises RecordingError in one line for anything that rerun cannot read, BadInputError where rerun
    is not installed.
    """
    require_rerun(f"{path}: an .rrd file")
    with tempfile.TemporaryFile() as shared:
        command = [sys.executable, "-m", __name__, str(path.resolve()), str(shared.fileno())]
        reader = subprocess.run(
            command, pass_fds=[shared.fileno()], capture_output=True, text=True, check=False
        )
        if reader.returncode < 0:
            raise RecordingError(f"{path} cannot be read: it is damaged")
        if reader.returncode > 0:
            lines = [line for line in reader.stderr.splitlines() if line.strip()]
            reason = lines[-1] if lines else f"exit status {reader.returncode}"
            raise RecordingError(f"{path} cannot be read: {reason}")
        shared.seek(0)
        entities: dict[str, Columns] = {}
        with np.load(shared) as arrays:
            for key in arrays.files:
                kind, (entity, name) = key[: len(_TEXT)], json.loads(key[len(_TEXT) :])
                values = arrays[key]
                if kind == _TEXT:
                    values = np.array(json.loads(values.tobytes()), dtype=object)
                entities.setdefault(entity, {})[name] = values
    return entities


def main(arguments: list[str]) -> int:
    path, descriptor = arguments
    warnings.simplefilter("ignore")  # a live view that was saved has no footer, and needs none
    try:
        columns = _own_columns(path)
    except (OSError, RuntimeError, ValueError) as error:
        print(
            " ".join(str(error).removeprefix(f"Failed to read RRD file at {path}:").split()),
            file=sys.stderr,
        )
        return 1
    arrays = {}
    for (entity, name), parts in columns.items():
        values = np.concatenate(parts)
        kind = _DATA
        if values.dtype == object:
            kind, values = _TEXT, np.frombuffer(json.dumps(values.tolist()).encode(), np.uint8)
        arrays[kind + json.dumps([entity, name])] = values
    with os.fdopen(int(descriptor), "wb") as shared:
        np.savez(shared, **arrays)  # type: ignore[arg-type]  # numpy's stub: allow_pickle
    return 0


def _own_columns(path: str) -> dict[tuple[str, str], list[NDArray[Any]]]:
    from rerun.chunk import RrdReader

    columns: dict[tuple[str, str], list[NDArray[Any]]] = {}
    reader = RrdReader(path)
    for chunk in reader.stream() if reader.recordings() else ():
        batch = chunk.to_record_batch()
        for name, values in zip(batch.schema.names, batch.columns, strict=True):
            if name == SCALARS or name.startswith(OWN_PREFIX):
                values = values.flatten()
            elif name not in (SEQUENCE, HOST_TIME):
                continue
            array = values.to_numpy(zero_copy_only=False)
            columns.setdefault((chunk.entity_path, name), []).append(array)
    return columns


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
