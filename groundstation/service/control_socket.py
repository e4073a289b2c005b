"""The control API's listening socket: a Unix socket of its owner's."""

from __future__ import annotations

import fcntl
import os
import socket
import stat
from pathlib import Path

from groundstation.errors import GroundStationError, TakenError
from groundstation.service.config import shared_folder

BACKLOG = 16
PATH_MOST = 107
"""Bytes a Unix socket's address can hold."""


class ControlSocket:
    """The listening socket, held by a lock so that one daemon at a time has it."""

    def __init__(self, path: Path) -> None:
        if len(os.fsencode(path)) > PATH_MOST:
            raise GroundStationError(
                f"control socket {path}: longer than {PATH_MOST} bytes; set a shorter one with "
                "[control] socket or GROUNDSTATION_SOCKET"
            )
        self.path = path
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if path.parent == shared_folder():
                _require_private(path.parent)
            self._lock = _open_lock(path.with_suffix(".lock"))
        except OSError as error:
            raise GroundStationError(f"control socket {path}: {error.strerror}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.read(self._lock, 32).decode(errors="replace").strip()
            os.close(self._lock)
            raise TakenError(
                f"control socket {path} is taken by another groundstation (process {owner}); stop "
                "it, or give this one its own with GROUNDSTATION_SOCKET or [control] socket"
            ) from error
        os.ftruncate(self._lock, 0)
        os.pwrite(self._lock, str(os.getpid()).encode(), 0)
        if path.exists() and not path.is_socket():
            os.close(self._lock)
            raise GroundStationError(f"control socket {path}: is not a socket; choose another path")
        path.unlink(missing_ok=True)  # left by a daemon that was killed: nobody holds the lock
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            self.socket.bind(str(path))
        finally:
            os.umask(before)
        self.socket.listen(BACKLOG)
        self.socket.setblocking(False)

    def close(self) -> None:
        """Remove the socket and release the lock."""
        self.socket.close()
        self.path.unlink(missing_ok=True)
        os.close(self._lock)


def _open_lock(path: Path) -> int:
    """The lock file, made where there is none; nobody else's file, and none of another purpose."""
    lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    found = os.fstat(lock)
    content = os.pread(lock, 32, 0).strip() if stat.S_ISREG(found.st_mode) else b"?"
    if found.st_uid != os.getuid() or (content and not content.isdigit()):
        os.close(lock)
        raise GroundStationError(f"{path}: is no lock file of yours; choose another control socket")
    return lock


def _require_private(folder: Path) -> None:
    """In a folder where anyone can write, someone else may have been there first."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise GroundStationError(
            f"control socket: {folder} is not a folder of yours alone (owner {found.st_uid}, mode "
            f"{stat.S_IMODE(found.st_mode):04o}); remove it, or set GROUNDSTATION_SOCKET"
        )
