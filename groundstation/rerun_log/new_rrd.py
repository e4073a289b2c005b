"""A new .rrd file: whole under its name, or not there at all."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
from groundstation.rerun_log.channels import DEVICE_TIME
from groundstation.rerun_log.installed import require_rerun

ROWS_PER_CHUNK = 4096


@contextlib.contextmanager
def fresh_rrd(path: Path) -> Iterator[Path]:
    """Within the block, write to the file it gives; in the end that becomes the new ``path``.

    Raises BadInputError when ``path`` exists, its folder does not or rerun is not installed,
    RecordingError when the file could not be written completely; nothing half-written is left
    behind.
    """
    require_rerun(f"{path}: an .rrd file")
    if path.exists():
        raise BadInputError(taken(path))
    if not path.parent.is_dir():
        raise BadInputError(f"{path.parent} is not a folder: create it first")
    os.environ.setdefault("RUST_LOG", "off")  # what goes wrong is raised, and said once
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        _require_footer(part)
        os.link(part, path)  # unlike a rename, fails when the name was taken meanwhile
    except FileExistsError as error:
        raise BadInputError(taken(path)) from error
    except (OSError, RuntimeError, ValueError) as error:
        raise RecordingError(
            f"{path} could not be written ({_first_line(error)}): is there space on the disk?"
        ) from error
    finally:
        part.unlink(missing_ok=True)


def send_series(stream: Any, entity: str, time_s: Any, values: Any) -> None:
    """Log the rows (n,) of a series that are known, by device time; the others are gaps."""
    import rerun as rr

    known = np.flatnonzero(np.isfinite(values))
    for first in range(0, len(known), ROWS_PER_CHUNK):
        rows = known[first : first + ROWS_PER_CHUNK]
        times = np.rint(time_s[rows] * 1e9).astype("timedelta64[ns]")
        stream.send_columns(
            entity,
            indexes=[rr.TimeColumn(DEVICE_TIME, duration=times)],
            columns=rr.Scalars.columns(scalars=values[rows]),
            strict=True,
        )


def _require_footer(path: Path) -> None:
    """Raises RuntimeError for a torn file: rerun's writer may stop without an exception."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it warns of is what it raises
        RrdReader(path).store()


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
