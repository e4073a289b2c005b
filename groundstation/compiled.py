"""How kernels are compiled: without the interpreter lock, and kept by the content of their sources.

What numba compiled is kept in the user's cache folder under the hash of all sources that it was
made of: the file of the kernel and what that file imports, and so on. So a copy of the program, an
older state of it and a newer one share what they have in common, and nothing stale is ever used.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.core import sigutils
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.ccallback import CFunc

from groundstation import compiling

Function = TypeVar("Function", bound=Callable[..., Any])
CACHE = "NUMBA_CACHE_DIR"
"""Environment variable: a folder of the user's choice for compiled code, taken as it is."""
KEPT_DAYS = 60
"""What no program has used for so long is removed when something new is compiled."""
ROOT = Path(__file__).parents[1]
PACKAGES = ("groundstation", "firmware_sim")


def inner(function: Function) -> Function:
    """A piece of a kernel: cached as part of the kernel that calls it, and inlined there.

    It can be called from kernels only: without the entry for the interpreter it compiles faster.
    """
    compiled: Function = njit(
        nogil=True,
        error_model="numpy",
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        forceinline=True,
    )(function)
    return compiled


def called(function: Function) -> Function:
    """A piece that is compiled once and called, where copies of it would cost more than calls."""
    compiled: Function = njit(
        nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True
    )(function)
    return compiled


def spliced(function: Function) -> Function:
    """A piece that takes arrays, in an innermost loop: put into the caller before it is compiled,
    so that no array is counted as used again; dearer to compile with every use."""
    compiled: Function = njit(nogil=True, error_model="numpy", inline="always")(function)
    return compiled


def kernel(function: Callable[..., Any], fastmath: bool = False) -> Any:
    """An entry point, cached on disk."""
    compiled: Any = njit(nogil=True, error_model="numpy", fastmath=fastmath)(function)
    compiled._cache = _ContentCache(function)
    return compiled


def callback(function: Callable[..., Any], signature: Any, cached: bool) -> Any:
    """Code to call by address. cached: on disk, as kernels are, under the function's own name; only
    for what is made of the program's own sources."""
    options = {"error_model": "numpy"}
    compiled: Any = CFunc(function, sigutils.normalize_signature(signature), {}, options)
    if cached:
        compiled._cache = _ContentCache(function)
    compiled.compile()
    return compiled


class _ContentLocator(_CacheLocator):
    """A folder for each content of a kernel's sources."""

    def __init__(self, stamp: str) -> None:
        self._path, self._stamp = cache_folder() / stamp, stamp

    def get_cache_path(self) -> str:
        return str(self._path)

    def ensure_cache_path(self) -> None:
        if not self._path.is_dir():
            _remove_unused(self._path.parent)
            self._path.mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return ""

    @classmethod
    def from_function(cls, function: Any, file: str) -> _ContentLocator:
        return cls(source_stamp(Path(file)))


class _ContentImpl(CompileResultCacheImpl):
    _locator_classes = (_ContentLocator,)


class _ContentCache(FunctionCache):
    _impl_class = _ContentImpl

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        kept = super().load_overload(sig, target_context)
        if kept is None:
            compiling.begin(self._name)
        return kept

    def save_overload(self, sig: Any, data: Any) -> None:
        super().save_overload(sig, data)
        compiling.end(self._name)


@cache
def source_stamp(file: Path) -> str:
    """Changes with a source file and with all that it imports from this program."""
    digest, seen, due = hashlib.sha256(Path(__file__).read_bytes()), {file}, [file]
    while due:
        for found in _imported(due.pop()):
            if found not in seen:
                seen.add(found)
                due.append(found)
    for path in sorted(seen):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:24]


_IMPORT = re.compile(
    rf"^\s*from ((?:{'|'.join(PACKAGES)})[\w.]*) import (\([^)]*\)|.*)$", re.MULTILINE
)


@cache
def _imported(file: Path) -> tuple[Path, ...]:
    """Files of this program that a file imports; all of a package that it takes as a whole."""
    return tuple(
        path
        for module, names in _IMPORT.findall(file.read_text(encoding="utf-8"))
        for name in re.findall(r"(\w+)(?: as \w+)?,?", re.sub(r"#.*", "", names))
        for path in _sources(module.replace(".", "/"), name)
    )


def _sources(module: str, name: str) -> Iterator[Path]:
    for place in (ROOT / module / name, ROOT / module):
        if (file := place.with_suffix(".py")).is_file():
            return iter((file,))
        if place.is_dir() and place.name == name:
            return iter(sorted(place.rglob("*.py")))
    return iter(())


@cache
def cache_folder() -> Path:
    """Where compiled code is kept: the user's cache folder, or where that cannot be written a
    private one for temporary files. Whoever can write it can run code here: it is the user's alone.
    """
    if chosen := os.environ.get(CACHE):
        return Path(chosen)
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser(), "groundstation")
    temporary = Path(tempfile.gettempdir(), f"groundstation-{os.getuid()}")
    for folder in (users, temporary):
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            found = folder.lstat()
            private = stat.S_ISDIR(found.st_mode) and not found.st_mode & 0o022
            if private and found.st_uid == os.getuid() and os.access(folder, os.W_OK):
                return folder / "kernels"
        except OSError:
            continue
    return Path(tempfile.mkdtemp(prefix="groundstation-"), "kernels")


def _remove_unused(folder: Path) -> None:
    """Forget kernels that no program has read for a long time."""
    oldest_s = time.time() - KEPT_DAYS * 86_400
    for kept in folder.glob("*"):
        try:
            used_s = max((one.stat().st_atime for one in kept.iterdir()), default=0.0)
            if max(used_s, kept.stat().st_mtime) < oldest_s:
                shutil.rmtree(kept, ignore_errors=True)
        except OSError:  # another program removes it at this moment
            continue
