"""How the kernels are compiled: without the interpreter lock, cached, and never stale."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit

from groundstation.dynamics.compiled import source_stamp as laws_stamp

Function = TypeVar("Function", bound=Callable[..., Any])


def inner(function: Function) -> Function:
    """Compile a piece of a kernel; it is cached as part of the kernel that calls it.

    It can be called from kernels only: leaving out the entry for the interpreter saves a fifth
    of the time that the first start takes.
    """
    compiled: Function = njit(
        nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True
    )(function)
    return compiled


def kernel(function: Function) -> Function:
    """Compile an entry point. To be applied inside a builder that closes over ``source_stamp``.

    Numba checks the cache against the entry point's own file only. The stamp, a closure
    variable, becomes part of the cache's key, so that a change in any piece compiles anew.
    """
    compiled: Function = njit(nogil=True, error_model="numpy", cache=True)(function)
    return compiled


@cache
def source_stamp() -> int:
    """A number that changes with any source file that compiled code is made of."""
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(here.rglob("*.py")):
        source = path.read_bytes()
        if b"from firmware_sim.compiled import" in source or path.name in _CONSTANTS:
            digest.update(source)
    digest.update(laws_stamp().encode())  # the chains of laws that are called by address
    return int.from_bytes(digest.digest()[:6], "little")


_CONSTANTS = ("layout.py", "compiled.py")
"""Files whose constants are compiled in."""
