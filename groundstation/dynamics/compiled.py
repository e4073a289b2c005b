"""How kernels are compiled: without the interpreter lock, cached, and never stale."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.core import sigutils
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc

Function = TypeVar("Function", bound=Callable[..., Any])


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


def kernel(function: Callable[..., Any]) -> Any:
    """An entry point, cached on disk.

    Numba checks its cache against the entry point's own file only; here the key also holds
    ``source_stamp``, so that a change in any piece compiles anew.
    """
    compiled: Any = njit(nogil=True, error_model="numpy")(function)
    compiled._cache = _StampedCache(function)
    return compiled


def callback(function: Callable[..., Any], signature: Any, cached: bool) -> Any:
    """Code to call by address. cached: on disk, as kernels are, under the function's own name; only
    for what ``source_stamp`` covers."""
    options = {"error_model": "numpy"}
    compiled: Any = CFunc(function, sigutils.normalize_signature(signature), {}, options)
    if cached:
        compiled._cache = _StampedCache(function)
    compiled.compile()
    return compiled


class _StampedCache(FunctionCache):
    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), source_stamp())


@cache
def source_stamp() -> str:
    """Changes with any source file that compiled code is made of: kernels, laws, constants."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"dynamics.compiled import" in source or path.parent.name == "effects":
            digest.update(source)
    for name in ("law", "effect", "compiled"):
        digest.update((package / "dynamics" / f"{name}.py").read_bytes())
    return digest.hexdigest()[:16]
