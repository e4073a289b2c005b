"""Where compiled code is kept: a folder that works, and that nobody else can write."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Sequence
from pathlib import Path

CACHE = "NUMBA_CACHE_DIR"


def provide_cache(usual: Sequence[Path] | None = None) -> Path | None:
    """Choose a folder where none of numba's usual ones can be written; None where one can.

    Without a cache numba refuses to compile, and whoever can
    write one can run code here: the folder is the user's alone.
    """
    if os.environ.get(CACHE):
        return None
    if usual is None:
        usual = [Path(__file__).parent / "__pycache__", _users() / "numba"]
    if any(map(_can_be_written, usual)):
        return None
    import tempfile  # seldom needed, and slow

    folder = Path(tempfile.gettempdir()) / f"groundstation-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        private = stat.S_ISDIR(found.st_mode) and not found.st_mode & 0o077
        if not (private and found.st_uid == os.getuid()):
            raise PermissionError
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="groundstation-"))
    os.environ[CACHE] = str(folder / "numba")
    if "numba" in sys.modules:
        sys.modules["numba.core.config"].reload_config()
    return folder / "numba"


def _users() -> Path:
    """The user's folder for caches (XDG)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path(os.path.expanduser("~")) / ".cache")


def _can_be_written(folder: Path) -> bool:
    """Whether a file can be made there; nothing but the attempt tells on every file system."""
    trial = folder / f".{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.close(os.open(trial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
        trial.unlink()
    except OSError:
        return False
    return True
