"""Files by name and by content: new names, same content, writing whole or not at all."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import IO

from groundstation.errors import BadInputError, GroundStationError, RecordingError

HOLE_TIMES, HOLE_LEAST = 1000, 1 << 20
"""A file so much longer than what the disk has of it is a hole; no compression of a file system
does that to a recording. A shorter one is read in no time, whatever it is."""


def taken(path: Path) -> str:
    """What is said of a new file whose name is taken, with the next one that is free."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    free = next(name for name in names if not name.exists())
    return f"{path} exists already; nothing is ever overwritten: {free.name} is free"


@contextmanager
def reading(path: Path, kind: type[GroundStationError] = RecordingError) -> Iterator[None]:
    """A block that reads a file: what the system refuses is raised as ``kind``."""
    try:
        yield
    except OSError as error:
        raise kind(f"{path}: cannot be read: {error.strerror}") from error


@contextmanager
def writing(path: Path, kind: type[GroundStationError] = RecordingError) -> Iterator[None]:
    """A block that writes a file: the same; BadInputError where a new file's name is taken."""
    try:
        yield
    except FileExistsError as error:
        raise BadInputError(taken(path)) from error
    except OSError as error:
        raise kind(f"{path}: cannot be written: {error.strerror}") from error


def write_new(path: Path, text: str) -> None:
    """Write a new file. Raises BadInputError where there is one, or it cannot be written."""
    with writing(path, BadInputError), path.open("x", encoding="utf-8") as file:
        file.write(text)


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


@contextmanager
def written_whole(path: Path, *, durable: bool = False) -> Iterator[IO[bytes]]:
    """Open a file whose content appears under ``path`` whole, at the end, or not at all.

    It is written beside ``path`` under a random name. So a link or pipe of either name, which came
    with somebody else's folder, is replaced and not followed. durable: also on the disk then, for
    what must outlive a power cut. Raises OSError.
    """
    beside = path.parent / f".{os.urandom(8).hex()}.new"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(beside, flags, 0o666)
    try:
        with open(descriptor, "wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(descriptor)
        os.replace(beside, path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise
    if durable:
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def write_whole(path: Path, content: bytes | str, *, durable: bool = False) -> None:
    """Write a file as ``written_whole`` does; text is UTF-8. Raises OSError."""
    with written_whole(path, durable=durable) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def digest(path: Path) -> str:
    """SHA-256 of a file's content, of a folder that of its files' names and contents. Raises
    OSError."""
    if path.is_dir():
        files = sorted(one for one in path.rglob("*") if one.is_file())
        lines = [f"{digest(one)}  {one.relative_to(path)}\n" for one in files]
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
