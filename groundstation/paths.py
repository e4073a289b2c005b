"""Files by name and by content: names for something new, and whether two hold the same."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from itertools import count
from pathlib import Path

from groundstation.errors import BadInputError

HOLE_TIMES, HOLE_LEAST = 1000, 1 << 20
"""A file so much longer than what the disk has of it is a hole; no compression of a file system
does that to a recording. A shorter one is read in no time, whatever it is."""


def taken(path: Path) -> str:
    """What is said of a new file whose name is taken, with the next one that is free."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    free = next(name for name in names if not name.exists())
    return f"{path} exists already; nothing is ever overwritten: {free.name} is free"


def dated(folder: Path, end: str, time_ns: int) -> Path:
    """A free path in ``folder``: Unix time as UTC to the millisecond, or the next one that is not
    taken, and ``end``."""
    time_ms = time_ns // 1_000_000
    while True:
        stamp = time.strftime("%Y-%m-%dT%H-%M-%S", time.gmtime(time_ms / 1000))
        path = folder / f"{stamp}-{time_ms % 1000:03d}Z_{end}"
        if not os.path.exists(path):  # also where nobody may look: creating it says so
            return path
        time_ms += 1


def require_content(path: Path) -> None:
    """Raises BadInputError for what is no file with content on a disk: a pipe, of which no end may
    come, or a hole, of which the end may be far. Raises OSError."""
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise BadInputError(f"{path}: not a file; give the recording itself")
    there = 512 * status.st_blocks
    if status.st_size > HOLE_LEAST and there * HOLE_TIMES < status.st_size:
        raise BadInputError(
            f"{path}: {status.st_size} bytes, of which the disk has {there}: a copy that was not"
            " finished; copy it again"
        )


def digest(path: Path) -> str:
    """SHA-256 of a file's content. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
