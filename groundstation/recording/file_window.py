"""A file of any size read through one buffer."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from groundstation.errors import BadInputError, RecordingError

_WINDOW = 4 * 1024 * 1024


class FileWindow:
    """Random access to the ``size`` bytes a file had when it was opened.

    Raises BadInputError where there is no such file, RecordingError where it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError as error:
            raise BadInputError(f"{path}: no such file") from error
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
        status = os.fstat(self._fd)
        if not stat.S_ISREG(status.st_mode):
            self.close()
            raise BadInputError(f"{path}: not a file; give the recording itself")
        self.size = status.st_size
        self._buffer = b""
        self._start = 0

    def view(self, offset: int, length: int) -> memoryview:
        """``length`` bytes that the file has; stays valid when the window moves on."""
        at = offset - self._start
        if at < 0 or at + length > len(self._buffer):
            self._buffer = self._read(offset, max(length, _WINDOW))
            self._start, at = offset, 0
            if len(self._buffer) < length:
                raise RecordingError(f"{self._path}: became shorter while it was read")
        return memoryview(self._buffer)[at : at + length]

    def find(
        self, patterns: tuple[bytes, ...], start: int, stop: int
    ) -> Iterator[tuple[int, bytes]]:
        """Places of any of ``patterns`` between ``start`` and ``stop``, in order."""
        overlap = max(len(pattern) for pattern in patterns) - 1
        while start < stop:
            block = self._read(start, min(_WINDOW, stop - start) + overlap)
            hits = []
            for pattern in patterns:
                at = block.find(pattern)
                while 0 <= at < _WINDOW:
                    hits.append((start + at, pattern))
                    at = block.find(pattern, at + 1)
            yield from sorted(hits)
            start += _WINDOW

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _read(self, offset: int, length: int) -> bytes:
        try:
            return os.pread(self._fd, length, offset)
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be read: {error.strerror}") from error
