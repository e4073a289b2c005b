"""What the C library (glibc) keeps of freed memory; with another one nothing is changed."""

from __future__ import annotations

import contextlib
import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # malloc.h
KEPT_BYTES = 32 << 20
"""The most that malloc accepts as a threshold of blocks, and more than any of a minute's flight."""


def keep_freed() -> None:
    """Keep freed blocks of up to 32 MB for the next ones.

    By default arrays of a flight's rows are mapped, faulted in page by page and given back one by
    one: of a body fit on one minute that was a quarter of its processor time.
    """
    for option in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
        _set(option, KEPT_BYTES)


def limit_arenas() -> None:
    """Let all threads share two heaps: by default each of eight may get its own, and what one has
    freed no other can use."""
    _set(_ARENA_MAX, 2)


def give_back() -> None:
    """Return to the system all pages that hold nothing."""
    with contextlib.suppress(AttributeError, TypeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)


def _set(option: int, value: int) -> None:
    with contextlib.suppress(AttributeError, TypeError, OSError):
        ctypes.CDLL(None).mallopt(option, value)
